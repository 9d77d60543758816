"""Inputs of a network: numbers in range, the present and not the past, no shared state."""

import numpy as np
import pytest

from tests.controllers.loops import begin
from tests.naming import named
from vergence.controllers.networks.inputs import KINDS, Inputs
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError
from vergence.models import load_head


def begun(num: int, **options: object) -> GazeTask:
    return begin(GazeTask(num, plant="kinematic", **options), 3)


def channel(inputs: Inputs, values: np.ndarray, name: str) -> np.ndarray:
    """One channel of the four eye joints."""
    joints = ("left_tilt", "left_pan", "right_tilt", "right_pan")
    return values[..., [inputs.names.index(f"{name}_{joint}") for joint in joints]]


def test_inputs_stay_in_their_range_under_any_actions() -> None:
    for kind in sorted(KINDS):
        with named(kind):
            task = begun(20)
            inputs = Inputs(kind, task.head)
            memory = np.tile(inputs.initial(), (20, 1))
            rng = np.random.default_rng(0)
            for _ in range(80):
                values = inputs.update(task.layout.decode(task.encoded), memory)[0]
                assert values.shape == (20, inputs.size)
                assert values.dtype == np.float32
                assert (np.abs(values) <= 1.0).all()
                task.step(rng.uniform(-1, 1, (20, 4)))


def test_one_head_sees_what_it_sees_within_a_batch() -> None:
    for kind in sorted(KINDS):
        with named(kind):
            task = begun(5)
            inputs = Inputs(kind, task.head)
            many, one = np.tile(inputs.initial(), (5, 1)), inputs.initial()
            for step in range(30):
                batch = inputs.update(task.layout.decode(task.encoded), many)[0]
                assert np.array_equal(
                    inputs.update(task.layout.decode(task.encoded[2]), one)[0], batch[2]
                )
                task.step(np.full((5, 4), 0.3 * np.sin(0.3 * step)))
            assert np.array_equal(many[2], one)


def test_what_is_left_to_turn_is_zero_at_fixation_while_the_image_still_shows_the_shift() -> None:
    """The difference between `asked`, which is old, and `to_go`, which is present."""
    task = begun(30)
    inputs = Inputs("predicted", task.head)
    memory = np.tile(inputs.initial(), (30, 1))
    inputs.update(task.layout.decode(task.encoded), memory)[0]
    for _ in range(9):
        task.step(np.zeros((30, 4)))
        inputs.update(task.layout.decode(task.encoded), memory)[0]
    truth = task.truth()
    goal = task.head.fixate(truth.target)[:, 3:]
    limits = task.layout.action_limits
    left, shown = [], []
    for _ in range(12):
        # the lag is undone by a law on the present angles, which only the truth knows
        truth = task.truth()
        speed = (goal - truth.positions[:, 3:]) * 60.0 - truth.velocities[:, 3:]
        task.step(np.clip(speed / limits, -1, 1))
        values = inputs.update(task.layout.decode(task.encoded), memory)[0]
        truth = task.truth()
        left.append(np.abs(goal - truth.positions[:, 3:]))
        shown.append(np.abs(1.5 * channel(inputs, values, "to_go")))
        if len(left) == 7:
            asked = 1.5 * channel(inputs, values, "asked")
    # the present is that of the next command, which may act up to two periods later; both are
    # folded to the direction in which the law turns the joint
    for k in range(9):
        span = np.array(left[k : k + 4])
        assert (shown[k] > span.min(axis=0) - 0.002).all()
        assert (shown[k] < span.max(axis=0) + 0.002).all()
    assert (asked >= 0.0).all()
    assert np.linalg.norm(asked, axis=-1).min() > 0.02


