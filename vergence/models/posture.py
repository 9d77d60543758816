"""A head at rest, and looking at a place: links and cameras, its size, and which way is up.

N defines the upright direction: its y axis points down. The article's frame 0 has z up, and its
head at rest looks along -y.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.models.geometry import chain_end, rot_z
from vergence.models.head import HeadModel, describe_beyond_limits
from vergence.models.parts import EYES, NECK, FloatArray
from vergence.operands import as_operand

EYE_RADIUS_M: Final = 0.018
"""Radius of the drawn eyeball, m (chosen: about the housing of a small camera module)."""
_ARTICLE_BASELINE_M: Final = 0.092
"""Baseline of the article's head, m; shapes scale with it (physical: the article's head)."""
_FLOOR_BELOW_M: Final = 0.26
"""Distance of the floor below the lowest joint or camera, m (chosen: looks only)."""
N_UPRIGHT: Final = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])
"""N's axes at rest in a frame with z up and -y forward (physical: the definition of N)."""
_N_ORIGIN_M: Final = (-0.011, -0.06427, 0.0)
"""N's origin at rest in the article's frame 0, m (physical: the article's head)."""


class RestPoses(NamedTuple):
    """Poses and measures of a head at rest, all in frame 0."""

    links: FloatArray  # (B, 4, 4) poses of the links, in the order of `Links.bodies`
    frame_n: FloatArray  # (4, 4) T_0_N
    cameras: FloatArray  # (2, 4, 4) poses of both cameras
    upright_frame: FloatArray
    """(4, 4) pose of the upright frame: z up, -y forward, and N at the same pose in it as in the
    article's frame 0; the identity for the article's head."""
    eye_roots: FloatArray
    """(2, 3) positions of each eye's first joint, or of its camera if it does not move, m."""
    baseline_m: float
    """Distance of the two cameras, m."""
    scale: float
    """Ratio of the size of the head's parts to the article's, from the baseline, 0.5 to 1.7."""
    eye_radius_m: float
    """Radius of an eyeball, m; smaller for a narrow head, so that its eyes do not touch."""
    bar_ends: FloatArray
    """(2, 3) ends of a bar behind both eyes' first joints, m."""
    stand_top: FloatArray
    """(3,) top of the stand, m: below the neck, or at the middle of the bar."""
    floor_m: float
    """Height of the floor in the upright frame, m, below the lowest joint and camera."""


def rest_poses(head: HeadModel) -> RestPoses:
    """Compute the poses of a head's links, base and cameras at rest, and its upright frame."""
    q, links = head.rest(), head.links.bodies()
    frames = np.tile(np.eye(4), (len(links) + 1, 1, 1))  # the last one is the base's, at -1
    for place, body in enumerate(links):
        frames[place] = frames[body.parent] @ body.pose @ rot_z(q[body.joints[0]])
    base, upright = head.base_pose(q), np.eye(4)
    upright[:3, :3] = base[:3, :3] @ N_UPRIGHT.T
    upright[:3, 3] = base[:3, 3] - upright[:3, :3] @ _N_ORIGIN_M
    whole = np.round(upright)  # without the noise of rounding, so that files stay readable
    upright = np.where(np.abs(upright - whole) < 1e-15, whole + 0.0, upright)
    cameras = base @ head.camera_poses(q)
    roots = np.array(cameras[:, :3, 3])
    for eye in range(2):
        chain = [i for i, body in enumerate(links) if {3 + 2 * eye, 4 + 2 * eye} & {*body.joints}]
        if chain:
            roots[eye] = frames[chain[0], :3, 3]
    baseline_m = float(np.linalg.norm(cameras[1, :3, 3] - cameras[0, :3, 3]))
    scale = float(np.clip(baseline_m / _ARTICLE_BASELINE_M, 0.5, 1.7))
    eye_radius_m = EYE_RADIUS_M * float(np.clip(baseline_m / 0.06, 0.1, 1.0))
    bar_ends = roots - 1.6 * eye_radius_m * base[:3, 2]
    stand_top = bar_ends.mean(axis=0)
    if chain_end(links, None) >= 0:
        stand_top = frames[0, :3, 3] - 0.03 * scale * upright[:3, 2]
    points = np.concatenate([frames[:-1, :3, 3], cameras[:, :3, 3]])
    floor_m = float(((points - upright[:3, 3]) @ upright[:3, 2]).min()) - _FLOOR_BELOW_M
    return RestPoses(
        links=frames[:-1],
        frame_n=base,
        cameras=cameras,
        upright_frame=upright,
        eye_roots=roots,
        baseline_m=baseline_m,
        scale=scale,
        eye_radius_m=eye_radius_m,
        bar_ends=bar_ends,
        stand_top=stand_top,
        floor_m=floor_m,
    )


