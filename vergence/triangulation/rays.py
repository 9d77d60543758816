"""Point nearest to two lines of sight, and its derivatives by pixels and joints.

The rays `o_l + s d_l` and `o_r + t d_r` in N are closest at the ends of their common perpendicular
(Eqs. 18 to 23):

    [ d_l.d_l  -d_l.d_r ] [s]   [ -d_l.w ]
    [-d_l.d_r   d_r.d_r ] [t] = [  d_r.w ],   w = o_l - o_r

and the fix is the midpoint of the perpendicular (Eq. 24). The derivatives of the point follow from
the derivatives of this 2x2 system: a joint about the axis (z_i, o_i) changes a ray by
`do = z_i x (o - o_i)` and `dd = z_i x d`; a pixel changes only its direction. Coupled joints share
their actuator's error: their effects on the point are added before they are squared.
"""

from math import inf, isfinite, nan, sqrt
from typing import Final, NamedTuple

from numpy import bool_
from numpy.typing import NDArray

from vergence.kernels import inlined, kernel
from vergence.models.kinematics import (
    PACKED,
    EyeFrames,
    PackedHead,
    Pose,
    Vector,
    camera_of,
    direction_to_outer,
    eye_frames,
    has_motor_per_joint,
    joint_per_actuator,
    point_to_outer,
    undistort_pixel,
)
from vergence.models.lens import distort, is_distorted, pinhole_ray
from vergence.models.parts import FloatArray

MIN_ANGLE_RAD: Final = 1e-4
"""Least angle between two rays for a fix, rad; with a baseline of 92 mm they cross at 900 m
(chosen: range against noise)."""


class Ray(NamedTuple):
    """A line of sight in N: o + s d for s > 0, metres."""

    origin: Vector
    direction: Vector


class Crossing(NamedTuple):
    """Two rays, and the distances s and t along them to their common perpendicular."""

    left: Ray
    right: Ray
    s: float
    t: float


@inlined
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@inlined
def _midpoint_rate(crossing: Crossing, eye: int, do: Vector, dd: Vector) -> Vector:
    """Derivative of the midpoint for changes do and dd of one eye's ray origin and direction."""
    (ol, dl), (orr, dr), s, t = crossing
    w = (ol[0] - orr[0], ol[1] - orr[1], ol[2] - orr[2])
    a, b, c = _dot(dl, dl), _dot(dl, dr), _dot(dr, dr)
    if eye == 0:
        da, db, dc = 2.0 * _dot(dl, dd), _dot(dd, dr), 0.0
        r1 = -_dot(dd, w) - _dot(dl, do) - (da * s - db * t)
        r2 = _dot(dr, do) + db * s
    else:
        da, db, dc = 0.0, _dot(dl, dd), 2.0 * _dot(dr, dd)
        r1 = _dot(dl, do) + db * t
        r2 = _dot(dd, w) - _dot(dr, do) + db * s - dc * t
    det = a * c - b * b
    ds, dt = (c * r1 + b * r2) / det, (b * r1 + a * r2) / det
    r = s if eye == 0 else t
    e = (do[0] + r * dd[0], do[1] + r * dd[1], do[2] + r * dd[2])
    return (
        0.5 * (e[0] + ds * dl[0] + dt * dr[0]),
        0.5 * (e[1] + ds * dl[1] + dt * dr[1]),
        0.5 * (e[2] + ds * dl[2] + dt * dr[2]),
    )


@inlined
def ray_of_pixel(p: PackedHead, eye: int, camera: Pose, u: float, v: float) -> Ray:
    """Compute the ray in N of a raw pixel, with unit z in the camera; nan if the lens has none."""
    u, v = undistort_pixel(p, eye, u, v)
    x, y = pinhole_ray(camera_of(p, eye), u, v)
    return Ray((camera.x, camera.y, camera.z), direction_to_outer(camera, x, y, 1.0))


@inlined
def distances_to_perpendicular(left: Ray, right: Ray) -> tuple[float, float, bool]:
    """Distances along two rays to their common perpendicular, and True if there is a fix."""
    (ol, dl), (orr, dr) = left, right
    w = (ol[0] - orr[0], ol[1] - orr[1], ol[2] - orr[2])
    a, b, c = _dot(dl, dl), _dot(dl, dr), _dot(dr, dr)
    det = a * c - b * b
    if not (isfinite(det) and det > MIN_ANGLE_RAD * MIN_ANGLE_RAD * a * c):
        return nan, nan, False
    r1, r2 = -_dot(dl, w), _dot(dr, w)
    s, t = (c * r1 + b * r2) / det, (b * r1 + a * r2) / det
    return s, t, 0.0 < s < inf and 0.0 < t < inf


@inlined
def _add_outer(covariance: FloatArray, e: Vector, sigma: float) -> None:
    for row in range(3):
        for column in range(3):
            covariance[row, column] += sigma * sigma * e[row] * e[column]


@inlined
def _add_pixel_noise(
    covariance: FloatArray,
    p: PackedHead,
    eye: int,
    pose: Pose,
    pixel: FloatArray,
    sigma: FloatArray,
    crossing: Crossing,
) -> None:
    camera = camera_of(p, eye)
    # normalised direction per raw pixel: the inverse of the distortion's Jacobian
    jxx, jxy, jyy = 1.0, 0.0, 1.0
    if is_distorted(camera):
        u, v = undistort_pixel(p, eye, pixel[0], pixel[1])
        x, y = pinhole_ray(camera, u, v)
        bent = distort(camera, x, y)
        det = bent.dxx * bent.dyy - bent.dxy * bent.dxy
        jxx, jxy, jyy = bent.dyy / det, -bent.dxy / det, bent.dxx / det
    still = (0.0, 0.0, 0.0)
    du = direction_to_outer(pose, jxx / camera.focal_u, jxy / camera.focal_u, 0.0)
    dv = direction_to_outer(pose, jxy / camera.focal_v, jyy / camera.focal_v, 0.0)
    _add_outer(covariance, _midpoint_rate(crossing, eye, still, du), sigma[0])
    _add_outer(covariance, _midpoint_rate(crossing, eye, still, dv), sigma[1])