def test_the_inputs_tell_what_the_predictor_has_found_of_the_loop() -> None:
    variation = {"acceleration_ratio": (0.5, 0.5), "speed_gain": (1.1, 1.1)}
    task = begun(20, variation=variation)
    inputs = Inputs("to_go", task.head)
    memory = np.tile(inputs.initial(), (20, 1))
    first = inputs.update(task.layout.decode(task.encoded), memory)[0]
    for step in range(120):
        # there and back, each way long enough to come to full speed
        task.step(np.full((20, 4), 0.4 if step // 20 % 2 else -0.4))
        last = inputs.update(task.layout.decode(task.encoded), memory)[0]
    for name in ("acceleration", "gain"):
        assert (channel(inputs, first, name) == 0.0).all()
    # the estimator's own tests say how well it finds them
    ratio = np.exp(channel(inputs, last, "acceleration") * np.log(4.0))
    gain = np.exp(channel(inputs, last, "gain") * np.log(1.5))
    assert np.median(ratio) == pytest.approx(0.5, abs=0.1)
    assert np.median(gain) == pytest.approx(1.1, abs=0.03)
    for name in ("acceleration_sd", "latency_sd"):
        assert (channel(inputs, last, name) < channel(inputs, first, name)).all()


def test_the_rate_of_a_target_that_moves_is_seen_and_that_of_one_at_rest_is_none() -> None:
    for target, moves in (({"kind": "orbit"}, True), ({"kind": "random"}, False)):
        task = begun(20, target=target)
        inputs = Inputs("to_go", task.head)
        memory = np.tile(inputs.initial(), (20, 1))
        for _ in range(60):
            task.step(np.zeros((20, 4)))
            values = inputs.update(task.layout.decode(task.encoded), memory)[0]
        rates = np.abs(channel(inputs, values, "rate")).max(axis=-1)
        assert ((rates > 0.0).mean() > 0.8) == moves
        assert moves or not rates.any()


def test_before_the_first_image_nothing_is_known() -> None:
    task = begun(4)
    inputs = Inputs("to_go", task.head)
    memory = np.tile(inputs.initial(), (4, 1))
    for step in range(12):
        known = channel(inputs, inputs.update(task.layout.decode(task.encoded), memory)[0], "known")
        assert (known == (step >= 8)).all()  # images are 8 periods old
        task.step(np.zeros((4, 4)))


def test_a_joint_left_to_itself_comes_to_rest_where_the_inputs_say() -> None:
    """`to_rest_middle` while the joint is fast is `to_go` once it rests."""
    task = begun(40)
    inputs = Inputs("to_go", task.head)
    memory = np.tile(inputs.initial(), (40, 1))
    for step in range(14):
        inputs.update(task.layout.decode(task.encoded), memory)[0]
        # begins once the target is known, so that no image is dated wrong
        task.step(np.full((40, 4), 0.0 if step < 10 else 0.2))
    moving = inputs.update(task.layout.decode(task.encoded), memory)[0]
    for _ in range(40):
        task.step(np.zeros((40, 4)))
        resting = inputs.update(task.layout.decode(task.encoded), memory)[0]
    assert (np.abs(channel(inputs, moving, "velocity")) > 0.1).all()
    expected = 0.1 * channel(inputs, resting, "to_go_middle")
    inside = np.abs(expected) < 0.09
    assert inside.sum() > 10
    # 1 mrad is 0.6 px: what the goal's estimate moves by with later images
    shown = 0.1 * channel(inputs, moving, "to_rest_middle")
    assert shown[inside] == pytest.approx(expected[inside], abs=1e-3)


def test_each_joint_finds_its_own_numbers() -> None:
    for kind in ("predicted", "to_go"):
        with named(kind):
            inputs = Inputs(kind, load_head("simulated"))
            places = inputs.by_joint
            joints = ("left_tilt", "left_pan", "right_tilt", "right_pan")
            for row, joint in zip(places, joints, strict=True):
                assert all(inputs.names[i].endswith(joint) for i in row)
            assert sorted(places.ravel()) == list(range(inputs.size))


def test_a_manifest_of_other_channels_is_refused() -> None:
    for change, message in [
        ({"version": 99}, "inputs.version: expected 2, got 99"),
        ({"names": ["asked"]}, "inputs.names: expected the 76 of to_go"),
    ]:
        with named(change, message):
            head = load_head("simulated")
            fields = {**Inputs("to_go", head).to_dict(), **change}
            with pytest.raises(ConfigurationError, match=message):
                Inputs.from_dict(fields, head)