def midpoint_between_cameras(head: HeadModel) -> FloatArray:
    """Midway between the cameras at rest, (3,) in N, m."""
    return np.asarray(head.camera_poses(head.rest())[:, :3, 3].mean(axis=0), np.float64)


def fixation_angles_and_visibility(
    head: HeadModel, points: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Joint angles at which both eyes look at points of N, and a mask of the visible points.

    Fixed eyes keep their pose; eyes that cannot fixate exactly take the angles of the least error.

    Args:
        head: one head, not a population.
        points: (n, 3) in N, m.

    Returns:
        (n, 7) joint angles with the neck at rest, rad; (n,) True if the angles are within limits
        and both eyes see the point.
    """
    rest = head.rest()
    if head.actuation.count:
        q = head.fixate(points, rest[NECK])
        can = head.reaches(q, -1e-9)
    else:
        q = np.broadcast_to(rest, (len(points), len(rest)))
        can = np.ones(len(points), np.bool_)
    pixels = head.project(q, points)  # nan behind a camera
    inside = (pixels >= -0.5) & (pixels <= head.cameras.size - 0.5)
    return q, np.asarray(can & inside.all(axis=(-1, -2)), np.bool_)


class LookAt(NamedTuple):
    """Joint angles of a head that looks at a place, and how well it will; `str` says the latter."""

    positions: FloatArray
    """(7,) joint angles, rad."""
    sigma_px: FloatArray
    """(2, 2) standard deviation of the place's pixel from the principal point, by eye and image
    axis, px; nan if the head's joints are not calibrated."""

    def __str__(self) -> str:
        if not np.isfinite(self.sigma_px).all():
            return "looking by the model alone: an uncalibrated one, so that the error is unknown"
        worse = float(np.sqrt(np.square(self.sigma_px).sum(axis=-1)).max())
        return f"looking by the model alone: expect {worse:.2g} px off, by calibration and encoders"


def look_at(head: HeadModel, point: ArrayLike, neck: ArrayLike = 0.0) -> LookAt:
    """Look at a place in space by the head's model, without an image.

    The error to expect is that of the calibration, the root mean square of the reprojection in
    images that it had not used, and that of encoders that round, uniform over a step.

    Args:
        head: the head.
        point: (3,) place in N, m; N moves with the neck.
        neck: (3,) or a scalar, the neck's angles, rad.

    Raises:
        ConfigurationError: the eyes cannot fixate the place; the message says why.

    Examples:
        >>> from vergence import load_head, look_at
        >>> look_at(load_head("simulated"), [0.0, -0.1, 1.0]).positions.shape
        (7,)
    """
    place = as_operand("point", point, 3)
    q = head.fixate(place, neck, warn=False)
    why = describe_beyond_limits(head, q) if np.isfinite(q).all() else "the eyes have no angles"
    if place.shape != (3,) or why:
        raise ConfigurationError(
            f"point: expected a place (x, y, z) in N, m, that both eyes can fixate, got "
            f"{np.asarray(point).tolist()!r:.80}" + (f", for which {why}" if why else "")
        )
    record, sigma = head.calibration, np.full((2, 2), np.nan)
    if record is not None and any(name.endswith(_JOINT_NUMBERS) for name in record.sigma):
        step = head.sensor.encoder_resolution_rad
        turned = q + step * np.eye(7)[EYES]
        change = head.project(turned, place) - head.project(q, place)
        encoders = np.square(np.nan_to_num(change)).sum(axis=0) / 12.0
        sigma = np.sqrt(encoders + 0.5 * record.rms_heldout_px**2)
    return LookAt(q, sigma)


_JOINT_NUMBERS: Final = (".offset", ".alpha", ".origin.x", ".axis.rx", ".rx", ".ry")
"""Ends of the names of the numbers of joints, see `HeadModel.parameters`."""
