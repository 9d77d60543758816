"""Outlier gate of the laws: detections held back, confirmed or bridged."""

import numpy as np
import pytest

from tests.naming import named
from vergence import load_head
from vergence.controllers.outlier_gate import (
    MAX_BRIDGED_S,
    MAX_HELD_DETECTIONS,
    GatedDetections,
    OutlierGate,
)
from vergence.envs.observation import Observation, ObservationLayout

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
