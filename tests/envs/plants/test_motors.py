"""Motors: commands on their way to them, lags, limits, strength, and play of their own."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.envs.plants.trajectory import motion_of, swing
from tests.envs.trials import assert_uniform, begin, start_of, steps
from tests.grids import some_of
from tests.heads import MOVING, head_of, text_of
from tests.naming import named, refused
from vergence.envs.plant import make_plant
from vergence.envs.plants.kinematic import KinematicPlant
from vergence.envs.plants.motors import MotorStates
from vergence.models import HeadModel, parse_head
from vergence.models.motion import follow_joint, lag_decay

PERIOD_S = 1.0 / 120.0


def tied(**fields: object) -> HeadModel:
    """The head `tied` with exact sensors and other numbers of its three actuators."""
    head = head_of("tied").replace(
        sensor={"encoder_resolution_rad": 0.0, "velocity_resolution_rad_s": 0.0}
    )
    return dataclasses.replace(head, actuators=dataclasses.replace(head.actuators, **fields))


def command(*rates: float) -> np.ndarray:
    out = np.zeros(7)
    out[3 : 3 + len(rates)] = rates
    return out


def test_tied_joints_move_as_their_actuators_say() -> None:
    head = tied()
    _r, q, v = steps(KinematicPlant(head), start_of(), 40, command(0.5, 1.0, 0.4))
    # a common tilt turns both eyes; version and half the vergence add up on the left
    assert np.array_equal(q[:, 0, 3], q[:, 0, 5])
    assert q[-1, 0, 4] > q[-1, 0, 6] > 0.0
    assert v[-1, 0, 3:] == pytest.approx([0.5, 1.2, 0.5, 0.8], rel=1e-3)
    assert not q[:, 0, :3].any()
    assert head.reaches(q).all()


def test_a_reading_counts_the_encoders_of_the_actuators_and_has_one_error_for_tied_joints() -> None:
    step = np.array([0.01, 0.02, 0.03])
    head = tied(encoder_resolution_rad=step)
    readings, q, _v = steps(KinematicPlant(head), start_of(), 40, command(0.5, 1.0, 0.4))
    read = np.array([one.positions[0] for one in readings])
    error = read - q[:, 0]
    assert np.array_equal(error[:, 3], error[:, 5])
    own = head.actuation.actuators_of(read)[:, 3:6]
    assert own / step == pytest.approx(np.round(own / step), abs=1e-9)
    off = own - head.actuation.actuators_of(q[:, 0])[:, 3:6]
    assert (np.abs(off) <= 0.5 * step + 1e-12).all()
    assert (np.abs(off).max(axis=0) > 0.2 * step).all()


def test_each_actuator_has_its_own_lag_which_a_trial_scales() -> None:
    head = tied(lag_s=np.array([0.03, 0.06, 0.015]))
    for lag_s, ratio in ((None, 1.0), (0.045, 1.5)):
        plant = KinematicPlant(head, lag_s=lag_s)
        _r, _q, v = steps(plant, start_of(), 10, command(0.1, 0.1, 0.1))
        rates = head.actuation.to_actuators[:3] @ v[-1, 0, 3:]
        lags = ratio * np.array([0.03, 0.06, 0.015])
        assert rates == pytest.approx(0.1 * (1.0 - np.exp(-10 * PERIOD_S / lags)), rel=1e-9)


def test_each_actuator_keeps_its_own_limits() -> None:
    head = tied(
        velocity=np.array([1.0, 2.0, 3.0]), lower=np.array([-0.2, -0.3, 0.0]),
        upper=np.array([0.2, 0.3, 0.5]), acceleration=np.array([10.0, 20.0, 30.0]),
    )  # fmt: skip
    own = head.actuation
    readings, q, v = steps(KinematicPlant(head), start_of(), 90, command(9.0, -9.0, 9.0))
    assert readings[-1].command[0, 3:].tolist() == [1.0, -2.0, 3.0, 0.0]
    assert own.actuators_of(q[-1, 0])[3:6] == pytest.approx([0.2, -0.3, 0.5], abs=1e-12)
    rates = np.abs(v[:, 0, 3:] @ own.to_actuators[:3].T)
    assert (rates <= np.array([1.0, 2.0, 3.0]) + 1e-12).all()
    gains = np.abs(np.diff(rates, axis=0))[:5] / PERIOD_S
    assert (gains <= np.array([10.0, 20.0, 30.0]) + 1e-9).all()


def test_a_joints_own_stop_holds_all_that_push_against_it() -> None:
    text = text_of("tied")
    pan = text.index("[[joints]]", text.index("eyes_tilt"))
    end = text.index("[[joints]]", pan + 1)
    limits = "lower_rad = -0.4\nupper_rad = 0.4\nvelocity_rad_s = 5.0\nacceleration_rad_s2 = 80.0\n"
    head = parse_head(text[:end] + limits + text[end:])
    assert head.limits.upper[4] == 0.4
    _r, q, v = steps(KinematicPlant(head), start_of(), 120, command(0.0, 1.0, 1.0))
    assert q[:, 0, 4].max() == pytest.approx(0.4, abs=1e-12)
    assert v[-1, 0, 4] == pytest.approx(0.0, abs=1e-9)
    # and lets go at once
    plant = KinematicPlant(head)
    steps(plant, start_of(), 120, command(0.0, 1.0, 1.0))
    for _ in range(30):
        plant.step(command(0.0, -1.0, 0.0)[None])
    assert plant.truth().positions[0, 4] < 0.35


def test_what_a_motor_drives_is_left_where_it_turned_round_within_a_period() -> None:
    head = tied(backlash_rad=np.array([0.05, 0.0, 0.0]), lag_s=np.array([0.01, 0.03, 0.03]))
    plant = KinematicPlant(head)
    begin(plant, start_of())
    for _ in range(60):
        plant.step(command(0.6)[None])
    motors = plant._motors
    q, v = motors.angles[0, 3], motors.speeds[0, 3]
    plant.step(command(-0.9)[None])
    times = np.linspace(0.0, PERIOD_S, 2001)
    path = [follow_joint(q, v, -0.9, 0.01, 80.0, t, lag_decay(t, 0.01))[0] for t in times]
    assert max(path) > max(path[0], path[-1]) + 1e-5
    assert plant.truth().positions[0, 3] == pytest.approx(max(path) - 0.025, abs=1e-9)


def test_a_trial_begins_where_the_actuators_can_be() -> None:
    for name in MOVING:
        with named(name):
            head = head_of(name)
            plant = KinematicPlant(head)
            goal = head.fixate([0.02, 0.01, 0.9])
            goal[:3] = [0.0 if missing == "" else 0.05 for missing in head.joints[:3]]
            asked = goal.copy()
            asked[[not joint for joint in head.joints]] = 0.7  # of joints that there are not
            reading = begin(plant, start_of(positions=asked))
            assert plant.truth().positions[0] == pytest.approx(goal, abs=1e-12)
            assert not plant.truth().velocities.any()
            motors = MotorStates.of(head, head, 1).angles[0]
            assert head.actuation.joints_of(motors) == pytest.approx(head.rest(), abs=1e-12)
            steps_off = np.abs(reading.positions[0] - goal)
            assert steps_off.max() <= 0.00051


def test_the_neck_of_a_tied_head_moves_too() -> None:
    head = tied()
    rates = np.zeros(7)
    rates[:3] = [0.2, -0.1, 0.3]
    _r, q, v = steps(KinematicPlant(head), start_of(), 60, rates)
    assert v[-1, 0, :3] == pytest.approx(rates[:3], rel=1e-4)
    assert not q[:, 0, 3:].any()


T = 1 / 120
STEP = 0.024
"""Quantisation of a Dynamixel's goal velocity, 0.229 rev/min, rad/s."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("periods", "plant_name", "within_rad"),
    [(1.0, "kinematic", 1e-9), (4.25, "kinematic", 1e-9), (1.7, "mujoco", 2e-4)],
)
def test_late_commands_have_the_same_response_later(exact, plant_name, within_rad, periods):
    commands = swing(60, T, 2.0)
    own = {"neck": "welded"} if plant_name == "mujoco" else {}
    plant = make_plant(plant_name, exact, 1, command_latency_s=periods * T, **own)
    _r, q, _v = steps(plant, start_of(), 60, lambda k: commands[k])
    prompt, late = motion_of(exact, commands), motion_of(exact, commands, late_s=periods * T)
    for step in range(61):
        time_s = step * T
        assert q[step, 0] == pytest.approx(late(time_s)[0], abs=within_rad)
        # shifted in time, and nothing else
        assert late(time_s)[0] == pytest.approx(prompt(time_s - periods * T)[0], abs=1e-9)
    assert np.abs(q[40, 0] - prompt(40 * T)[0]).max() > 2e-3


