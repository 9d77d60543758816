"""Laws in a loop with faults: images used once, detections held back or bridged, whole steps."""

import itertools
from math import ceil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.controllers.loops import begin
from tests.naming import named
from vergence import load_head, make_controller
from vergence.controllers.gate import (
    GATE_STATE,
    MAX_BRIDGED_S,
    MAX_HELD_DETECTIONS,
    CommandQuantiser,
    GatedDetections,
    OutlierGate,
    is_fresh,
)
from vergence.controllers.prediction.state import PREDICTOR_STATE
from vergence.envs.observation import AGE_S, Observation, ObservationLayout
from vergence.envs.task import GazeTask
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import load_scenario

HEAD = load_head("simulated")
LAYOUT = ObservationLayout.of(HEAD)
PERIOD_S, LATENCY_S = HEAD.timing.period_s, HEAD.timing.latency_s
HERE = np.array([[3.0, -2.0], [1.0, 4.0]])
ASIDE = np.array([[60.0, -70.0], [0.0, 0.0]])
MISSED = np.array([[np.nan, np.nan], [0.0, 0.0]])


def pass_on(errors, speed_rad_s=0.0, every=1, head=HEAD) -> list[GatedDetections]:
    """Detections that pass the gate, for (2, 2) errors, px, of images some periods apart."""
    gate = OutlierGate(head, LAYOUT)
    state, found = gate.initial(), []
    for k, error in enumerate(errors):
        for age in range(every):
            seen = Observation(
                pixel_error=np.asarray(error), visible=np.isfinite(error).all(axis=-1),
                image_age_s=np.asarray(LATENCY_S + age * PERIOD_S), positions=np.full(7, 0.01 * k),
                positions_at_exposure=np.full(7, 0.001 * k), velocities=np.full(7, speed_rad_s),
                last_command=np.zeros(4),
            )  # fmt: skip
            found.append(gate.update(seen, state))
    return found


def shown(found: list[GatedDetections]) -> np.ndarray:
    """(steps, 2, 2) the errors let through."""
    return np.array([one.pixel_error for one in found])


def test_one_outlier_is_as_a_frame_that_was_dropped() -> None:
    for every in [1, 4]:
        with named(every):
            found = pass_on([HERE, HERE, HERE + ASIDE, HERE + 0.5, HERE], every=every)
            left = shown(found)[2 * every : 3 * every, 0]
            assert (left == HERE[0]).all()
            during = found[2 * every]
            # the eye that is not disturbed goes on; the other keeps the angles of its own exposure
            assert during.fresh.tolist() == [0.0, 1.0]
            assert during.positions_at_exposure[3:] == pytest.approx([0.001, 0.001, 0.002, 0.002])
            after = found[3 * every]
            assert np.array_equal(after.pixel_error, HERE + 0.5)
            assert after.fresh.tolist() == [1.0, 1.0]
            assert not any(one.jumped.any() for one in found)
    errors = [HERE, HERE + ASIDE, HERE - ASIDE, HERE, HERE + ASIDE, HERE]
    assert (shown(pass_on(errors)) == HERE).all()


def test_a_second_detection_beside_the_first_is_a_jump() -> None:
    for every in [1, 4]:
        with named(every):
            there = HERE + ASIDE
            found = pass_on([HERE, there, there + 0.3, there], every=every)
            assert np.array_equal(found[every].pixel_error[0], HERE[0])
            confirmed = found[2 * every]
            assert np.array_equal(confirmed.pixel_error, there + 0.3)
            assert confirmed.jumped.tolist() == [1.0, 0.0]
            assert not found[3 * every].jumped.any()


def test_a_target_that_begins_to_move_is_held_back_for_one_frame_and_then_followed() -> None:
    step = np.full((2, 2), 9.0)
    errors = [HERE, HERE, *(HERE + k * step for k in range(1, 12))]
    found = pass_on(errors)
    assert np.array_equal(found[2].pixel_error, HERE)
    assert np.array_equal(shown(found[3:]), errors[3:])
    assert not any(one.jumped.any() for one in found)


def test_detections_that_agree_with_nothing_are_not_held_back_for_ever() -> None:
    around = [np.array([np.cos(a), np.sin(a)]) for a in (0.0, 2.1, 4.2, 0.8, 2.9)]
    errors = [HERE, *(HERE + 80.0 * direction for direction in around)]
    found = shown(pass_on(errors))
    assert (found[1 : 1 + MAX_HELD_DETECTIONS] == HERE).all()
    assert np.array_equal(found[1 + MAX_HELD_DETECTIONS], errors[1 + MAX_HELD_DETECTIONS])


def test_eyes_that_turn_may_move_the_image() -> None:
    # 1 rad/s at 620 px/rad moves it by 5.2 px in a period
    turning = [HERE - 5.2 * k for k in range(8)]
    assert np.array_equal(shown(pass_on(turning, speed_rad_s=1.0)), turning)
    moved = [HERE, HERE + 12.0]
    assert np.array_equal(shown(pass_on(moved, speed_rad_s=1.0)), moved)
    assert np.array_equal(shown(pass_on(moved))[1], HERE)


