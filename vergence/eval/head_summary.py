"""Summary of a head: its reach, fields of view, precision and limits in numbers."""

from dataclasses import asdict, dataclass
from math import isfinite, isnan
from typing import Any, Final

import numpy as np

from vergence.eval.head_reach import Reach, find_reach, off_axis_reach_points
from vergence.models.camera import UNDISTORTED, Camera
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, EYES, CalibrationRecord, FloatArray
from vergence.models.posture import fixation_angles_and_visibility, midpoint_between_cameras
from vergence.triangulation.fix import triangulate_views

DEPTHS_M: Final = (0.5, 1.0, 2.0)
"""Depths at which the expected depth error is reported, m (chosen)."""


LEAST_RESIDUAL_PX: Final = 1e-3
"""Residual below which it counts as zero, px: the accuracy of the iterations that find it
(numerical)."""


@dataclass(frozen=True, kw_only=True)
class JointSummary:
    """One joint, or one actuator."""

    name: str
    moves: str
    """Parts that the joint turns: the neck, an eye, both eyes; or the joints that an actuator
    moves."""
    lower_deg: float
    upper_deg: float
    velocity_deg_s: float
    acceleration_rad_s2: float
    """Greatest acceleration; inf for no limit."""


@dataclass(frozen=True, kw_only=True)
class EyeSummary:
    """One eye's camera."""

    name: str
    width_px: int
    height_px: int
    focal_px: tuple[float, float]
    principal_px: tuple[float, float]
    lens: str
    """The lens model, or `pinhole`."""
    horizontal_deg: float
    """Field of view along the row of the principal point, through the lens."""
    vertical_deg: float
    """Field of view along the column of the principal point, through the lens."""
    folds: bool
    """True if the lens model folds back on itself within the image, where pixels have no rays."""


@dataclass(frozen=True, kw_only=True)
class HeadSummary:
    """A head in numbers."""

    name: str
    digest: str
    joints: tuple[JointSummary, ...]
    actuators: tuple[JointSummary, ...]
    """Actuators of the eyes, unless each joint has its own motor; empty otherwise."""
    eyes: tuple[EyeSummary, ...]
    baseline_mm: float
    """Distance between the cameras at rest, mm."""
    control_rate_hz: float
    frame_rate_hz: float
    latency_ms: float
    reach: Reach
    depth_error_mm: dict[str, float]
    """Standard deviation of depth straight ahead, mm, by the depth in m; nan out of reach."""
    detection_noise_px: float
    encoder_steps_deg: tuple[float, float]
    """Finest and coarsest quantisation of the actuators' encoders."""
    backlash_deg: float
    """Greatest backlash of an actuator."""
    least_error_px: float
    """Greatest residual: pixel error that the eyes cannot remove, at those depths straight ahead
    and at the sides of the reach."""
    assumptions: dict[str, str]
    calibration: CalibrationRecord | None
    """Record of the cameras' calibration, if the file has one."""

    @property
    def has_moving_eyes(self) -> bool:
        """True if the eyes move."""
        return bool(self.actuators) or any(joint.moves != "neck" for joint in self.joints)

    def json_document(self) -> dict[str, Any]:
        """The summary for JSON: null for missing values, "inf" for infinite ones."""
        document: dict[str, Any] = _json_value(asdict(self))
        return document