def test_a_new_trial_knows_no_commands_of_the_one_before(exact) -> None:
    plant = make_plant("kinematic", exact, 1, command_latency_s=2.5 * T)
    steps(plant, start_of(), 20, [0, 0, 0, 1, 1, 1, 1])
    _r, q, _v = steps(plant, start_of(), 10)
    assert not q.any()


def test_the_reading_has_the_command_that_was_sent_not_the_one_that_counts(exact) -> None:
    plant = make_plant("kinematic", exact, 1, command_latency_s=3 * T)
    readings, _q, _v = steps(plant, start_of(), 6, lambda k: [0, 0, 0, 0.1 * k, 0, 0, 0])
    sent = [reading.command[0, 3] for reading in readings[1:]]
    assert sent == pytest.approx(0.1 * np.arange(6), abs=1e-12)


@pytest.fixture
def stepped(exact: HeadModel) -> HeadModel:
    return exact.replace(sensor={"command_resolution_rad_s": STEP})


@pytest.mark.parametrize(("sign", "plant_name"), [(1.0, "mujoco"), (-1.0, "kinematic")])
def test_a_command_of_one_step_moves_nothing_and_of_two_the_joint(stepped, plant_name, sign):
    counts = np.array([0.4, 1.0, 1.49, 1.51, 2.0])
    expected = np.array([0.0, 0.0, 0.0, 2.0, 2.0])
    for count, moves in zip(counts, expected, strict=True):
        plant = make_plant(plant_name, stepped, 1)
        command = sign * np.array([0, 0, 0, count * STEP, 0, 0, 0])
        readings, _q, v = steps(plant, start_of(), 60, command)
        assert readings[-1].command[0, 3] == pytest.approx(sign * np.rint(count) * STEP)
        assert v[-1, 0, 3] == pytest.approx(sign * moves * STEP, abs=1e-5)


