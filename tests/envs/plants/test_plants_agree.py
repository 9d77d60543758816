"""Interchangeable plants, at any rate: what the kinematic one says, MuJoCo's dynamics confirm."""

import numpy as np
import pytest

from tests.controllers.loops import begin
from tests.envs.any_head import begun, least_squares, uneven
from tests.envs.plants.trajectory import motion_of, swing
from tests.envs.trials import EVERYTHING, start_of, steps
from tests.heads import head_of, text_of
from tests.naming import named
from vergence import load_head
from vergence.envs.plant import make_plant
from vergence.envs.plants.conditions import IMPERFECTIONS, RANGES
from vergence.envs.task import GazeTask
from vergence.models import HeadModel, parse_head


def worst_deg(a, b) -> float:
    return float(np.rad2deg(np.abs(a - b)).max())


def test_joint_angles_agree_where_a_heads_lag_is_not_the_nominal_one(exact) -> None:
    def command(step):
        return [0, 0, 0, 1, -1, 1, 1] if step < 30 else [0, 0, 0, -1, 1, -1, 0]

    runs = [
        steps(make_plant(name, exact, 3, lag_s=[0.03, 0.015, 0.06]), start_of(3), 60, command)
        for name in ("kinematic", "mujoco")
    ]
    # small commands stay clear of the acceleration limit: the discretised lag is exact there
    assert worst_deg(runs[0][1], runs[1][1]) < 0.005


def test_the_moving_neck_agrees(exact: HeadModel) -> None:
    def command(step):
        return [1.0, 0.5, -0.5, 0, 0, 0, 0] if step < 40 else [-1.0, 0, 0.5, 1.0, 0, 0, -1.0]

    runs = [
        steps(make_plant(name, exact, 1), start_of(), 90, command)
        for name in ("kinematic", "mujoco")
    ]
    # the neck's inertia depends on where the eyes and its own joints are: per cent of its lag
    assert worst_deg(runs[0][1], runs[1][1]) < 0.5


PAN_AND_VERGENCE = "pan of both eyes and vergence of one"
PLAY_AND_LAGS = "play, and a lag for each actuator"
PRESETS = ("simulated", "physical", "turrets")


def any_head(name: str) -> HeadModel:
    if name == PAN_AND_VERGENCE:
        one = text_of("tied").replace("left_pan = 0.5, right_pan = -0.5", "right_pan = -1.0")
        return parse_head(one)
    if name == PLAY_AND_LAGS:
        text = text_of("tied").replace('name = "tilt"', 'name = "tilt"\nlag_s = 0.0')
        version = 'name = "version"\nlag_s = 0.06\nbacklash_rad = 0.01'
        return parse_head(text.replace('name = "version"', version))
    return load_head(name) if name in PRESETS else head_of(name)


def switching(head: HeadModel, seed: int, num: int, count: int):
    """Actuator commands at full speed that switch at random and turn round 8 degrees off."""
    rng, own = np.random.default_rng(seed), head.actuation
    middle = 0.5 * (own.lower + own.upper)
    start = start_of(num, positions=own.joints_of(middle))
    plant = make_plant("kinematic", head, num)
    plant.begin(start)
    commands = np.zeros((count, num, 7))
    for step in range(count):
        if step % 5 == 0:
            side = rng.choice([-1.0, 1.0], (num, 7)) * own.velocity
        away = own.actuators_of(plant.truth().positions) - middle
        side = np.where(np.abs(away) > 0.15, -own.velocity * np.sign(away), side)
        commands[step, :, 3:] = side[:, 3:]
        plant.step(commands[step])
    return start, commands


@pytest.mark.parametrize("name", ["mis", "panfirst", *PRESETS, PAN_AND_VERGENCE, PLAY_AND_LAGS])
def test_joints_of_any_head_agree_under_switching_commands(name) -> None:
    head, num, count = any_head(name), 2, 180
    start, commands = switching(head, 0, num, count)
    (_, q, v), (_, q_mujoco, v_mujoco) = (
        steps(make_plant(plant, head, num), start, count, lambda k: commands[k])
        for plant in ("kinematic", "mujoco")
    )
    assert worst_deg(q, q[0]) > 10.0
    # eyes push a neck a little, whose commands are zero
    eyes = np.s_[..., 3:] if name in PRESETS else np.s_[...]
    assert worst_deg(q[eyes], q_mujoco[eyes]) < 0.1
    # the angle is right because the velocity is: a tenth of what a period at the limit adds
    assert np.abs(v - v_mujoco)[eyes].max() < 0.1
    # MuJoCo's ties give a little; the plant's joints are what its motors say
    own = head.actuation
    assert np.abs(own.joints_of(own.actuators_of(q_mujoco)) - q_mujoco).max() < 1e-12


def test_actuators_stop_alike_at_their_limits() -> None:
    for name in ["mis", PAN_AND_VERGENCE]:
        with named(name):
            head = any_head(name)
            start, speed = start_of(positions=head.rest()), head.actuation.velocity
            paths = [
                steps(make_plant(plant, head, 1), start, 120, speed)[1]
                for plant in ("kinematic", "mujoco")
            ]
            assert worst_deg(paths[0][-1], paths[1][-1]) < 0.1


