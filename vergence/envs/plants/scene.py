"""Projection of moving targets into the eyes of moving heads, without delay or noise."""

from typing import NamedTuple

import numpy as np

from vergence.envs.plants.conditions import EnvIndex
from vergence.envs.reading import Truth
from vergence.envs.streams import IntArray
from vergence.envs.targets.motion import Motion, motion_position_at, unpack_motion
from vergence.kernels import compiled, inlined
from vergence.models.kinematics import (
    PackedHead,
    Vector,
    inside_image,
    neck_frame,
    pixel_error,
    point_in_eye,
    point_to_local,
    point_to_outer,
    point_to_pixel,
)
from vergence.models.parts import FloatArray


class TrueHeadsAndTargets(NamedTuple):
    """The true heads and their targets at present."""

    heads: FloatArray
    """(n or 1, PACKED) the true heads, see `vergence.models.kinematics`."""
    motions: FloatArray
    """(n, MOTION) motions of the targets, see `vergence.envs.targets.motion`."""
    necks: FloatArray
    """(n, 3) the neck's angles at the trials' start, rad."""
    step: IntArray
    """(n,) control periods since the trials' start."""
    positions: FloatArray
    """(n, 7) joint angles, rad."""
    velocities: FloatArray
    """(n, 7) joint velocities, rad/s."""


@inlined
def true_head_row(scene: TrueHeadsAndTargets, n: EnvIndex) -> PackedHead:
    """(PACKED,) true head of an environment."""
    head: PackedHead = scene.heads[np.uintp(n) * np.uintp(scene.heads.shape[0] > 1)]
    return head


@inlined
def target_position_in_n(
    p: PackedHead,
    motion: Motion,
    neck_at_start: FloatArray,
    neck: FloatArray | Vector,
    target_time_s: float,
) -> Vector:
    """Position of the target at its own time, in frame N as the neck holds it now, m."""
    x, y, z = motion_position_at(motion, target_time_s)
    if neck[0] == neck_at_start[0] and neck[1] == neck_at_start[1] and neck[2] == neck_at_start[2]:
        return x, y, z
    start = neck_frame(p, neck_at_start[0], neck_at_start[1], neck_at_start[2])
    x, y, z = point_to_outer(start, x, y, z)
    return point_to_local(neck_frame(p, neck[0], neck[1], neck[2]), x, y, z)


@inlined
def distorted_eye_pixel(
    p: PackedHead, eye: int, q: FloatArray, point: Vector
) -> tuple[float, float]:
    """Pixel of a point of N in an eye's image, distorted, px."""
    x, y, z = point_in_eye(p, eye, q[3 + 2 * eye], q[4 + 2 * eye], point[0], point[1], point[2])
    return point_to_pixel(p, eye, x, y, z, True)


@inlined
def image_displacement(
    p: PackedHead,
    motion: Motion,
    neck_at_start: FloatArray,
    eye: int,
    q: FloatArray,
    v: FloatArray,
    target_time_s: float,
    half_exposure_s: float,
) -> tuple[float, float]:
    """Displacement of the target's image while the shutter is open, px.

    A jump is not motion: a frame shows the target where it is in the middle of the exposure. So the
    first frame at or after a jump shows the target after the jump, without blur.

    Args:
        p: the true head.
        motion: the target's motion.
        neck_at_start: (3,) the neck's angles at the trial's start, rad.
        eye: index of the eye.
        q: (7,) joint angles in the middle of the exposure, rad.
        v: (7,) joint velocities then, rad/s.
        target_time_s: the middle of the exposure in the target's own time, s.
        half_exposure_s: half the exposure time, s.
    """
    tilt, pan = q[3 + 2 * eye], q[4 + 2 * eye]
    dt, dp = v[3 + 2 * eye] * half_exposure_s, v[4 + 2 * eye] * half_exposure_s
    yaw, roll, pitch = v[0] * half_exposure_s, v[1] * half_exposure_s, v[2] * half_exposure_s
    begin, end = target_time_s - half_exposure_s, target_time_s + half_exposure_s
    for jump in (motion.jump_time, motion.second_jump_time):
        if target_time_s >= jump:
            begin = max(begin, jump)
        elif end >= jump:
            end = min(end, target_time_s)
    ax, ay, az = target_position_in_n(
        p, motion, neck_at_start, (q[0] - yaw, q[1] - roll, q[2] - pitch), begin
    )
    bx, by, bz = target_position_in_n(
        p, motion, neck_at_start, (q[0] + yaw, q[1] + roll, q[2] + pitch), end
    )
    x, y, z = point_in_eye(p, eye, tilt - dt, pan - dp, ax, ay, az)
    ua, va = point_to_pixel(p, eye, x, y, z, True)
    x, y, z = point_in_eye(p, eye, tilt + dt, pan + dp, bx, by, bz)
    ub, vb = point_to_pixel(p, eye, x, y, z, True)
    return ub - ua, vb - va


@compiled
def update_truth(
    nominal: PackedHead,
    period_s: float,
    target_time_s: FloatArray,
    scene: TrueHeadsAndTargets,
    truth: Truth,
) -> None:
    """Update the ground truth.

    Args:
        nominal: (PACKED,) the head that the controller knows.
        period_s: the control period.
        target_time_s: (n,) the targets' own times, s.
        scene: `untyped_tuple`.
        truth: `untyped_tuple`, the result.
    """
    scene, truth = TrueHeadsAndTargets(*scene), Truth(*truth)
    for n in range(scene.step.shape[0]):
        truth.time_s[n] = scene.step[n] * period_s
        p, q = true_head_row(scene, n), scene.positions[n]
        for j in range(7):
            truth.positions[n, j], truth.velocities[n, j] = q[j], scene.velocities[n, j]
        motion = unpack_motion(scene.motions[n])
        point = target_position_in_n(p, motion, scene.necks[n], q, target_time_s[n])
        truth.target[n, 0], truth.target[n, 1], truth.target[n, 2] = point
        for eye in range(2):
            u, v = distorted_eye_pixel(p, eye, q, point)
            truth.image_visible[n, eye] = inside_image(p, eye, u, v)
            truth.pixels[n, eye, 0], truth.pixels[n, eye, 1] = u, v
            du, dv = pixel_error(nominal, eye, u, v)
            truth.pixel_error[n, eye, 0], truth.pixel_error[n, eye, 1] = du, dv
