"""One detection far off moves nothing; several in a row are a target that has jumped."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.controllers.loops import begin, drive
from vergence import load_head, make_controller
from vergence.envs.observation import FINE_PX
from vergence.envs.task import GazeTask

HEAD = load_head("simulated")
SETTLED = 90
"""Periods after which every trial has settled."""


def errors_after(
    name: str, spoil: Callable[[int, np.ndarray], np.ndarray], steps: int = 60
) -> np.ndarray:
    """(steps, 12, 2, 2) true errors of settled eyes whose detections are spoilt.

    `spoil` makes the detected errors of the elapsed periods and the pixel errors (12, 2, 2).
    """
    task = begin(GazeTask(12, head=HEAD, plant="kinematic"))

    def cover(observation: np.ndarray, k: int) -> None:
        if k >= SETTLED:
            detected = spoil(k - SETTLED, task.layout.decode(observation).pixel_error)
            flat, fields = detected.reshape(12, 4), task.layout.fields
            observation[:, fields["pixel_error"]] = flat / HEAD.cameras.size[0, 0]
            observation[:, fields["pixel_error_fine"]] = np.clip(flat / FINE_PX, -1.0, 1.0)

    trials = drive(task, make_controller(name, HEAD, task.layout), (SETTLED + steps) / 120, cover)
    return np.array([task.truth().pixel_error for _ in trials])[SETTLED:]


def directions(rng: np.random.Generator, size_px: float) -> np.ndarray:
    """(12, 2) errors of a detector in all directions."""
    angle = rng.uniform(0.0, 2.0 * np.pi, 12)
    return size_px * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


@pytest.mark.parametrize(
    ("name", "eyes", "size_px", "every"),
    [
        ("saccade", [0], 15.0, 60), ("pursuit", [1], 100.0, 60), ("state-feedback", [0], 100.0, 60),
        ("saccade", [0, 1], 100.0, 5),
    ],
)  # fmt: skip
def test_outliers_of_one_eye_move_nothing_even_if_others_follow(name, eyes, size_px, every) -> None:
    rng = np.random.default_rng(1)

    def spoil(k, error):
        if k % every == 0:
            error[:, eyes[k // every % len(eyes)]] += directions(rng, size_px)
        return error

    assert np.linalg.norm(errors_after(name, spoil), axis=-1).max() < 0.5


def test_outliers_of_both_eyes_in_one_image_move_nothing() -> None:
    def spoil(k, error):
        # two vertical errors are no place in space, whatever the horizontal ones are
        side = np.where(np.arange(12) % 2, 1.0, -1.0)[:, None, None]
        away = side * [[60.0, 80.0], [-60.0, -80.0]]
        return error + away if k == 0 else error

    assert np.linalg.norm(errors_after("state-feedback", spoil), axis=-1).max() < 0.5


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
    actions = drive(task, make_controller("saccade", HEAD, task.layout), 14 / 120)
    acted = [np.abs(action).max() for action in actions]
    # the first image of the new place comes eight periods after the jump
    assert max(acted[:8]) < 0.05
    assert acted[8] > 0.5
