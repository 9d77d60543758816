"""The layout of observations: documented, bounded, and undone by `decode`."""

import re

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.controllers.loops import begin
from tests.heads import MOVING, head_of, text_of
from tests.models.lenses import wide
from tests.naming import named
from vergence import load_head
from vergence.envs.observation import (
    AGE_S,
    ANGLE_MARGIN_RAD,
    FIELDS,
    FINE_PX,
    SPEED_MARGIN,
    ObservationLayout,
)
from vergence.envs.task import GazeTask
from vergence.models import parse_head

FLOAT32 = 2.0**-23


def test_the_docstrings_table_is_the_layout() -> None:
    rows = re.findall(r"\| (\d+):(\d+) \| `(\w+)` \| .* \|", ObservationLayout.__doc__ or "")
    assert {name: slice(int(a), int(b)) for a, b, name in rows} == FIELDS


def test_decode_gives_back_what_the_sensors_reported() -> None:
    for preset in ["simulated", "physical"]:
        with named(preset):
            target = {"kind": "random", "shift": 0.1}
            task = begin(GazeTask(6, head=preset, plant="kinematic", target=target))
            head, layout = task.head, task.layout
            rng = np.random.default_rng(0)
            fine = coarse = 0
            for _ in range(100):
                action = rng.uniform(-0.4, 0.4, (6, 4)).astype(np.float32)
                task.step(action)
                seen, reading = layout.decode(task.observation), task.reading
                assert np.array_equal(seen.visible, reading.visible)
                error = np.abs(seen.pixel_error - task.pixel_error)
                assert np.array_equal(np.isnan(seen.pixel_error), np.isnan(task.pixel_error))
                small = np.abs(task.pixel_error) < FINE_PX - 1e-3
                large = np.isfinite(task.pixel_error) & ~small
                assert (error[small] <= FINE_PX * FLOAT32).all()
                assert (error[large] <= head.cameras.size[0, 0] * FLOAT32).all()
                fine, coarse = fine + small.sum(), coarse + large.sum()
                reach = np.abs(head.limits.upper[3:]) + ANGLE_MARGIN_RAD
                for field in ("positions", "positions_at_exposure"):
                    off = np.abs(getattr(seen, field) - getattr(reading, field))
                    assert (off[:, 3:] <= reach * FLOAT32).all()
                    assert not off[:, :3].any()
                assert seen.velocities == pytest.approx(reading.velocities, abs=7 * FLOAT32)
                sent = action * layout.action_limits
                assert seen.last_command == pytest.approx(sent, abs=6 * FLOAT32)
                age = task.reading.time_s - task.reading.received_s + 8 / 120
                expected = np.where(np.isnan(age), AGE_S, np.minimum(age, AGE_S))
                assert seen.image_age_s == pytest.approx(expected, abs=FLOAT32)
            assert fine > 12
            assert coarse > 600


def test_measured_errors_are_undistorted_and_from_the_principal_point() -> None:
    task = begin(GazeTask(3, head="physical", plant="kinematic"))
    for _ in range(10):
        task.step(np.zeros((3, 4)))
    head = task.head
    expected = head.undistort(task.reading.pixels) - head.cameras.principal
    assert task.pixel_error == pytest.approx(expected, abs=1e-12)
    assert np.abs(task.reading.pixels - head.cameras.principal - expected).max() > 0.01


def test_a_pixel_is_a_sixteenth_of_the_fine_channel() -> None:
    target = {"kind": "step", "after": (0.0, -0.1016, 1.0)}
    task = begin(GazeTask(1, plant="kinematic", target=target))
    for _ in range(9):
        task.step(np.zeros((1, 4)))
    error = task.pixel_error.ravel()
    assert 0.5 < np.abs(error).max() < 2.0
    assert task.observation[0, FIELDS["pixel_error_fine"]] == pytest.approx(error / 16, abs=1e-7)


