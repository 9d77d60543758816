"""Present images of a task's eyes, given by the plant or drawn in place of missing ones."""

import functools
from typing import NamedTuple

import numpy as np

from vergence.envs.plants.eye_views import BoardImageRenderer
from vergence.envs.plants.simulation import Simulation
from vergence.envs.reading import Image
from vergence.envs.task import GazeTask
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.vision.targets import make_planar_target


class EyeImages(NamedTuple):
    """Images of both eyes: (height, width) grey levels, or (height, width, 3) RGB."""

    left: Image
    right: Image
    drawn: bool
    """True if the plant has no cameras, so that the images are drawn for the present posture."""

    def of(self, eye: int) -> Image:
        """Image of the left eye, 0, or of the right, 1."""
        return self.right if eye else self.left


def best_known_angles_and_target(task: GazeTask, n: int) -> tuple[FloatArray, FloatArray]:
    """Best known joint angles and target position of one head.

    Args:
        task: the task.
        n: environment index.

    Returns:
        (7,) joint angles, rad, and (3,) the target in N, m: the ground truth if it is known, else
        encoder angles and the fix by gaze.
    """
    truth = task.truth()
    if truth is not None:
        return truth.positions[n], truth.target[n]
    gaze, _views = task.fixes()
    return task.reading.positions[n], gaze.point[n]


def given_or_drawn_eye_images(task: GazeTask, n: int) -> EyeImages | None:
    """Present images of one head's eyes.

    Args:
        task: the task.
        n: environment index.

    Returns:
        Copies of the plant's own images, or, for a simulation without images, images drawn
        noise-free at the present posture; None for a robot without images.
    """
    frames = task.plant.frames(n)
    if frames is not None:
        # plants give blue, green and red
        left, right = (image[..., ::-1] if image.ndim == 3 else image for image in frames)
        return EyeImages(left.copy(), right.copy(), False)
    if not isinstance(task.plant, Simulation):
        return None
    positions, target = best_known_angles_and_target(task, n)
    left, right = _renderer(task.head).draw(positions, np.zeros(7), target)
    return EyeImages(left.copy(), right.copy(), True)


@functools.lru_cache(maxsize=4)
def _renderer(head: HeadModel) -> BoardImageRenderer:
    return BoardImageRenderer(head, make_planar_target("tag"))