def test_what_a_noisy_detector_sees_of_a_target_at_rest_passes() -> None:
    rng = np.random.default_rng(0)
    noisy = HEAD.replace(sensor={"detection_noise_px": 3.0})
    errors = list(HERE + rng.normal(0.0, 3.0, (500, 2, 2)))
    assert np.array_equal(shown(pass_on(errors, head=noisy)), errors)


def test_missed_detections_are_bridged_for_a_twentieth_of_a_second() -> None:
    assert np.isnan(shown(pass_on([np.full((2, 2), np.nan)] * 5))).all()
    bridged = round(MAX_BRIDGED_S / PERIOD_S)
    errors = [HERE, *(HERE + MISSED for _ in range(20)), HERE + ASIDE]
    found = pass_on(errors)
    left = shown(found)[:, 0]
    assert (left[: 1 + bridged] == HERE[0]).all()
    assert np.isnan(left[2 + bridged : 21]).all()
    assert found[20].fresh.tolist() == [1.0, 1.0]
    # what is seen after that is the target, wherever it is
    assert np.array_equal(left[21], (HERE + ASIDE)[0])
    assert (shown(found)[:, 1] == HERE[1]).all()


def test_one_missed_detection_is_bridged_however_seldom_images_come() -> None:
    found = shown(pass_on([HERE, HERE + MISSED, HERE + MISSED], every=8))[::8, 0]
    assert (found[1] == HERE[0]).all()
    assert np.isnan(found[2]).all()


def test_an_eye_that_turns_too_fast_to_see_is_not_bridged() -> None:
    slow = HEAD.replace(timing={"exposure_s": 0.01}, sensor={"max_smear_px": 6.0})
    for speed_rad_s, sees in ((0.2, True), (1.0, False)):
        found = pass_on([HERE, HERE + MISSED], speed_rad_s=speed_rad_s, head=slow)
        assert np.isfinite(found[1].pixel_error).all(axis=1).tolist() == [sees, True]


LATENCY = 8


