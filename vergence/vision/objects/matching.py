"""Find a point of one eye's image in the other eye's, along its epipolar line."""

from collections.abc import Sequence
from math import ceil, hypot, inf, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.models.camera import Camera
from vergence.models.parts import FloatArray
from vergence.operands import as_operand
from vergence.vision.detection import as_pixel
from vergence.vision.image import as_grey
from vergence.vision.objects.alignment import (
    Template,
    focal_at,
    image_sigma_px,
    look,
    noise_variance,
    search,
)
from vergence.vision.objects.patches import (
    BORDER,
    LEAST_LIKENESS,
    MOST_SIGMA_PX,
    RADIUS_PX,
    REPEATING,
    TEXTURELESS,
    as_pose,
    direction_of,
    refuse,
)

_CORE_PX: Final = 6
"""Half the side of the smaller patch that must agree, px (chosen: edges against texture)."""
_MOST_CORE_SIGMA_PX: Final = 0.6
"""The same of the smaller patch, px (chosen: as above)."""
_LEAST_CORE_LIKENESS: Final = 0.75
"""Smallest correlation of the smaller patch without noise (chosen: its noise weighs more)."""
_ROWS_PX: Final = 6
"""Tolerance across the epipolar line, px (chosen: errors of encoders)."""
_CORE_NOISE: Final = 2.2
_CORE_CONTRAST: Final = 0.03
"""Largest misfit of a patch's middle, as shares of the noise and of the patch's variance (chosen:
edges of objects; 49 pixels of noise exceed it in no case in 10,000)."""
_STRETCHES: Final = tuple(np.diag([width, 1.0]) for width in (0.75, 1.0, 1.33))
"""Widths of a patch in the other eye for which it is searched (chosen: slants)."""
_CONSISTENT_PX: Final = 1.0
"""Largest distance of a point from itself, there and back, px (chosen: false matches)."""
_ALONG_BASELINE: Final = 0.95
"""Largest cosine between a ray and the baseline (chosen: 18 degrees, where no depth is left)."""


class Match(NamedTuple):
    """A point of one eye, found in the other one."""

    pixel: FloatArray
    """(u, v) in the other eye, shape (2,)."""
    sigma_px: FloatArray
    """Standard deviations of u and v, shape (2,)."""
    depth_m: float
    """Distance of the point from the first eye along its ray, m; inf if the rays do not meet."""
    score: float
    """Correlation of both patches without noise, at most 1."""
    model_sigma_px: float
    """Share of the standard deviations that is no noise, as of slants and blur."""


def match_point(
    cameras: Sequence[Camera],
    images: Sequence[ArrayLike],
    poses: ArrayLike,
    pixel: ArrayLike,
    eye: int = 0,
    depth_range_m: tuple[float, float] = (0.2, inf),
    near_depth_m: float | None = None,
) -> Match:
    """Find a point of one eye in the other one.

    Both virtual views have the baseline as their x axis, so that only the disparity and the errors
    of the encoders move the point between them.

    Args:
        cameras: cameras of both eyes.
        images: images of both eyes at one time, grey or BGR.
        poses: (2, 4, 4) poses T_0_C of both cameras, m.
        pixel: (u, v) of the point, shape (2,).
        eye: the eye that it is given in, 0 for left, 1 for right.
        depth_range_m: range of distances from that eye, m.
        near_depth_m: a distance that is tried as well, such as that at which the eyes meet; None
            for none.

    Raises:
        PointRefusedError: the point is outside of the image, has no texture, repeats, is not seen
            by the other eye, or lies where the eyes see different things.
        ConfigurationError: an argument is invalid.
    """
    if eye not in (0, 1):
        raise ConfigurationError(f"eye: expected 0 for left or 1 for right, got {eye!r:.80}")
    near, far = depth_range_m
    if not 0.0 < near < far:
        raise ConfigurationError(
            f"depth_range_m: expected two rising distances above 0, got {near} {far}"
        )
    if near_depth_m is not None and not near_depth_m > 0.0:
        raise ConfigurationError(f"near_depth_m: expected a distance, got {near_depth_m!r:.80}")
    T = [as_pose("poses", pose) for pose in as_operand("poses", poses, 2, 4, 4)]
    pixel = as_pixel("pixel", pixel)
    greys = [as_grey(image, camera.size) for image, camera in zip(images, cameras, strict=True)]
    there = _Pair(cameras, greys, T, eye, depth_range_m).match(pixel, near_depth_m)
    back = _Pair(cameras, greys, T, 1 - eye, depth_range_m).match(there.pixel, there.depth_m)
    if hypot(*(back.pixel - pixel)) > _CONSISTENT_PX:
        raise refuse(pixel, "found elsewhere when searched back from the other eye")
    return there