def test_decode_takes_any_leading_shape() -> None:
    for shape in [(), (4,), (2, 3)]:
        with named(shape):
            layout = ObservationLayout.of(load_head("simulated"))
            rng = np.random.default_rng(0)
            observation = rng.uniform(layout.low(), layout.high(), (*shape, layout.size))
            seen = layout.decode(observation)
            assert seen.pixel_error.shape == (*shape, 2, 2)
            assert seen.positions.shape == (*shape, 7)
            assert seen.image_age_s.shape == shape
            for index in np.ndindex(shape):
                for a, b in zip(layout.decode(observation[index]), seen, strict=True):
                    assert np.array_equal(a, b[index], equal_nan=a.dtype.kind == "f")


def test_actions_are_joint_velocities_by_their_limits() -> None:
    head = load_head("simulated").replace(limits={"velocity": [3, 3, 3, 6, 5, 4, 2]})
    layout = ObservationLayout.of(head)
    assert layout.action([3.0, 5.0, -2.0, 4.0]).tolist() == [0.5, 1.0, -0.5, 1.0]
    assert layout.action(np.zeros((3, 2, 4))).shape == (3, 2, 4)
    assert layout.action_names == ("left_tilt", "left_pan", "right_tilt", "right_pan")
    # without a lag the plant does what the action says
    head = head.replace(timing={"lag_s": 0.0}, limits={"acceleration": np.full(7, np.inf)})
    task = begin(GazeTask(1, head=head, plant="kinematic"))
    task.step(np.array([[0.5, -1.0, 2.0, 0.25]]))
    assert task.truth().velocities[0] == pytest.approx([0, 0, 0, 3.0, -5.0, 4.0, 0.5], abs=1e-12)


@pytest.mark.slow
@settings(max_examples=15)
@given(
    seed=st.integers(0, 2**32),
    preset=st.sampled_from(["simulated", "physical"]),
    target=st.sampled_from(["random", "step", "circle", "line", "static"]),
    span=st.floats(0.1, 3.0),
)
def test_observations_lie_in_the_space_whatever_the_actions(seed, preset, target, span) -> None:
    env = gym.make("vergence/Gaze-v0", plant="kinematic", head=preset, target=target).unwrapped
    observation, _info = env.reset(seed=seed)
    assert env.observation_space.contains(observation)
    rng = np.random.default_rng(seed)
    drift = rng.uniform(-1, 1, 4)
    for _ in range(80):
        observation, *_rest = env.step(span * (drift + rng.uniform(-1, 1, 4)))
        assert env.observation_space.contains(observation)


def test_observations_lie_in_the_space_at_mujocos_joint_stops() -> None:
    env = gym.make("vergence/Gaze-v0", plant="mujoco").unwrapped
    env.reset(seed=0)
    for side in (1.0, -1.0):
        for _ in range(90):
            observation, *_rest = env.step(np.full(4, side, np.float32))
            assert env.observation_space.contains(observation)
            assert np.abs(observation[FIELDS["positions"]]).max() < 1.0  # none is saturated


def test_the_layout_of_a_preset_is_written_as_bundles_hold_it() -> None:
    for preset in ("simulated", "physical"):
        written = ObservationLayout.of(load_head(preset)).to_dict()
        limits = load_head(preset).limits
        assert " ".join(written) == "fields actions scaling fine_px age_s latency_s period_s"
        assert written["fields"]["last_action"] == [23, 27]
        assert len(written["scaling"]) == 20
        assert written["scaling"][13:17] == limits.velocity[3:].tolist()


def test_a_head_has_as_many_numbers_as_actuators() -> None:
    for name, m in [("tied", 3), ("mis", 3), ("common", 2), ("vergeonly", 2)]:
        with named(name, m):
            head = head_of(name)
            layout = ObservationLayout.of(head)
            assert layout.count == m == len(layout.action_names)
            assert layout.size == 11 + 4 * m
            assert layout.action_names == head.actuation.names
            assert layout.action_limits.tolist() == [5.0] * m + [0.0] * (4 - m)
            places = [i for part in layout.fields.values() for i in range(part.start, part.stop)]
            assert places == list(range(layout.size))
            assert layout.low().shape == layout.high().shape == (layout.size,)
            assert layout.action(np.full((2, 4), 2.5)).tolist() == [[0.5] * m] * 2