def first(row: np.ndarray, layout: np.dtype) -> np.ndarray:
    """The record at the beginning of a controller's state."""
    return np.ascontiguousarray(row[..., : layout.itemsize // 8]).view(layout)[..., 0]


USED = {
    "pid": lambda row: first(row, GATE_STATE)["eyes"]["accepted_since_s"][:, 0],
    "pursuit": lambda row: first(row, PREDICTOR_STATE)["target"]["unseen_periods"][:, 0],
}
"""Time or periods since the left eye's last detection, with a gate and with a predictor."""


def ages(images: list[tuple[float, int]], steps: int) -> np.ndarray:
    """(steps,) image ages as observations have them, s, of exposures and arrivals in periods."""
    found = np.full(steps, AGE_S)
    for exposed, came in images:
        found[came:] = (np.arange(came, steps) - exposed) * PERIOD_S
    channel = np.minimum(found / AGE_S, 1.0).astype(np.float32)
    return channel.astype(np.float64) * AGE_S


def new(age_s: np.ndarray) -> list[int]:
    """The periods in which there is a new image."""
    before = np.append(AGE_S, age_s[:-1])
    pairs = enumerate(zip(age_s, before, strict=True))
    return [k for k, (age, last) in pairs if is_fresh.py_func(age, last, PERIOD_S)]


def used(name: str, age_s: np.ndarray) -> np.ndarray:
    """(steps, n) whether a controller takes in an image, for (steps, n) ages."""
    controller = make_controller(name, head=HEAD)
    fields = controller.layout.fields
    observation = np.zeros((age_s.shape[1], controller.layout.size), dtype=np.float32)
    observation[:, fields["visible"]] = 1.0
    state, taken = None, []
    for age in age_s:
        observation[:, fields["image_age"]] = age[:, None] / AGE_S
        _action, state = controller.predict(observation, state)
        taken.append(USED[name](state[0]) == 0.0)
    return np.array(taken)


def test_every_controller_uses_each_image_once_however_it_is_dated() -> None:
    for interval, name in itertools.product((1, 2, 4), USED):
        with named(interval, name):
            came = list(range(LATENCY, 40, interval))
            offsets = (0.0, 0.3, 0.5, 0.9, 1.7)
            columns = [ages([(k - LATENCY - one, k) for k in came], 40) for one in offsets]
            assert all(new(column) == came for column in columns)
            expected = np.isin(np.arange(40), came)
            assert (used(name, np.stack(columns, axis=1)) == expected[:, None]).all()


def test_images_that_are_dropped_that_stay_or_that_are_there_from_the_start() -> None:
    came = [k for k in range(LATENCY, 80, 4) if k % 3]
    assert new(ages([(k - LATENCY - 0.3, k) for k in came], 80)) == came
    # beyond 0.5 s the observation no longer tells its age
    assert new(ages([(0.3, LATENCY)], 200)) == [LATENCY]
    assert new(ages([(-12.4, 0)], 10)) == [0]
    assert new(np.full(50, AGE_S)) == []


def test_images_that_come_at_irregular_times_are_used_once() -> None:
    for seed, interval in itertools.product(range(2), (2.0, 4.0)):
        with named(seed, interval):
            rng = np.random.default_rng(seed)
            exposed = 0.37 + interval * np.arange(40)
            came = [ceil(time) for time in exposed + 6.0 + rng.uniform(0.0, 1.9, 40)]
            # of two that come within a period the newer one is seen
            found = new(ages(list(zip(exposed, came, strict=True)), 120))
            assert found == sorted(k for k in set(came) if k < 120)


def test_on_a_grid_of_time_each_image_of_a_late_head_is_new_once() -> None:
    task = begin(GazeTask(1, head=HEAD, plant="tests.envs.robot:Late"))
    age_s, frames = [], []
    for _ in range(2000):
        task.step(np.zeros((1, 4)))
        channel = task.observation[0, task.layout.fields["image_age"]]
        age_s.append(float(channel.item()) * AGE_S)
        frames.append(int(task.reading.frame[0]))
    came = np.flatnonzero(np.diff(frames, prepend=0) > 0)
    assert len(came) > 800
    assert new(np.array(age_s)) == came.tolist()


STEP = 0.024
LIMITS = np.full(4, 6.0)
STEPPED = HEAD.replace(sensor={"command_resolution_rad_s": STEP})


def sent(commands: np.ndarray) -> np.ndarray:
    """(steps, 4) what is sent of a series of commands."""
    steps, carried = CommandQuantiser(STEPPED, LIMITS), np.zeros(4)
    return np.array([steps.quantise(command, carried) for command in commands])


@given(st.lists(st.floats(-5.9, 5.9), min_size=4, max_size=4))
def test_the_mean_is_the_command(command) -> None:
    found = sent(np.tile(command, (60, 1)))
    # at any time no more than a step and a half is missing
    missing = np.cumsum(found - np.array(command), axis=0)
    assert np.abs(missing).max() <= 1.5 * STEP + 1e-9


@given(st.lists(st.floats(-7.0, 7.0), min_size=4, max_size=4))
def test_all_that_is_sent_is_whole_steps_that_move_within_the_limits(command) -> None:
    counts = sent(np.tile(command, (20, 1))) / STEP
    assert counts == pytest.approx(np.rint(counts), abs=1e-9)
    assert not (np.abs(np.rint(counts)) == 1.0).any()
    assert np.abs(counts).max() <= 250.0 + 1e-9


def test_what_exceeds_the_limits_is_not_made_up_for_later() -> None:
    later = sent(np.repeat([[7.0] * 4, [2.0] * 4], [20, 5], axis=0))[20:]
    assert np.abs(np.cumsum(later - 2.0, axis=0)).max() <= 3.0 * STEP + 1e-9


def test_a_command_of_rest_rests_and_forgets() -> None:
    slow = np.full((1, 4), 0.6 * STEP)
    assert not sent(np.concatenate([slow, slow, np.zeros((5, 4)), slow, slow]))[2:].any()
    assert sent(np.concatenate([slow] * 3))[2] == pytest.approx(np.full(4, 2.0 * STEP))


def test_where_commands_have_no_steps_they_are_sent_as_they_are() -> None:
    steps, carried = CommandQuantiser(HEAD, LIMITS), np.zeros(4)
    command = np.array([0.001, -0.002, 3.0, 0.0])
    assert np.array_equal(steps.quantise(command, carried), command)
    assert not carried.any()


LAWS = {
    "ibvs-tuned": {"gain": 3.0},
    "adaptive": {"lambda_zero": 3.0, "lambda_inf": 3.0},
    "pid": {"kp": 3.0, "ki": 0.0, "kd": 0.0},
    "fuzzy": {"kp": 3.0, "ki": 0.0, "kd": 0.0, "span_p": 0.0},
}
"""Options with which each is the article's law with a gain of 3."""


def trials(name, scenario, **options):
    scenario = load_scenario(scenario)
    controller = make_controller(name, scenario.model(), **options)
    return run_trials(controller, scenario, episodes=16, split="validation")


@pytest.mark.parametrize("name", ["adaptive", "pid"])
def test_where_there_is_no_fault_each_is_the_law_alone(name) -> None:
    alone = trials("ibvs", "workspace", gain=3.0)
    assert trials(name, "workspace", **LAWS[name]).error == pytest.approx(alone.error, abs=1e-3)


@pytest.mark.parametrize("name", ["ibvs-tuned", "fuzzy"])
def test_through_a_robots_loop_each_settles_where_the_law_alone_does_not(name) -> None:
    alone = np.isfinite(trials("ibvs", "hardware", gain=3.0).settle_s(2.0)).mean()
    guarded = np.isfinite(trials(name, "hardware", **LAWS[name]).settle_s(2.0)).mean()
    assert alone < 0.2
    assert guarded > 0.9
