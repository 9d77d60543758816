"""State of one head at one time, as pictures and the viewer show it."""

from typing import NamedTuple

import numpy as np

from vergence.envs.reading import BoolArray, Reading, Truth
from vergence.envs.task import (
    EyeImages,
    GazeTask,
    best_known_angles_and_target,
    given_or_drawn_eye_images,
)
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.triangulation import Fix, triangulate_gaze


class Moment(NamedTuple):
    """State of one head at one time."""

    time_s: float
    """Time since the trial's start, s."""
    positions: FloatArray
    """(7,) best known joint angles, rad."""
    velocities: FloatArray
    """(7,) measured joint velocities, rad/s."""
    target: FloatArray
    """(3,) best known position of the target in N, m; nan for none."""
    target_is_truth: bool
    """True if the target is ground truth, False if it is the fix by gaze."""
    pixels: FloatArray
    """(2, 2) raw pixels of the target in the newest image; nan if the eye does not see it."""
    errors_px: FloatArray
    """(2,) pixel error by eye, px: true if the target is ground truth, else measured."""
    fix: Fix
    """Fix by gaze from the measured joint angles, of one head."""
    images: EyeImages | None
    """The eyes' newest images; None for a robot without images."""
    image_age_s: float = 0.0
    """Time since the newest images were exposed or drawn, s."""
    detection_age_s: float = 0.0
    """Time since the exposure in which `pixels` were found, s: a simulation's images are newer."""

    @property
    def shows_tag(self) -> bool:
        """True if a tag stands at a known target: not in a room, whose images have colours."""
        return self.target_is_truth and (self.images is None or self.images.left.ndim == 2)

    @property
    def visible(self) -> BoolArray:
        """(2,) True if the eye sees the target in its newest image."""
        return np.asarray(np.isfinite(self.pixels).all(axis=-1))


def moment_of(task: GazeTask, n: int = 0) -> Moment:
    """Present moment of one head of a task.

    Args:
        task: the task.
        n: environment index.
    """
    positions, target = best_known_angles_and_target(task, n)
    truth, reading = task.truth(), task.reading
    errors = task.pixel_error if truth is None else truth.pixel_error
    gaze, _views = task.fixes()
    return Moment(
        time_s=float(reading.time_s[n]),
        positions=positions.copy(),
        velocities=reading.velocities[n].copy(),
        target=target.copy(),
        target_is_truth=truth is not None,
        pixels=reading.pixels[n].copy(),
        errors_px=np.linalg.norm(errors[n], axis=-1),
        fix=Fix._make(part[n] for part in gaze),
        images=given_or_drawn_eye_images(task, n),
        detection_age_s=float(reading.time_s[n] - reading.exposure_s[n]),
    )


def moment_of_reading(
    head: HeadModel,
    reading: Reading,
    truth: Truth,
    images: EyeImages | None,
    image_age_s: float = 0.0,
) -> Moment:
    """Moment of a recorded reading of one head.

    Args:
        head: the model that the controller used.
        reading: the reading; its arrays lack the axis over heads.
        truth: the ground truth of the same time, likewise; nan if it is unknown.
        images: the newest images.
        image_age_s: time since their exposure, s.
    """
    fix = triangulate_gaze(head, reading.positions)
    known = bool(np.isfinite(truth.target).all())
    true_positions = np.isfinite(truth.positions).all()
    return Moment(
        time_s=float(reading.time_s),
        positions=truth.positions if true_positions else reading.positions,
        velocities=reading.velocities,
        target=truth.target if known else fix.point,
        target_is_truth=known,
        pixels=reading.pixels,
        errors_px=pixel_errors(head, reading, truth),
        fix=fix,
        images=images,
        image_age_s=image_age_s,
        detection_age_s=float(reading.time_s - reading.exposure_s),
    )


def pixel_errors(head: HeadModel, reading: Reading, truth: Truth) -> FloatArray:
    """Pixel errors by eye: the true ones where the ground truth is known, else the measured ones.

    Args:
        head: the model that the controller used.
        reading: readings of shape (..., of one head).
        truth: the ground truth of the same times, likewise; nan where it is unknown.

    Returns:
        (..., 2) px.
    """
    measured = head.undistort(reading.pixels) - head.cameras.principal
    known = np.asarray(np.isfinite(truth.target).all(axis=-1))
    errors = np.where(known[..., None, None], truth.pixel_error, measured)
    return np.asarray(np.linalg.norm(errors, axis=-1))