def test_commands_are_rounded_to_whole_steps_within_the_limits(stepped) -> None:
    rng = np.random.default_rng(3)
    plant = make_plant("kinematic", stepped, 64)
    asked = rng.uniform(-8.0, 8.0, (64, 7))
    top = stepped.limits.velocity
    plant.begin(start_of(64))
    sent = plant.step(asked).command
    counts = sent / STEP
    assert counts == pytest.approx(np.round(counts), abs=1e-9)
    assert (np.abs(sent) <= top * (1 + 1e-9)).all()
    off = np.abs(sent - np.clip(asked, -top, top))
    assert (off <= STEP * (1 + 1e-9)).all()
    free = np.abs(asked) < top - STEP
    assert (off[free] <= 0.5 * STEP + 1e-12).all()


def test_a_lost_command_leaves_the_motors_with_the_one_before(exact: HeadModel) -> None:
    num, count, chance = 64, 200, 0.2
    commands = swing(count, T, 0.5)
    plant = make_plant("kinematic", exact, num, lag_s=0.0, lost_command_probability=chance)
    readings, _q, v = steps(plant, start_of(num), count, lambda k: commands[k])
    held, before = v[1:], v[:-1]  # motors without lag reach within a period what holds in it
    came = np.isclose(held, commands[:, None], atol=1e-12).all(axis=2)
    assert (held == before).all(axis=2)[~came].all()
    # four standard deviations of 12,800 draws
    assert 1.0 - came.mean() == pytest.approx(chance, abs=4 * np.sqrt(0.16 / came.size))
    for reading, command in zip(readings[1:], commands, strict=True):
        assert np.array_equal(reading.command, np.tile(command, (num, 1)))