@pytest.mark.slow
def test_a_welded_neck_leaves_the_eyes_as_they_are(exact: HeadModel) -> None:
    for head in (exact, any_head("tied")):
        with named(head.name):
            start, commands = switching(head, 3, 1, 120)
            servo, welded = (
                steps(make_plant("mujoco", head, 1, neck=neck), start, 120, commands.__getitem__)[1]
                for neck in ("servo", "welded")
            )
            assert not welded[..., :3].any()
            assert worst_deg(servo, welded) < 0.01


def test_images_of_different_sizes_are_drawn_and_looked_at() -> None:
    head = uneven("tied")
    task = begun(head, 1, plant="rendered")
    left, right = task.plant.frames(0)
    assert left.shape == (240, 320)
    assert right.shape == (360, 640)
    for _ in range(120):
        task.step(least_squares(task, 5.0))
    assert np.abs(task.truth().pixel_error).max() < 1.5
    task.close()


def at(head: HeadModel, control_hz: float) -> HeadModel:
    """The head with another control rate and all else as it is: 60 frames a second, 67 ms late."""
    return head.replace(timing={"control_rate_hz": control_hz, "frame_rate_hz": 60.0})


@pytest.mark.parametrize(
    ("control_hz", "plant_name", "within_rad"),
    [(77.0, "kinematic", 1e-9), (50.0, "mujoco", 1e-4), (250.0, "mujoco", 1e-4)],
)
def test_joints_follow_as_their_equation_says(exact, control_hz, plant_name, within_rad) -> None:
    head, count = at(exact, control_hz), int(0.3 * control_hz)
    commands = swing(count, head.timing.period_s)
    own = {"neck": "welded"} if plant_name == "mujoco" else {}
    plant = make_plant(plant_name, head, 1, **own)
    _r, q, _v = steps(plant, start_of(), count, lambda k: commands[k])
    motion = motion_of(head, commands)
    expected = np.array([motion(k * head.timing.period_s)[0] for k in range(count + 1)])
    assert q[:, 0] == pytest.approx(expected, abs=within_rad)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("control_hz", "plant_name"), [(77.0, "kinematic"), (50.0, "mujoco"), (250.0, "mujoco")]
)
def test_everything_can_be_drawn_at_every_rate(simulated, control_hz, plant_name) -> None:
    head, num = at(simulated, control_hz), 8
    task = begin(GazeTask(num, head=head, plant=plant_name, variation=EVERYTHING))
    seen = np.zeros(num, dtype=int)
    for step in range(int(1.0 * control_hz)):
        task.step(np.tile(0.1 * np.sin(7.0 * step / control_hz + np.arange(4.0)), (num, 1)))
        assert np.isfinite(task.observation).all()
        seen += task.reading.visible.any(axis=1)
        late = task.reading.time_s - task.reading.received_s
        assert (late[np.isfinite(late)] >= -1e-9).all()
    conditions = task.plant.conditions
    # so many frames of a second come as the clock gives, less those that are dropped or on the way
    frames = conditions.frame_rate_hz / (1.0 + conditions.clock_drift)
    lost = 4 * np.sqrt(frames * 0.21) + 1 + 0.03 * frames
    expected = frames * (1.0 - conditions.dropped_frame_probability)
    assert (np.abs(task.reading.frame - expected) < lost).all()
    assert (seen > 0).all()


NUM, STEPS = 24, 150


def test_all_that_there_is_to_draw_is_drawn() -> None:
    assert set(EVERYTHING) == {*IMPERFECTIONS, "model_errors"} == {*RANGES, "model_errors"}


@pytest.mark.slow
@pytest.mark.parametrize("target", ["step", "circle"])
def test_both_plants_agree_with_everything_drawn(target) -> None:
    tasks = []
    for plant, own in (("kinematic", {}), ("mujoco", {"neck": "welded"})):
        options = {"variation": EVERYTHING, "plant_options": own, "target": target}
        tasks.append(begin(GazeTask(NUM, plant=plant, **options), 4))
    off, moved, pixels = [], [], []
    # to and fro by some ten degrees
    for action in 0.3 * np.sign(np.sin(0.11 * np.arange(STEPS)[:, None] + [0.0, 1.0, 2.0, 3.0])):
        for task in tasks:
            task.step(np.tile(action, (NUM, 1)))
        ours, theirs = (task.truth() for task in tasks)
        off.append(np.abs(ours.positions - theirs.positions)[:, 3:])
        moved.append(ours.positions[:, 3:])
        one, other = (task.reading for task in tasks)
        # times, faults and noise are functions of the trial alone
        for name in ("frame", "exposure_s", "received_s", "joints_s", "command"):
            a, b = getattr(one, name), getattr(other, name)
            assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
        # but an eye at the smear that blinds it may see or not
        assert (one.visible == other.visible).mean() > 0.9
        both = one.visible & other.visible
        pixels.append(np.abs(one.pixels - other.pixels)[both])
    assert np.ptp(moved, axis=0).max() > 0.2
    # torque that falls with speed and play are looked at four times a period: a quarter of a degree
    assert np.max(off) < 5e-3
    assert np.median(off) < 5e-4
    assert np.median(np.concatenate(pixels)) < 0.5
