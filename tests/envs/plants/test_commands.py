"""Commands on their way to the motors: latency, quantisation, loss."""

import numpy as np
import pytest

from tests.envs.plants.trajectory import motion_of, swing
from tests.envs.trials import start_of, steps
from vergence import HeadModel
from vergence.envs.plant import make_plant

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


def test_whole_periods_of_latency_leave_the_trajectory_as_it_is(exact) -> None:
    commands = swing(60, T, 2.0)
    # in one batch, so that MuJoCo divides both heads' periods alike
    plant = make_plant("mujoco", exact, 2, command_latency_s=[0.0, 3 * T])
    _r, q, _v = steps(plant, start_of(2), 60, lambda k: commands[k])
    # what rounding leaves of the times at which frames are exposed within a period
    assert q[3:, 1] == pytest.approx(q[:-3, 0], abs=1e-13)


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
