"""Pinhole projection through a lens, both ways, as kernels over packed heads.

    u = u_0 + f_u x_d,   v = v_0 + f_v y_d

with pixel centres at integers; (x_d, y_d) are the point's (X / Z, Y / Z) distorted by the lens.
"""

from math import nan

from numpy import bool_
from numpy.typing import NDArray

from vergence._jit import inlined, kernel
from vergence.models.kinematics import point_in_eye
from vergence.models.lens import CameraRow, distort, is_distorted, is_invertible_at, undistort_ray
from vergence.models.packed import CAMERA_LENGTH, PACKED, PackedHead, camera_at, camera_of
from vergence.models.parts import FloatArray


@inlined
def ray_to_pixel(camera: CameraRow, x: float, y: float) -> tuple[float, float]:
    """The pixel of a ray (X / Z, Y / Z), nan beyond the lens model's valid region."""
    if is_distorted(camera):
        distorted = distort(camera, x, y)
        if not is_invertible_at(camera, x, y, distorted):
            return nan, nan
        x, y = distorted.x, distorted.y
    return pinhole_pixel(camera, x, y)


@inlined
def pinhole_pixel(camera: CameraRow, x: float, y: float) -> tuple[float, float]:
    """The pixel of normalised coordinates, ideal or distorted."""
    return camera.centre_u + camera.focal_u * x, camera.centre_v + camera.focal_v * y


@inlined
def pinhole_ray(camera: CameraRow, u: float, v: float) -> tuple[float, float]:
    """The normalised coordinates of a pixel, the inverse of `pinhole_pixel`."""
    return (u - camera.centre_u) / camera.focal_u, (v - camera.centre_v) / camera.focal_v


@inlined
def point_to_pixel(
    p: PackedHead, eye: int, x: float, y: float, z: float, distorted: bool
) -> tuple[float, float]:
    """The pixel of a point in the camera frame; nan behind the camera or beyond the lens model."""
    if not z > 0.0:
        return nan, nan
    camera = camera_of(p, eye)
    if distorted:
        return ray_to_pixel(camera, x / z, y / z)
    return pinhole_pixel(camera, x / z, y / z)


@inlined
def undistort_pixel(p: PackedHead, eye: int, u: float, v: float) -> tuple[float, float]:
    """The ideal pinhole pixel of a raw pixel; nan if the lens model has no inverse there."""
    camera = camera_of(p, eye)
    if not is_distorted(camera):
        return u, v
    x, y = pinhole_ray(camera, u, v)
    x, y = undistort_ray(camera, x, y)
    return pinhole_pixel(camera, x, y)


@inlined
def pixel_error(p: PackedHead, eye: int, u: float, v: float) -> tuple[float, float]:
    """Offset of an undistorted raw pixel from the principal point, px."""
    camera = camera_of(p, eye)
    u, v = undistort_pixel(p, eye, u, v)
    return u - camera.centre_u, v - camera.centre_v


@inlined
def inside_image(p: PackedHead, eye: int, u: float, v: float) -> bool:
    """True if a raw pixel lies in the image; pixel centres are at integers."""
    camera = camera_of(p, eye)
    # `&`, not `and`: branches on a batch's targets would be mispredicted
    return (u >= -0.5) & (u <= camera.width - 0.5) & (v >= -0.5) & (v <= camera.height - 0.5)


@kernel(
    ["(f8[:],f8[:],b1[:],f8[:],f8[:],f8[:,:])"],
    f"(7),(3),(),({PACKED}),(2)->(2,2)",
)
def project(
    q: FloatArray,
    points: FloatArray,
    distorted: NDArray[bool_],
    p: PackedHead,
    _two: FloatArray,
    out: FloatArray,
) -> None:
    """Pixels in both eyes of a point given in N."""
    for eye in range(2):
        tilt, pan = q[3 + 2 * eye], q[4 + 2 * eye]
        x, y, z = point_in_eye(p, eye, tilt, pan, points[0], points[1], points[2])
        out[eye, 0], out[eye, 1] = point_to_pixel(p, eye, x, y, z, distorted[0])


@kernel(["(f8[:,:],f8[:],f8[:,:])"], f"(2,2),({PACKED})->(2,2)")
def undistort(pixels: FloatArray, p: PackedHead, out: FloatArray) -> None:
    """Ideal pinhole pixels of raw pixels, for both eyes."""
    for eye in range(2):
        out[eye, 0], out[eye, 1] = undistort_pixel(p, eye, pixels[eye, 0], pixels[eye, 1])


@kernel(["(f8[:],f8[:],f8[:])"], f"(2),({CAMERA_LENGTH})->(2)")
def rays_to_pixels(ray: FloatArray, row: FloatArray, out: FloatArray) -> None:
    """Pixels (u, v) of rays (X / Z, Y / Z) in one camera, nan beyond the lens model."""
    out[0], out[1] = ray_to_pixel(camera_at(row, 0), ray[0], ray[1])


@kernel(["(f8[:],f8[:],f8[:])"], f"(2),({CAMERA_LENGTH})->(2)")
def pixels_to_rays(pixel: FloatArray, row: FloatArray, out: FloatArray) -> None:
    """Rays (X / Z, Y / Z) of pixels (u, v) in one camera, nan if the lens has no inverse there."""
    camera = camera_at(row, 0)
    x, y = pinhole_ray(camera, pixel[0], pixel[1])
    if is_distorted(camera):
        x, y = undistort_ray(camera, x, y)
    out[0], out[1] = x, y