@pytest.mark.slow
def test_a_stalled_loop_reads_nothing_and_commands_nothing(exact: HeadModel) -> None:
    num, count, chance, most = 32, 200, 0.05, 12
    commands = swing(count, T, 0.5)
    options = {"stall_probability": chance, "stall_s": most * T}
    plant = make_plant("kinematic", exact, num, lag_s=0.0, **options)
    plain = make_plant("kinematic", exact, 1)
    readings, q, v = steps(plant, start_of(num), count, lambda k: commands[k])
    frames = [reading.frame[0] for reading in steps(plain, start_of(), count)[0]]
    joints_s = np.array([reading.joints_s for reading in readings])
    stalled = np.diff(joints_s, axis=0, prepend=-1.0) == 0.0
    for k in range(1, count):
        old, new, after, off = readings[k - 1], readings[k], readings[k + 1], stalled[k]
        assert new.time_s == pytest.approx(k * T)
        for name in set(new._fields) - {"time_s", "command"}:
            a, b = getattr(old, name)[off], getattr(new, name)[off]
            assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), name
        assert np.array_equal(after.command[off], new.command[off])
        assert np.array_equal(v[k + 1][off], v[k][off])
        on = ~off
        assert np.array_equal(new.positions[on], q[k][on])
        assert (new.frame[on] == frames[k]).all()
        assert v[k + 1][on] == pytest.approx(np.tile(commands[k], (on.sum(), 1)), abs=1e-12)
    # what is not read lies on the chord between the readings beside it
    for n in range(8):
        read = np.flatnonzero(~stalled[:, n])
        angles = [readings[k].positions[n, 3] for k in read]
        for k in read[read > 8]:
            expected = np.interp(readings[k].exposure_s[n], read * T, angles)
            assert readings[k].positions_at_exposure[n, 3] == pytest.approx(expected, abs=1e-9)
    edges = np.diff(stalled.astype(int), axis=0, append=0)
    lengths = [np.flatnonzero(row == -1) - np.flatnonzero(row == 1) for row in edges.T]
    found = np.bincount(np.concatenate(lengths), minlength=most + 1)
    expected = np.array([0.0, 1.5, *[1.0] * (most - 2), 0.5]) / most
    ran = (~stalled[:-1]).sum()
    assert found.sum() / ran == pytest.approx(chance, abs=4 * np.sqrt(chance / ran))
    assert found / found.sum() == pytest.approx(expected, abs=4 * np.sqrt(1 / 12 / found.sum()))


PLAY = 0.01


def test_joints_begin_anywhere_in_their_play(exact, plant_name) -> None:
    num = 600
    plant = make_plant(plant_name, exact, num, backlash_rad=PLAY)
    reading = begin(plant, start_of(num))
    truth = plant.truth()
    assert np.array_equal(reading.positions, truth.motors)  # encoders sit on the motors
    assert not truth.motors.any()
    off = truth.positions / PLAY + 0.5
    assert (off[:, :3] == 0.5).all()  # a neck has none
    for joint in range(3, 7):
        assert_uniform(off[:, joint])
    pairs = np.corrcoef(off[:, 3:].T) - np.eye(4)
    assert np.abs(pairs).max() < 4 / np.sqrt(num)