def test_layouts_are_equal_when_they_mean_the_same() -> None:
    layout = ObservationLayout.of(head_of("tied"))
    assert hash(layout) == hash(ObservationLayout.of(head_of("tied")))
    text = text_of("tied").replace("left_pan = 0.5, right_pan = -0.5", "left_pan = 1.0")
    assert layout != ObservationLayout.of(parse_head(text))
    assert layout == ObservationLayout.of(head_of("tied"))


def test_decode_gives_the_joints_that_the_actuators_move() -> None:
    for name in MOVING:
        with named(name):
            head = head_of(name)
            layout, own = ObservationLayout.of(head), head.actuation
            rng = np.random.default_rng(0)
            m = layout.count
            observation = rng.uniform(-1.0, 1.0, (5, layout.size))
            observation[:, 8:11] = 1.0
            seen = layout.decode(observation)
            half, middle = 0.5 * (own.upper - own.lower), 0.5 * (own.upper + own.lower)
            angles = np.zeros((5, 7))
            group = observation[:, 11 : 11 + m]
            all_seven = middle + (half + ANGLE_MARGIN_RAD) * _slots(group)
            angles[:, 3 : 3 + m] = all_seven[:, 3 : 3 + m]
            assert seen.positions == pytest.approx(own.joints_of(angles), abs=1e-14)
            rates = np.zeros((5, 7))
            speeds = SPEED_MARGIN * own.velocity * _slots(observation[:, 11 + 2 * m : 11 + 3 * m])
            rates[:, 3:] = speeds[:, 3:]
            assert seen.velocities == pytest.approx(own.joint_velocities_of(rates), abs=1e-14)
            sent = 5.0 * observation[:, 11 + 3 * m :]
            assert seen.last_command[:, :m] == pytest.approx(sent, abs=1e-14)
            assert not seen.last_command[:, m:].any()


def _slots(group: np.ndarray) -> np.ndarray:
    """(n, 7) numbers of m actuators, zero elsewhere."""
    out = np.zeros((len(group), 7))
    out[:, 3 : 3 + group.shape[1]] = group
    return out


def test_each_eyes_pixel_error_is_scaled_by_its_own_width() -> None:
    head = wide("fisheye", "rational")  # 800 and 640 px wide
    layout = ObservationLayout.of(head)
    observation = np.zeros(layout.size)
    observation[layout.fields["visible"]] = 1.0
    observation[layout.fields["pixel_error_fine"]] = 1.0
    observation[layout.fields["pixel_error"]] = [0.5, 0.25, 0.5, 0.25]
    error = layout.decode(observation).pixel_error
    assert error.tolist() == [[400.0, 200.0], [320.0, 160.0]]
    task = begin(GazeTask(4, head=head, plant="kinematic"))
    for _ in range(20):
        task.step(np.zeros((4, 4), np.float32))
    seen = np.isfinite(task.pixel_error) & (np.abs(task.pixel_error) < 600.0)
    assert seen.any()
    off = layout.decode(task.observation).pixel_error - task.pixel_error
    assert np.abs(off[seen]).max() < 800.0 * FLOAT32


def test_another_width_of_the_right_image_makes_another_layout(simulated) -> None:
    own = ObservationLayout.of(simulated)
    wider = simulated.replace(cameras={"size": [[1040, 860], [1280, 860]]})
    assert ObservationLayout.of(wider) != own
    # bundles made before eyes had sizes of their own carry twenty constants
    assert len(own.to_dict()["scaling"]) == 20
    assert ObservationLayout.of(wider).to_dict()["scaling"][20] == 1280.0
