"""Photographs of targets at known places, drawn as the eyes of a head take them."""

from pathlib import Path

import cv2
import numpy as np

from vergence.models import HeadModel
from vergence.vision import Camera, TargetRenderer
from vergence.vision.targets import PlanarTarget


def pose_at(
    position_m: tuple[float, float, float] | np.ndarray,
    turn: tuple[float, float, float] | np.ndarray = (0.0, 0.0, 0.0),
) -> np.ndarray:
    """(4, 4) a target's frame in N, turned from facing the head by a rotation vector."""
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.asarray(turn, np.float64))[0]
    pose[:3, 3] = position_m
    return pose


def corners_in_space(target: PlanarTarget, pose: np.ndarray) -> np.ndarray:
    """(n, 3) where a target's corners are in N, metres."""
    flat = np.column_stack([target.corners_m, np.zeros(len(target.corners_m))])
    return flat @ pose[:3, :3].T + pose[:3, 3]


class Studio:
    """Both eyes of a head at joint angles, at rest by default, and a target before them."""

    def __init__(self, head: HeadModel, target: PlanarTarget, q: np.ndarray | None = None) -> None:
        self.target = target
        self.poses = head.camera_poses(head.rest() if q is None else q)
        self.drawings = [
            TargetRenderer(Camera.of(head, eye), target, head.rendering) for eye in range(2)
        ]

    def take(self, pose: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
        """The images of both eyes of the target at a pose in N."""
        images = []
        for drawing, T_N_C in zip(self.drawings, self.poses, strict=True):
            drawing.draw(np.linalg.inv(T_N_C) @ pose, rng)
            images.append(drawing.frame.copy())
        return images


def save_pair(folder: Path, name: str, images: list[np.ndarray]) -> tuple[Path, Path]:
    """Write a pair as `left/NAME` and `right/NAME`."""
    paths = []
    for side, image in zip(("left", "right"), images, strict=True):
        (folder / side).mkdir(parents=True, exist_ok=True)
        path = folder / side / name
        assert cv2.imwrite(str(path), image)
        paths.append(path)
    return paths[0], paths[1]
