"""One detection far off moves nothing; several in a row are a target that has jumped."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.controllers.loops import begin
from vergence import load_head, make_controller
from vergence.envs.observation import FINE_PX, ObservationLayout
from vergence.envs.task import GazeTask

HEAD = load_head("simulated")
SETTLED = 90
"""Periods after which every trial has settled."""


def errors_after(
    name: str, spoil: Callable[[int, np.ndarray], np.ndarray], steps: int = 60, num: int = 12
) -> np.ndarray:
    """(steps, num, 2, 2) true errors of settled eyes whose detections are spoilt.

    `spoil` makes the detected errors of the elapsed periods and the pixel errors (num, 2, 2).
    """
    task = begin(GazeTask(num, head=HEAD, plant="kinematic"))
    controller = make_controller(name, HEAD, task.layout)
    state, errors = None, []
    for k in range(SETTLED + steps):
        observation = task.observation
        if k >= SETTLED:
            seen = task.layout.decode(observation).pixel_error
            observation = detected(observation, task.layout, spoil(k - SETTLED, seen))
            errors.append(task.truth().pixel_error)
        action, state = controller.predict(observation, state)
        task.step(action)
    return np.array(errors)


def detected(
    observation: np.ndarray, layout: ObservationLayout, error_px: np.ndarray
) -> np.ndarray:
    """Observations in which detectors say other pixel errors."""
    changed = observation.copy()
    flat = error_px.reshape(len(observation), 4)
    changed[:, layout.fields["pixel_error"]] = flat / HEAD.cameras.size[0, 0]
    changed[:, layout.fields["pixel_error_fine"]] = np.clip(flat / FINE_PX, -1.0, 1.0)
    return changed


def directions(num: int, size_px: float) -> np.ndarray:
    """(num, 2, 2) errors of a detector, by eye, in all directions."""
    angle = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, (num, 2))
    return size_px * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


@pytest.mark.parametrize(
    ("name", "eye", "size_px"),
    [("saccade", 0, 15.0), ("pursuit", 1, 100.0), ("state-feedback", 0, 100.0)],
)
def test_one_outlier_in_one_eye_moves_nothing(name, eye, size_px) -> None:
    def spoil(k, error):
        if k == 0:
            error[:, eye] += directions(12, size_px)[:, eye]
        return error

    assert np.linalg.norm(errors_after(name, spoil), axis=-1).max() < 0.5


def test_outliers_of_both_eyes_in_one_image_move_nothing() -> None:
    def spoil(k, error):
        # two vertical errors are no place in space, whatever the horizontal ones are
        side = np.where(np.arange(12) % 2, 1.0, -1.0)[:, None, None]
        away = side * [[60.0, 80.0], [-60.0, -80.0]]
        return error + away if k == 0 else error

    assert np.linalg.norm(errors_after("state-feedback", spoil), axis=-1).max() < 0.5


def test_outliers_that_come_again_and_again_but_elsewhere_move_nothing() -> None:
    rng = np.random.default_rng(1)

    def spoil(k, error):
        if k % 5 == 0:
            angle = rng.uniform(0.0, 2.0 * np.pi, 12)
            error[:, k // 5 % 2] += 100.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return error

    assert np.linalg.norm(errors_after("saccade", spoil), axis=-1).max() < 0.5


def test_a_detection_that_stays_elsewhere_is_a_target_that_has_jumped() -> None:
    def spoil(k, error):
        error[:, 1, 0] += 40.0
        return error

    error = errors_after("pursuit", spoil)
    # it has waited for a quarter of a second, as the other eye sees its target where it was
    assert np.linalg.norm(error[-5:, :, 1] + [40.0, 0.0], axis=-1).max() < 2.0
    assert np.linalg.norm(error[:, :, 0], axis=-1).max() < 1.5


def test_a_jump_that_both_eyes_see_is_followed_at_its_first_image() -> None:
    target = {"kind": "step", "before": (0.0, -0.1, 1.0), "after": (0.1, -0.2, 0.9)}
    task = begin(GazeTask(1, head=HEAD, plant="kinematic", target=target))
    controller = make_controller("saccade", HEAD, task.layout)
    state, acted = None, []
    for _ in range(14):
        action, state = controller.predict(task.observation, state)
        acted.append(np.abs(action).max())
        task.step(action)
    # the first image of the new place comes eight periods after the jump
    assert max(acted[:8]) < 0.05
    assert acted[8] > 0.5