@pytest.mark.slow
@pytest.mark.parametrize("plant_name", ["kinematic", "mujoco"])
def test_a_joint_lags_half_its_play_behind_the_motor_that_pushes_it(exact, plant_name) -> None:
    own = {"neck": "welded"} if plant_name == "mujoco" else {}
    plant = make_plant(plant_name, exact, 1, backlash_rad=PLAY, **own)
    commands = np.zeros((120, 7))
    commands[:, 3:] = np.where(np.arange(120) < 50, 0.4, -0.4)[:, None] * [1, -1, 0.5, 1]
    _r, q, v = steps(plant, start_of(), 120, lambda k: commands[k])
    motion = motion_of(exact, commands)
    motors = np.array([motion(k * T)[0] for k in range(121)])[:, 3:]
    joints, rates = q[:, 0, 3:], v[:, 0, 3:]
    # the play's own law, step by step: clip(joint, motor - b/2, motor + b/2) on a fine grid
    fine = np.array([motion(k * T / 40)[0] for k in range(4801)])[:, 3:]
    driven = joints[0].copy()
    expected = [driven]
    for k in range(1, len(fine)):
        driven = np.clip(driven, fine[k] - 0.5 * PLAY, fine[k] + 0.5 * PLAY)
        if k % 40 == 0:
            expected.append(driven)
    # where a motor turns the grid misses 1e-7 rad; MuJoCo looks four times a period
    within = 1e-6 if plant_name == "kinematic" else 3e-4
    assert joints == pytest.approx(np.array(expected), abs=within)
    crossing = np.abs(np.array(expected) - motors) < 0.49 * PLAY
    assert crossing[52:].sum() > 8
    assert (rates[crossing] == 0.0).all()


def test_play_belongs_to_the_actuator(plant_name) -> None:
    head = head_of("tied").replace(sensor={"encoder_resolution_rad": 0.0})
    play = np.array([0.0, 0.02, 0.0])
    plant = make_plant(plant_name, head, 200, backlash_rad=np.tile(play, (200, 1)))
    begin(plant, start_of(200))
    truth = plant.truth()
    driven = head.actuation.actuators_of(truth.positions)[:, 3:6]
    off = driven - truth.motors[:, 3:6]
    assert np.abs(off[:, [0, 2]]).max() < 1e-12
    assert np.abs(off[:, 1]).max() <= 0.01 + 1e-12
    assert np.ptp(off[:, 1]) > 0.018


def test_a_heads_own_play_holds_where_nothing_is_said(exact) -> None:
    head = exact.replace(sensor={"backlash_rad": 0.004})
    given = make_plant("kinematic", head, 1).conditions.backlash_rad
    assert given[0].tolist() == [0.0, 0.0, 0.0, 0.004, 0.004, 0.004, 0.004]
    none = make_plant("kinematic", head, 1, backlash_rad=0.0).conditions.backlash_rad
    assert not none.any()


def test_drawn_play_is_only_where_there_are_actuators() -> None:
    head = head_of("tied")
    plant = make_plant("kinematic", head, 50, variation={"backlash_rad": (0.001, 0.01)})
    begin(plant, start_of(50))
    play = plant.conditions.backlash_rad
    assert not play[:, [0, 1, 2, 6]].any()
    assert play[:, 3:6].min() >= 0.001
    assert play[:, 3:6].max() <= 0.01


# the kinematic plant is exact; in MuJoCo a force limit holds for a quarter of a period, and the
# implicit integration leaves an acceleration limit by a time step late
PLANTS = [("kinematic", 1e-8), ("mujoco", 2e-3)]
plants = pytest.mark.parametrize(("plant_name", "within_rad"), PLANTS)
GAINS = np.array([0.7, 0.9, 1.1, 1.3])


