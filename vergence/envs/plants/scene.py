"""What the eyes of a moving head see of a moving target, without delay and noise."""

from typing import Any

from vergence._jit import compiled, device
from vergence.envs.targets.motion import position_at
from vergence.models.camera import inside_image, pixel_error, point_to_pixel
from vergence.models.kinematics import neck_frame, point_in_eye
from vergence.models.pose import into, out_of


@device
def target_in_n(p: Any, row: Any, anchor_neck: Any, q: Any, t: float) -> Any:
    """The target in the present N: it belongs to the world, N to the neck."""
    x, y, z = position_at(row, t)
    if q[0] == anchor_neck[0] and q[1] == anchor_neck[1] and q[2] == anchor_neck[2]:
        return x, y, z
    start = neck_frame(p, anchor_neck[0], anchor_neck[1], anchor_neck[2])
    x, y, z = out_of(start, x, y, z)
    return into(neck_frame(p, q[0], q[1], q[2]), x, y, z)


@device
def eye_pixel(p: Any, eye: int, q: Any, point: Any) -> Any:
    """Where an eye sees a point of N, distorted px."""
    x, y, z = point_in_eye(p, eye, q[3 + 2 * eye], q[4 + 2 * eye], point[0], point[1], point[2])
    return point_to_pixel(p, eye, x, y, z, True)


@device
def image_motion(
    p: Any, eye: int, q: Any, v: Any, row: Any, neck: Any, t: float, half: float
) -> Any:
    """How far the target's image moves while the shutter is open.

    A jump is no motion: the frame shows where the target is in the middle of the exposure, so
    the first frame at or after a jump shows it after the jump, sharp.
    """
    tilt, pan = q[3 + 2 * eye], q[4 + 2 * eye]
    dt, dp = v[3 + 2 * eye] * half, v[4 + 2 * eye] * half
    y, r, n = v[0] * half, v[1] * half, v[2] * half
    jump = row[16]
    begin = max(t - half, jump) if t >= jump else t - half
    end = t + half if t >= jump or t + half < jump else t
    ax, ay, az = target_in_n(p, row, neck, (q[0] - y, q[1] - r, q[2] - n), begin)
    bx, by, bz = target_in_n(p, row, neck, (q[0] + y, q[1] + r, q[2] + n), end)
    x, y, z = point_in_eye(p, eye, tilt - dt, pan - dp, ax, ay, az)
    ua, va = point_to_pixel(p, eye, x, y, z, True)
    x, y, z = point_in_eye(p, eye, tilt + dt, pan + dp, bx, by, bz)
    ub, vb = point_to_pixel(p, eye, x, y, z, True)
    return ub - ua, vb - va


@compiled
def look(
    heads: Any, nominal: Any, rows: Any, necks: Any, q: Any, step: Any, period: float,
    target: Any, pixels: Any, error: Any, inside: Any,
) -> None:  # fmt: skip
    """What the eyes would see at present without delay and noise, see `Truth`.

    Args:
        heads: (n or 1, PACKED) the true heads.
        nominal: (PACKED,) the head that the controller knows.
        rows: (n, MOTION) the targets.
        necks: (n, 3) the neck's angles at the trials' start, rad.
        q: (n, 7) true joint angles, rad.
        step: (n,) steps since the trials' start.
        period: control period, s.
        target: (n, 3) result, m.
        pixels: (n, 2, 2) result.
        error: (n, 2, 2) result.
        inside: (n, 2) result.
    """
    for n in range(q.shape[0]):
        p = heads[n if heads.shape[0] > 1 else 0]
        point = target_in_n(p, rows[n], necks[n], q[n], step[n] * period)
        target[n, 0], target[n, 1], target[n, 2] = point
        for eye in range(2):
            pu, pv = eye_pixel(p, eye, q[n], point)
            inside[n, eye] = inside_image(p, eye, pu, pv)
            pixels[n, eye, 0], pixels[n, eye, 1] = pu, pv
            error[n, eye, 0], error[n, eye, 1] = pixel_error(nominal, eye, pu, pv)