def _json_value(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _json_value(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(v) for v in value]
    if isinstance(value, float) and not isfinite(value):
        return None if isnan(value) else "inf"
    if isinstance(value, float):
        return float(f"{value:.12g}")  # removes rounding errors
    return value


def summarise_head(head: HeadModel) -> HeadSummary:
    """Summarise a head.

    The depth error of one fixation includes the head's sensor noise: the noise of detected pixels,
    the quantisation of encoders and the backlash of actuators. It includes no calibration error. If
    the eyes fixate the point exactly, it equals the depth error of `triangulate_gaze`.

    Args:
        head: one head, not a population.
    """
    ahead = midpoint_between_cameras(head) + np.array(DEPTHS_M)[:, None] * np.array([0.0, 0.0, 1.0])
    q, seen = fixation_angles_and_visibility(head, ahead)
    pixels = head.project(q, ahead)
    error_mm = 1000.0 * triangulate_views(head, q, pixels).sigma[:, 2]
    reach, off_px = find_reach(head), np.zeros(1)
    if head.actuation.count:
        looked_at = np.concatenate([ahead[seen], off_axis_reach_points(head, reach)])
        looked_at = looked_at[fixation_angles_and_visibility(head, looked_at)[1]]
        off_px = np.linalg.norm(head.least_error(looked_at), axis=-1)
    steps, plays = (
        np.degrees(values[EYES][: head.actuation.count])
        for values in (head.actuation.angle_step, head.actuation.backlash)
    )
    return HeadSummary(
        name=head.name,
        digest=head.digest,
        joints=joint_summaries(head),
        actuators=coupled_actuator_summaries(head),
        eyes=eye_summaries(head),
        baseline_mm=baseline_mm(head),
        control_rate_hz=head.timing.control_rate_hz,
        frame_rate_hz=head.timing.frame_rate_hz,
        latency_ms=1000.0 * head.timing.latency_s,
        reach=reach,
        depth_error_mm={
            f"{depth:g}": float(error) if ok else float("nan")
            for depth, error, ok in zip(DEPTHS_M, error_mm, seen, strict=True)
        },
        detection_noise_px=head.sensor.detection_noise_px,
        encoder_steps_deg=(float(min(steps, default=0.0)), float(max(steps, default=0.0))),
        backlash_deg=float(max(plays, default=0.0)),
        least_error_px=float(off_px.max(initial=0.0)),
        assumptions=dict(head.assumptions),
        calibration=head.calibration,
    )


def baseline_mm(head: HeadModel) -> float:
    """The distance between both cameras at rest, mm."""
    poses = head.camera_poses(head.rest())
    return 1000.0 * float(np.linalg.norm(poses[1, :3, 3] - poses[0, :3, 3]))


def eye_summaries(head: HeadModel) -> tuple[EyeSummary, ...]:
    """Both eyes' cameras, the left one first."""
    return tuple(_eye(Camera.of(head, eye), name) for eye, name in enumerate(EYE_NAMES))


def joint_summaries(head: HeadModel) -> tuple[JointSummary, ...]:
    """The joints of a head, those of the neck first."""
    carries: dict[str, list[str]] = {}
    place: dict[str, int] = {}
    for joint, name in enumerate(head.joints):
        if name:
            part = "neck" if joint < EYES.start else f"{EYE_NAMES[(joint - EYES.start) // 2]} eye"
            carries.setdefault(name, []).append(part)
            place.setdefault(name, joint)
    limits = head.limits
    return tuple(
        JointSummary(
            name=name,
            moves="both eyes" if len(parts) > 1 else parts[0],
            lower_deg=float(np.degrees(limits.lower[place[name]])),
            upper_deg=float(np.degrees(limits.upper[place[name]])),
            velocity_deg_s=float(np.degrees(limits.velocity[place[name]])),
            acceleration_rad_s2=float(limits.acceleration[place[name]]),
        )
        for name, parts in carries.items()
    )


def coupled_actuator_summaries(head: HeadModel) -> tuple[JointSummary, ...]:
    """Actuators of the eyes, unless each joint has its own motor; empty otherwise."""
    if head.actuators is None:
        return ()
    actuation = head.actuation
    return tuple(
        JointSummary(
            name=name,
            moves=_moved(head, actuation.to_joints[:, k]),
            lower_deg=float(np.degrees(actuation.lower[EYES][k])),
            upper_deg=float(np.degrees(actuation.upper[EYES][k])),
            velocity_deg_s=float(np.degrees(actuation.velocity[EYES][k])),
            acceleration_rad_s2=float(actuation.acceleration[EYES][k]),
        )
        for k, name in enumerate(actuation.names)
    )


def _moved(head: HeadModel, column: FloatArray) -> str:
    """The joints that an actuator moves, such as `l_pan - 0.5 r_pan`."""
    factors = {
        name: factor for name, factor in zip(head.joints[EYES], column, strict=True) if factor
    }
    text = " + ".join(
        name if factor == 1.0 else f"-{name}" if factor == -1.0 else f"{factor:g} {name}"
        for name, factor in factors.items()
    )
    return text.replace("+ -", "- ")


def _eye(camera: Camera, name: str) -> EyeSummary:
    (u, v), (right, bottom) = camera.principal.tolist(), (camera.width - 0.5, camera.height - 0.5)
    edges, folds = edge_rays(camera, np.array([[-0.5, v], [right, v], [u, -0.5], [u, bottom]]))
    angles = np.degrees(np.arctan(edges))
    corners = camera.rays([[-0.5, -0.5], [right, -0.5], [-0.5, bottom], [right, bottom]])
    return EyeSummary(
        name=name,
        width_px=camera.width,
        height_px=camera.height,
        focal_px=tuple(camera.focal.tolist()),
        principal_px=tuple(camera.principal.tolist()),
        lens=camera.lens.model if camera.distorts else UNDISTORTED,
        horizontal_deg=float(angles[1, 0] - angles[0, 0]),
        vertical_deg=float(angles[3, 1] - angles[2, 1]),
        folds=folds or bool(np.isnan(corners).any()),
    )


def edge_rays(camera: Camera, pixels: FloatArray) -> tuple[FloatArray, bool]:
    """Rays of pixels at an image's edge, or of the last pixels on the way there that have a ray.

    Args:
        camera: camera of the eye.
        pixels: (n, 2) raw pixels.

    Returns:
        (n, 2) rays (x / z, y / z), and True if any pixel at the edge had no ray.
    """
    rays = camera.rays(pixels)
    missing = np.asarray(np.isnan(rays).any(axis=1))
    if missing.any():
        centre = camera.principal
        share = np.linspace(0.0, 1.0, 5001)[:, None, None]
        on_the_way = centre + share * (pixels - centre)
        found = camera.rays(on_the_way.reshape(-1, 2)).reshape(on_the_way.shape)
        bad = np.isnan(found).any(axis=2)
        last = np.where(bad.any(axis=0), bad.argmax(axis=0) - 1, len(share) - 1)
        rays = np.where(missing[:, None], found[np.maximum(last, 0), range(len(pixels))], rays)
    return rays, bool(missing.any())