def full(count: int, head: HeadModel) -> np.ndarray:
    """(count, 7) full speed one way, then the other."""
    sign = np.where(np.arange(count) < count // 2, 1.0, -1.0)[:, None]
    return sign * head.limits.velocity * [0, 0, 0, 1, -1, 1, -1]


def run(plant_name: str, head: HeadModel, commands: np.ndarray, **options: object) -> np.ndarray:
    """(count + 1, 7) angles."""
    own = {"neck": "welded"} if plant_name == "mujoco" else {}
    plant = make_plant(plant_name, head, 1, **options, **own)
    return steps(plant, start_of(), len(commands), lambda k: commands[k])[1][:, 0]


@plants
def test_each_actuators_speed_has_its_own_gain(exact, plant_name, within_rad) -> None:
    commands = swing(80, T)
    q = run(plant_name, exact, commands, speed_gain=GAINS[None])
    gain = np.concatenate([np.ones(3), GAINS])
    motion = motion_of(exact, commands, gain=gain)
    expected = np.array([motion(k * T)[0] for k in range(81)])
    assert q == pytest.approx(expected, abs=within_rad)
    plant = make_plant(plant_name, exact, 1, speed_gain=GAINS[None])
    _r, _q, v = steps(plant, start_of(), 60, [0, 0, 0, 0.5, 0.5, 0.5, 0.5])
    assert v[-1, 0, 3:] == pytest.approx(0.5 * GAINS, rel=2e-3)


def test_the_greatest_acceleration_is_that_of_the_limits_by_a_ratio(exact) -> None:
    for ratio in (0.4, 1.2):
        for plant_name, within_rad in PLANTS:
            with named(ratio, plant_name, within_rad):
                commands = full(20, exact)
                q = run(plant_name, exact, commands, acceleration_ratio=ratio)
                motion = motion_of(exact, commands, ratio=ratio)
                expected = np.array([motion(k * T)[0] for k in range(21)])
                assert q == pytest.approx(expected, abs=within_rad)
                # the first period is all limit
                assert np.abs(q[1, 3:]) == pytest.approx(0.5 * 120.0 * ratio * T**2, rel=0.03)


@pytest.mark.parametrize(
    ("gain", "falloff", "plant_name"), [(0.8, 0.8, "kinematic"), (1.5, 0.3, "mujoco")]
)
def test_torque_falls_with_speed_where_a_motor_speeds_up(exact, plant_name, falloff, gain) -> None:
    commands = full(14, exact)
    q, without = (
        run(plant_name, exact, commands, torque_falloff=one, speed_gain=gain)
        for one in (falloff, 0.0)
    )
    motion = motion_of(exact, commands, falloff=falloff, gain=gain)
    effect = np.abs(q - without).max()
    assert effect > 1.5e-3
    # MuJoCo's motors have the limit of the speed at the beginning of each quarter of a period
    within = 1e-8 if plant_name == "kinematic" else 0.25 * effect
    assert q == pytest.approx(np.array([motion(k * T)[0] for k in range(15)]), abs=within)


def test_a_motor_of_any_gain_and_falloff_reaches_its_speed_and_no_more(exact) -> None:
    for falloff in (0.0, 0.6):
        for plant_name in ("kinematic", "mujoco"):
            with named(falloff, plant_name):
                for gain in (0.5, 2.0):
                    options = {"speed_gain": gain, "torque_falloff": falloff}
                    plant = make_plant(plant_name, exact, 1, **options)
                    _r, _q, v = steps(plant, start_of(positions=-0.3), 14, [0, 0, 0, 1.5, 0, 0, 0])
                    assert (v[:, 0, 3] <= 1.5 * gain * (1 + 1e-3)).all()
                    assert v[-1, 0, 3] > 0.9 * 1.5 * gain


def test_the_limits_are_those_of_the_true_head(exact, plant_name) -> None:
    half = {n: 0.5 * getattr(exact.limits, n) for n in ("velocity", "acceleration")}
    ends = {"upper": np.full(7, 0.3), "lower": np.full(7, -0.3)}
    weak = exact.replace(limits=half | ends)
    plant = make_plant(plant_name, exact, 1, true_head=weak)
    command = np.array([0, 0, 0, 6.0, 6.0, 6.0, 6.0])
    readings, q, v = steps(plant, start_of(), 60, command)
    assert readings[-1].command[0, 3:] == pytest.approx(np.full(4, 3.0))
    assert v[1, 0, 3:] == pytest.approx(np.full(4, 60.0 * T), rel=0.03)
    assert np.abs(v[:, 0]).max() <= 3.0 * (1 + 1e-3)
    assert q[-1, 0, 3:] == pytest.approx(np.full(4, 0.3), abs=5e-3)


@pytest.mark.parametrize("plant", ["kinematic", "mujoco"])
def test_every_joint_stops_at_both_its_limits(exact: HeadModel, plant) -> None:
    limits = exact.limits
    for side, end in ((-1.0, limits.lower), (1.0, limits.upper)):
        heads = make_plant(plant, exact, 1)
        # a second and a half is enough for the slowest joint to cross all of its range
        _r, positions, velocities = steps(heads, start_of(), 180, side * limits.velocity)
        assert positions[-1, 0] == pytest.approx(end, abs=5e-3)  # MuJoCo's stops are springs
        assert np.abs(velocities[-1]).max() < 1e-2
        beyond = np.maximum(positions - limits.upper, limits.lower - positions).max()
        assert beyond < 0.05  # what the layout of observations leaves room for


def test_a_command_that_is_nan_is_refused_and_moves_nothing(exact: HeadModel, plant_name) -> None:
    heads = make_plant(plant_name, exact, 2)
    heads.begin(start_of(2))
    command = np.ones((2, 7))
    command[1, 4] = np.nan
    refused(r"command.*nan", heads.step, command)
    assert not heads.truth().positions.any()


def test_a_command_of_another_shape_is_refused(exact: HeadModel) -> None:
    for plant, shape in some_of(["kinematic", "mujoco"], [(7,), (2, 4), (1, 7), (3, 7)]):
        with named(plant, shape):
            heads = make_plant(plant, exact, 2)
            heads.begin(start_of(2))
            refused(r"command: expected shape \(2, 7\)", heads.step, np.zeros(shape))


def swinging(
    head: HeadModel, commands: np.ndarray, overshoot: float, torque_falloff: float
) -> np.ndarray:
    """(periods + 1, 7) angles of joints with a lag of second order, integrated numerically."""
    period, tau, a = head.timing.period_s, head.timing.lag_s, head.limits.acceleration
    zeta = -np.log(overshoot) / np.hypot(np.pi, np.log(overshoot))
    share = torque_falloff / head.limits.velocity
    state, angles = np.zeros(21), [np.zeros(7)]

    def rates(_t: float, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        _q, v, w = state.reshape(3, 7)
        up, down = (a * (1.0 - share * np.maximum(side * v, 0.0)) for side in (1.0, -1.0))
        held = np.clip(w, -down, up)
        swing = (u - v - 2.0 * zeta * tau * held) / tau**2
        # at a limit it goes with this, which falls with speed
        falls = -a * share * held * np.where(held * v > 0.0, np.sign(held), 0.0)
        swing = np.where((w >= up) & (swing > falls), falls, swing)
        swing = np.where((w <= -down) & (swing < -falls), -falls, swing)
        return np.concatenate([v, held, swing])

    for u in commands:
        state = solve_ivp(rates, (0.0, period), state, args=(u,), max_step=4e-4, rtol=1e-7).y[:, -1]
        _q, v, w = state.reshape(3, 7)
        up, down = (a * (1.0 - share * np.maximum(side * v, 0.0)) for side in (1.0, -1.0))
        state[14:] = np.clip(w, -down, up)
        angles.append(state[:7].copy())
    return np.array(angles)


@pytest.mark.slow
def test_a_servo_of_second_order_swings_within_its_acceleration(exact: HeadModel) -> None:
    overshoot, commands = 0.25, np.zeros((26, 7))
    # a limit that falls with speed stays through each eighth of a lag; MuJoCo looks four times a
    # period. The commands are small enough for the lag alone, and far beyond the limit
    commands[:, 3:] = np.where(np.arange(26) < 18, 1.0, -0.5)[:, None] * [0.5, -1.0, 3.0, -5.0]
    for torque_falloff, plants in (
        (0.0, [("kinematic", 2e-5), ("mujoco", 4e-3)]),
        (0.5, [("kinematic", 2e-3)]),
    ):
        options = {"overshoot": overshoot, "torque_falloff": torque_falloff}
        expected = swinging(exact, commands, **options)
        for plant, within_rad in plants:
            with named(plant, torque_falloff):
                heads = make_plant(plant, exact, 1, **options)
                _r, q, v = steps(heads, start_of(), 26, lambda k: commands[k])
                assert q[:, 0] == pytest.approx(expected, abs=within_rad)
                beyond = v[:19, 0, 3].max() / 0.5
                assert beyond == pytest.approx(1.0 + overshoot, abs=0.03)  # at the periods' ends
