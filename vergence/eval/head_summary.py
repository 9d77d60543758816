"""What a head can do, in the numbers that a buyer of one would ask for."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from math import isfinite, isnan
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.models.head import HeadModel
from vergence.models.joints import EYE_NAMES, EYES
from vergence.models.parts import FloatArray
from vergence.triangulation.fix import triangulate_gaze, triangulate_views
from vergence.vision.optics import EyeCamera

DEPTHS_M: Final = (0.5, 1.0, 2.0)
"""Where the expected depth error is told."""
_NEAREST_M, _FARTHEST_M = 0.01, 100.0
"""Between these depths the reach is looked for."""
_DIRECTION_M: Final = 1.0
"""At this distance the widest angles are looked for."""


@dataclass(frozen=True, kw_only=True)
class JointSummary:
    """One joint, or one actuator."""

    name: str
    moves: str
    """What it turns: the neck, an eye, both; or the joints that an actuator moves."""
    lower_deg: float
    upper_deg: float
    velocity_deg_s: float
    acceleration_rad_s2: float
    """inf where there is no limit."""


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
    """Whether the lens model folds back on itself inside the image: there is no ray there."""


@dataclass(frozen=True, kw_only=True)
class Reach:
    """Where both eyes can look at a point; of eyes that do not move, where both see it."""

    nearest_m: float
    """Straight ahead, from midway between the eyes; nan where there is no such depth."""
    farthest_m: float
    """Straight ahead; inf beyond 100 m."""
    left_deg: float
    """Widest angle from straight ahead at a distance of 1 m."""
    right_deg: float
    up_deg: float
    down_deg: float


@dataclass(frozen=True, kw_only=True)
class HeadSummary:
    """A head in numbers."""

    name: str
    digest: str
    joints: tuple[JointSummary, ...]
    actuators: tuple[JointSummary, ...]
    """What moves the eyes where it is not one motor a joint; empty otherwise."""
    eyes: tuple[EyeSummary, ...]
    baseline_mm: float
    """Between the cameras at rest."""
    control_rate_hz: float
    frame_rate_hz: float
    latency_ms: float
    reach: Reach
    depth_error_mm: dict[str, float]
    """One standard deviation of depth straight ahead by the depth in metres; nan out of reach."""
    detection_noise_px: float
    encoder_step_deg: float
    least_error_px: float
    """The greatest pixel error that is left at those depths where the eyes look at best."""
    assumptions: dict[str, str]

    @property
    def moves(self) -> bool:
        """Whether the eyes move."""
        return bool(self.actuators) or any(joint.moves != "neck" for joint in self.joints)

    def document(self) -> dict[str, Any]:
        """The same for JSON: null for what there is not, "inf" for what has no limit."""
        document: dict[str, Any] = _plain(asdict(self))
        return document


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not isfinite(value):
        return None if isnan(value) else "inf"
    return value


def summarise(head: HeadModel) -> HeadSummary:
    """Work out what a head can do.

    The depth error counts what the head's own sensors say of their noise: that of the detected
    pixel and the encoders' steps, of one fixation; no error of calibration.

    Args:
        head: one head, not a population.
    """
    poses = head.camera_poses(head.rest())
    centre = poses[:, :3, 3].mean(axis=0)
    moves = head.actuation.count > 0
    ahead = centre + np.array(DEPTHS_M)[:, None] * np.array([0.0, 0.0, 1.0])
    seen = _fixated(head, ahead) if moves else _seen_by_both(head, ahead)
    left = np.zeros(1)
    if moves and seen.any():
        left = np.linalg.norm(head.least_error(ahead[seen]), axis=-1)
    return HeadSummary(
        name=head.name,
        digest=head.digest,
        joints=tuple(_joints(head)),
        actuators=() if head.actuators is None else tuple(_actuators(head)),
        eyes=tuple(_eye(EyeCamera.of(head, eye), name) for eye, name in enumerate(EYE_NAMES)),
        baseline_mm=1000.0 * float(np.linalg.norm(poses[1, :3, 3] - poses[0, :3, 3])),
        control_rate_hz=head.timing.control_rate_hz,
        frame_rate_hz=head.timing.frame_rate_hz,
        latency_ms=1000.0 * head.timing.latency_s,
        reach=_reach(centre, lambda points: (_fixated if moves else _seen_by_both)(head, points)),
        depth_error_mm=dict(
            zip(
                (f"{depth:g}" for depth in DEPTHS_M),
                np.where(seen, _depth_error_mm(head, ahead, moves), np.nan).tolist(),
                strict=True,
            )
        ),
        detection_noise_px=head.sensor.detection_noise_px,
        encoder_step_deg=float(np.degrees(head.sensor.encoder_resolution_rad)),
        least_error_px=float(left.max()),
        assumptions=dict(head.assumptions),
    )


def _joints(head: HeadModel) -> list[JointSummary]:
    carries: dict[str, list[str]] = {}
    place: dict[str, int] = {}
    for joint, name in enumerate(head.joints):
        if name:
            part = "neck" if joint < EYES.start else f"{EYE_NAMES[(joint - EYES.start) // 2]} eye"
            carries.setdefault(name, []).append(part)
            place.setdefault(name, joint)
    limits = head.limits
    return [
        JointSummary(
            name=name,
            moves="both eyes" if len(parts) > 1 else parts[0],
            lower_deg=float(np.degrees(limits.lower[place[name]])),
            upper_deg=float(np.degrees(limits.upper[place[name]])),
            velocity_deg_s=float(np.degrees(limits.velocity[place[name]])),
            acceleration_rad_s2=float(limits.acceleration[place[name]]),
        )
        for name, parts in carries.items()
    ]


def _actuators(head: HeadModel) -> list[JointSummary]:
    actuation = head.actuation
    return [
        JointSummary(
            name=name,
            moves=_moved(head, actuation.to_joints[:, k]),
            lower_deg=float(np.degrees(actuation.lower[EYES][k])),
            upper_deg=float(np.degrees(actuation.upper[EYES][k])),
            velocity_deg_s=float(np.degrees(actuation.velocity[EYES][k])),
            acceleration_rad_s2=float(actuation.acceleration[EYES][k]),
        )
        for k, name in enumerate(actuation.names)
    ]


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


def _eye(camera: EyeCamera, name: str) -> EyeSummary:
    (u, v), (right, bottom) = camera.principal_px, (camera.width - 0.5, camera.height - 0.5)
    edges, folds = edge_rays(camera, np.array([[-0.5, v], [right, v], [u, -0.5], [u, bottom]]))
    angles = np.degrees(np.arctan(edges))
    corners = camera.rays([[-0.5, -0.5], [right, -0.5], [-0.5, bottom], [right, bottom]])
    return EyeSummary(
        name=name,
        width_px=camera.width,
        height_px=camera.height,
        focal_px=(camera.focal_px[0], camera.focal_px[1]),
        principal_px=(camera.principal_px[0], camera.principal_px[1]),
        lens=getattr(camera, "lens", "brown-conrady") if camera.distorts else "pinhole",
        horizontal_deg=float(angles[1, 0] - angles[0, 0]),
        vertical_deg=float(angles[3, 1] - angles[2, 1]),
        folds=folds or bool(np.isnan(corners).any()),
    )


def edge_rays(camera: EyeCamera, pixels: FloatArray) -> tuple[FloatArray, bool]:
    """Rays of pixels at an image's edge, or of the last on the way there that have one.

    Args:
        camera: the eye.
        pixels: (n, 2) raw pixels.

    Returns:
        (n, 2) rays (x / z, y / z), and whether any had none at the edge itself.
    """
    rays = camera.rays(pixels)
    missing = np.isnan(rays).any(axis=1)
    if missing.any():
        centre = np.array(camera.principal_px)
        share = np.linspace(0.0, 1.0, 2001)[:, None, None]
        on_the_way = centre + share * (pixels - centre)
        found = camera.rays(on_the_way.reshape(-1, 2)).reshape(on_the_way.shape)
        bad = np.isnan(found).any(axis=2)
        last = np.where(bad.any(axis=0), bad.argmax(axis=0) - 1, len(share) - 1)
        rays = np.where(missing[:, None], found[np.maximum(last, 0), range(len(pixels))], rays)
    return rays, bool(missing.any())


def _fixated(head: HeadModel, points: FloatArray) -> NDArray[np.bool_]:
    """(n,) whether both eyes can look at points of N."""
    q = head.fixate(points)
    poses = head.camera_poses(q)
    away = points[:, None] - poses[..., :3, 3]
    depths = np.einsum("nei,nei->ne", away, poses[..., :3, 2])
    found = np.isfinite(q).all(axis=-1) & (depths > 0.0).all(axis=-1)
    return np.asarray(found & head.reaches(q, -1e-9))


def _seen_by_both(head: HeadModel, points: FloatArray) -> NDArray[np.bool_]:
    """(n,) whether points of N are in both images at rest."""
    pixels = head.project(head.rest(), points)
    sizes = [(camera.width, camera.height) for camera in (EyeCamera.of(head, e) for e in (0, 1))]
    with np.errstate(invalid="ignore"):
        inside = (pixels >= -0.5) & (pixels <= np.array(sizes) - 0.5)
    return np.asarray(inside.all(axis=(-1, -2)))


def _reach(centre: FloatArray, can: Callable[[FloatArray], NDArray[np.bool_]]) -> Reach:
    forward = np.array([0.0, 0.0, 1.0])

    def at(depths: FloatArray) -> NDArray[np.bool_]:
        return can(centre + depths[:, None] * forward)

    depths = np.geomspace(_NEAREST_M, _FARTHEST_M, 2001)
    reached = np.flatnonzero(at(depths))
    nearest = farthest = np.nan
    if reached.size:
        nearest, farthest = depths[reached[0]], depths[reached[-1]]
        farthest = np.inf if reached[-1] == len(depths) - 1 else farthest
    angles = np.radians(np.linspace(0.0, 89.0, 891))
    widest = {}
    for name, axis, sign in (("left", 0, -1), ("right", 0, 1), ("up", 1, -1), ("down", 1, 1)):
        directions = np.cos(angles)[:, None] * forward
        directions[:, axis] += sign * np.sin(angles)
        failed = np.flatnonzero(~can(centre + _DIRECTION_M * directions))
        last = failed[0] - 1 if failed.size else len(angles) - 1
        widest[f"{name}_deg"] = float(np.degrees(angles[last])) if last >= 0 else float("nan")
    return Reach(nearest_m=float(nearest), farthest_m=float(farthest), **widest)


def _depth_error_mm(head: HeadModel, points: FloatArray, moves: bool) -> FloatArray:
    """(n,) one standard deviation along z of N, from the head's own sensors."""
    if moves:
        fix = triangulate_gaze(head, head.fixate(points))
    else:
        rest = head.rest()
        fix = triangulate_views(head, rest, head.project(rest, points))
    return np.asarray(1000.0 * fix.sigma[:, 2])
