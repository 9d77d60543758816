"""Scatter and bias of a detector on rendered images of a tag at rest."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from vergence.eval.article.common.closed_loop import MM
from vergence.eval.article.twin.fixation_errors import joint_angles_imaging_at
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray, Rendering
from vergence.vision import AprilTag, Camera, TargetRenderer, Tracker, make_detector
from vergence.vision.targets import board_pose


class DetectorNoise(NamedTuple):
    """Detection errors at one place or several, over poses of the tag within a pixel."""

    sigma_px: FloatArray
    """(..., 2, 2) by camera and coordinate: sample standard deviation at a pose, rms over poses."""
    bias_px: FloatArray
    """(..., 2, 2) by camera and coordinate: mean error at a fixed pose, rms over poses."""

    @classmethod
    def stacked(cls, noises: "Sequence[DetectorNoise]") -> "DetectorNoise":
        """Stack the errors at several places, one `DetectorNoise` each."""
        return cls(*(np.stack(part) for part in zip(*noises, strict=True)))

    def over_cameras(self) -> tuple[FloatArray, FloatArray]:
        """(...,) standard deviation and bias, rms over cameras and coordinates, px."""
        sigma, bias = (np.sqrt(np.mean(part**2, axis=(-2, -1))) for part in self)
        return sigma, bias

    def table(self, points: FloatArray) -> pd.DataFrame:
        """Rows of an experiment's table, one per place.

        Args:
            points: (places, 3) in N, m.
        """
        sigma, bias = self.over_cameras()
        return pd.DataFrame(
            {
                "case": "detector",
                "point": np.arange(1, len(points) + 1),
                "truth_z_mm": MM * points[:, 2],
                "sigma_px": sigma,
                "bias_px": bias,
            }
        )


def _detections(
    camera: Camera,
    rendering: Rendering,
    T_C_T: FloatArray,
    frames: int,
    rng: np.random.Generator,
) -> FloatArray:
    """(frames, 2) detected centres of a tag at a fixed pose, px; nan where not found."""
    tag = AprilTag()
    drawing, tracker = TargetRenderer(camera, tag, rendering), Tracker(make_detector(tag, camera))
    out = np.full((frames, 2), np.nan)
    for frame in range(frames):
        drawing.draw(T_C_T, rng)
        found = tracker.find(drawing.frame)
        if found is not None:
            out[frame] = found.point_px
    return out


def measure_pair_noise(
    cameras: tuple[Camera, Camera],
    rendering: Rendering,
    T_C_T: FloatArray,
    frames: int,
    rng: np.random.Generator,
) -> DetectorNoise:
    """Measure two cameras' detections of a tag.

    Args:
        cameras: both cameras.
        rendering: grey levels, blur and noise of their images.
        T_C_T: (poses, 2, 4, 4) the tag in each camera, metres.
        frames: number of images per pose.
        rng: source of the image noise.

    Returns:
        Scatter and bias.
    """
    sigma, bias = np.empty((2, len(T_C_T), 2, 2))
    for pose, both in enumerate(T_C_T):
        for eye, camera in enumerate(cameras):
            seen = _detections(camera, rendering, both[eye], frames, rng)
            sigma[pose, eye] = np.nanstd(seen, axis=0, ddof=1)
            bias[pose, eye] = np.nanmean(seen, axis=0) - camera.project(both[eye, None, :3, 3])[0]
    return DetectorNoise(*(np.sqrt(np.mean(part**2, axis=0)) for part in (sigma, bias)))


def measure_head_noise(
    head: HeadModel, point: FloatArray, poses: int, frames: int, rng: np.random.Generator
) -> DetectorNoise:
    """Measure detections of a tag that an exact head fixates to within half a pixel.

    Args:
        head: the head.
        point: (3,) the tag's centre in N, m.
        poses: number of fixations, each with another sub-pixel position of the tag.
        frames: number of images per fixation.
        rng: source of the fixations and of the image noise.

    Returns:
        Scatter and bias.
    """
    pixels = head.cameras.principal + rng.uniform(-0.5, 0.5, (poses, 2, 2))
    T_N_C = head.camera_poses(joint_angles_imaging_at(head, head, point, pixels))
    cameras = (Camera.of(head, 0), Camera.of(head, 1))
    T_C_T = np.linalg.inv(T_N_C) @ board_pose(point)
    return measure_pair_noise(cameras, head.rendering, T_C_T, frames, rng)