@inlined
def _joint_rate(eye: int, axis: Pose, crossing: Crossing) -> Vector:
    """Derivative of the midpoint by an eye's rotation about the z axis of a frame, m/rad."""
    origin, direction = crossing.left if eye == 0 else crossing.right
    z = (axis.xz, axis.yz, axis.zz)
    arm = (origin[0] - axis.x, origin[1] - axis.y, origin[2] - axis.z)
    return _midpoint_rate(crossing, eye, _cross(z, arm), _cross(z, direction))


@inlined
def _add_joint_noise(
    covariance: FloatArray,
    p: PackedHead,
    left: EyeFrames,
    right: EyeFrames,
    sigma: FloatArray,
    crossing: Crossing,
) -> None:
    rates = (
        _joint_rate(0, left.after_first_joint, crossing),
        _joint_rate(0, left.after_second_joint, crossing),
        _joint_rate(1, right.after_first_joint, crossing),
        _joint_rate(1, right.after_second_joint, crossing),
    )
    if has_motor_per_joint(p):
        for j in range(4):
            _add_outer(covariance, rates[j], sigma[3 + j])
        return
    # an actuator's error turns all of its joints together
    for k in range(4):
        x = y = z = 0.0
        for j in range(4):
            share = joint_per_actuator(p, j, k)
            x, y, z = x + share * rates[j][0], y + share * rates[j][1], z + share * rates[j][2]
        _add_outer(covariance, (x, y, z), sigma[3 + k])


@kernel(
    ["(f8[:],f8[:,:],f8[:,:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:,:],b1[:])"],
    f"(7),(2,2),(2,2),(7),({PACKED}),(3)->(3),(),(3,3),()",
)
def triangulate(
    q: FloatArray,
    pixels: FloatArray,
    pixel_sigma: FloatArray,
    joint_sigma: FloatArray,
    p: PackedHead,
    _three: FloatArray,
    point: FloatArray,
    gap: FloatArray,
    covariance: FloatArray,
    valid: NDArray[bool_],
) -> None:
    """Compute point, gap, covariance and validity of a fix from raw pixels and joint angles."""
    left_eye, right_eye = eye_frames(p, 0, q[3], q[4]), eye_frames(p, 1, q[5], q[6])
    left = ray_of_pixel(p, 0, left_eye.camera, pixels[0, 0], pixels[0, 1])
    right = ray_of_pixel(p, 1, right_eye.camera, pixels[1, 0], pixels[1, 1])
    s, t, found = distances_to_perpendicular(left, right)
    valid[0] = found
    covariance[:, :] = 0.0 if found else nan
    if not found:
        point[:] = gap[0] = nan
        return
    square = 0.0
    for k in range(3):
        near_left = left.origin[k] + s * left.direction[k]
        near_right = right.origin[k] + t * right.direction[k]
        point[k] = 0.5 * (near_left + near_right)
        square += (near_left - near_right) ** 2
    gap[0] = sqrt(square)
    crossing = Crossing(left, right, s, t)
    _add_pixel_noise(covariance, p, 0, left_eye.camera, pixels[0], pixel_sigma[0], crossing)
    _add_pixel_noise(covariance, p, 1, right_eye.camera, pixels[1], pixel_sigma[1], crossing)
    _add_joint_noise(covariance, p, left_eye, right_eye, joint_sigma, crossing)


DEFAULT_DEPTH_M: Final = 1.0
"""Depth if triangulation fails, m (chosen: the geometric mean of `DEPTH_RANGE_M`)."""
DEPTH_RANGE_M: Final = (0.1, 10.0)
"""Least and greatest triangulated depth, m (chosen: the depth scales only the small translational
part of the image Jacobian)."""


class RayDepths(NamedTuple):
    """Depths of a target along both rays, metres; `valid` is True if they are triangulated."""

    left: float
    right: float
    valid: bool


@inlined
def _ray_of_error(p: PackedHead, eye: int, camera: Pose, error: FloatArray) -> Ray:
    lens = camera_of(p, eye)
    tip = point_to_outer(camera, error[0] / lens.focal_u, error[1] / lens.focal_v, 1.0)
    origin = (camera.x, camera.y, camera.z)
    return Ray(origin, (tip[0] - camera.x, tip[1] - camera.y, tip[2] - camera.z))


@inlined
def rays_from_pixel_errors(
    p: PackedHead, left: Pose, right: Pose, error: FloatArray
) -> tuple[Ray, Ray]:
    """Rays in N of (2, 2) undistorted pixels less principal points, px, with unit z in cameras."""
    return _ray_of_error(p, 0, left, error[0]), _ray_of_error(p, 1, right, error[1])


@inlined
def depths_on_rays(left: Ray, right: Ray) -> RayDepths:
    """Triangulate the depths along both rays, clipped to `DEPTH_RANGE_M`; else the default."""
    s, t, found = distances_to_perpendicular(left, right)
    if not found:
        return RayDepths(DEFAULT_DEPTH_M, DEFAULT_DEPTH_M, False)
    return RayDepths(
        min(max(s, DEPTH_RANGE_M[0]), DEPTH_RANGE_M[1]),
        min(max(t, DEPTH_RANGE_M[0]), DEPTH_RANGE_M[1]),
        True,
    )