class _Pair(NamedTuple):
    """Two eyes, one of which is searched for a point of the other."""

    cameras: Sequence[Camera]
    greys: Sequence[NDArray[np.uint8]]
    poses: Sequence[FloatArray]
    eye: int
    depth_range_m: tuple[float, float]

    def match(self, pixel: FloatArray, near_depth_m: float | None) -> Match:
        eye, other = self.eye, 1 - self.eye
        camera, pose = self.cameras[eye], self.poses[eye]
        direction = direction_of(camera, pixel, pose, "pixel")
        baseline = self.poses[other][:3, 3] - pose[:3, 3]
        length_m = float(np.linalg.norm(baseline))
        if length_m < 1e-3:
            raise ConfigurationError(
                f"poses: expected eyes apart from each other, got {1e3 * length_m:.3f} mm"
            )
        x_axis = baseline / length_m
        cosine = float(direction @ x_axis)
        if abs(cosine) > _ALONG_BASELINE:
            raise refuse(pixel, "nearly in line with both eyes")
        sine = sqrt(1.0 - cosine**2)
        z_axis = (direction - cosine * x_axis) / sine
        turn = np.column_stack([x_axis, np.cross(z_axis, x_axis), z_axis])
        ray = pose[:3, :3].T @ direction
        local = focal_at(camera, ray[:2] / ray[2])
        # an angle off the axis is stretched by 1 / sine^2 along x, by 1 / sine across
        focal = (local * sine**2, local * sine)
        x = focal[0] * cosine / sine
        r = RADIUS_PX + 2
        noise = noise_variance(self.greys[eye], pixel)
        view = look(
            camera, self.greys[eye], pose[:3, :3].T @ turn, focal, (x - r, -r),
            (2 * r + 1, 2 * r + 1), noise,
        )  # fmt: skip
        place = np.array([r, r], float)
        if not view.holds(place, RADIUS_PX):
            raise refuse(pixel, BORDER)
        template, core = (Template(view, place, RADIUS_PX, 2), Template(view, place, _CORE_PX, 0))
        if template.worst_sigma_px > MOST_SIGMA_PX or core.worst_sigma_px > _MOST_CORE_SIGMA_PX:
            raise refuse(pixel, TEXTURELESS)

        def shift_px(distance_m: float) -> float:
            return focal[0] * length_m / (distance_m * sine)

        least, most = (shift_px(distance_m) for distance_m in self.depth_range_m[::-1])
        room = r + _ROWS_PX
        strip_view = look(
            self.cameras[other], self.greys[other], self.poses[other][:3, :3].T @ turn, focal,
            (x - most - room, -room), (ceil(most - least) + 2 * room + 1, 2 * room + 1), noise,
        )  # fmt: skip
        near = None
        if near_depth_m is not None:
            near = np.array([x - shift_px(near_depth_m), 0.0]) - strip_view.corner
        found = search(template, strip_view, _STRETCHES, near)
        if found is None:
            seen = strip_view.seen().any()
            raise refuse(
                pixel, "nothing like it in the other eye" if seen else "out of the other eye's view"
            )
        fit, distinct = found
        if fit.likeness < LEAST_LIKENESS:
            raise refuse(pixel, f"nothing like it in the other eye (at best {fit.likeness:.2f})")
        if not distinct:
            raise refuse(pixel, REPEATING)
        small = core.align(strip_view, fit.place, fit.stretch)
        most_misfit = _CORE_NOISE * 2.0 * noise + _CORE_CONTRAST * template.contrast
        if (
            small is None
            or small.likeness < _LEAST_CORE_LIKENESS
            or fit.core > most_misfit
            or hypot(*(small.place - fit.place)) > 0.1 + 3.0 * core.worst_sigma_px
        ):
            raise refuse(pixel, "at the edge of an object, beside which the eyes see other things")
        at = fit.place + strip_view.corner
        disparity = x - float(at[0])
        depth_m = focal[0] * length_m / (disparity * sine) if disparity > 0.0 else inf
        return Match(
            strip_view.to_pixels(fit.place[None])[0],
            image_sigma_px(strip_view, fit.place, fit.covariance),
            depth_m,
            fit.likeness,
            sqrt(fit.model_px2),
        )
