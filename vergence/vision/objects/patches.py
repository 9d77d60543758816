"""Follow any point of one eye's image, and find it in the other eye's.

Both work in virtual views with the direction of the point, see `vergence.vision.objects.alignment`.
A patch in such a view stays nearly the same while the eye turns.

The standard deviations describe noise, interpolation and blur. They cannot hold where the patch's
model fails: at the edges of objects, on surfaces that are curved within the patch, on glossy ones,
and behind what is transparent. A point is refused where patches of two sizes disagree.
"""

from collections.abc import Sequence
from math import ceil, hypot, inf, sqrt
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError, PointRefusedError
from vergence.models.camera import Camera
from vergence.models.parts import FloatArray
from vergence.operands import as_operand
from vergence.vision.detection import as_pixel
from vergence.vision.image import as_grey
from vergence.vision.objects.alignment import (
    LEAST_Z,
    Fit,
    Template,
    View,
    focal_at,
    image_sigma_px,
    look,
    noise_variance,
    rotation_between,
    search,
)

_RADIUS_PX: Final = 12
"""Half the side of a patch, without its middle, px (chosen: texture against edges of objects)."""
_CORE_PX: Final = 6
"""Half the side of the smaller patch that must agree, px (chosen: edges against texture)."""
_VIEW_PX: Final = 40
"""Half the side of the view in which a point is followed, px (chosen: sudden motion against
time)."""
_LOST_VIEW_PX: Final = 100
"""Half the side of the view in which a lost point is searched, px (chosen: as above)."""
_LOST_IMAGES: Final = 240
"""Images in which a lost point is searched, 2 s at 120 Hz (chosen: long hiding against another
surface that looks the same)."""
_LEVELS: Final = 2
"""Highest level of the pyramids, each half as large as the one below (chosen)."""
_LK_WINDOW_PX: Final = 21
"""Side of Lucas and Kanade's window, px (chosen: as the patch)."""
_LEAST_LIKENESS: Final = 0.85
"""Smallest correlation, without noise, of a patch with the template (chosen: occlusion and false
matches against appearance that changes)."""
_RENEWAL_LIKENESS: Final = 0.95
"""Correlation below which a template is renewed (chosen: above the smallest)."""
_RENEWAL_IMAGES: Final = 5
"""Images in succession below it before that (chosen: not for one of a hand that passes)."""
_MOST_SIGMA_PX: Final = 0.2
"""Largest standard deviation of a point with sufficient texture, px (chosen: noise alone seems to
have 0.5)."""
_MOST_CORE_SIGMA_PX: Final = 0.6
"""The same of the smaller patch, px (chosen: as above)."""
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


class TrackedPoint(NamedTuple):
    """A point that is followed, in one image."""

    pixel: FloatArray
    """(u, v), shape (2,)."""
    sigma_px: FloatArray
    """Standard deviations of u and v about the point that was given first, shape (2,)."""


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


def _direction(camera: Camera, pixel: FloatArray, T_0_C: FloatArray, what: str) -> FloatArray:
    """Direction of a pixel in frame 0, (3,)."""
    width, height = camera.size
    inside = 0.0 <= pixel[0] <= width - 1 and 0.0 <= pixel[1] <= height - 1
    ray = np.append(camera.rays(pixel[None])[0], 1.0)
    if not inside or not np.isfinite(ray).all():
        raise PointRefusedError(
            f"{what}: expected a pixel of the {width} x {height} px image, "
            f"got {pixel[0]:.1f} {pixel[1]:.1f}"
        )
    direction = T_0_C[:3, :3] @ ray
    return np.asarray(direction / np.linalg.norm(direction))


def _refuse(pixel: FloatArray, why: str) -> PointRefusedError:
    return PointRefusedError(
        f"pixel: expected a point with texture of its own, got {pixel[0]:.1f} {pixel[1]:.1f}: {why}"
    )


_TEXTURELESS: Final = "textureless against the noise, or a straight edge"
_REPEATING: Final = "a repeating pattern, its neighbourhood looks the same at several places"
_BORDER: Final = f"less than {_RADIUS_PX + 1} px from the border of the image"


def _pose(name: str, T_0_C: ArrayLike) -> FloatArray:
    pose = as_operand(name, T_0_C, 4, 4)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise ConfigurationError(f"{name}: expected a pose (4, 4), got shape {pose.shape}")
    return pose


class PointTracker:
    """Follows one image point of one eye.

    Pyramidal Lucas-Kanade finds the point near its prediction in a virtual view; the alignment with
    the template of the first image then measures it, so that errors do not add up. If the template
    does not correlate there, the point is searched; if it is nowhere, it is not seen. The template
    is replaced once the appearance has changed, and the standard deviations say so.

    Args:
        camera: camera of the eye.
    """

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.forget()

    def forget(self) -> None:
        """Drop the point."""
        self._template: Template | None = None

    def begin(self, image: ArrayLike, pixel: ArrayLike, T_0_C: ArrayLike) -> TrackedPoint:
        """Begin to follow a point.

        Args:
            image: grey (height, width) or BGR (height, width, 3).
            pixel: (u, v) of the point, shape (2,).
            T_0_C: (4, 4) pose of the camera in the fixed frame 0, m:
                `head.base_pose(q) @ head.camera_poses(q)` of one eye at the measured joint angles.

        Returns:
            The pixel itself, with the standard deviations to expect in the next image.

        Raises:
            PointRefusedError: the point is outside of the image or too near its border, has no
                texture in some direction, or repeats.
            ConfigurationError: the image, the pixel or the pose is invalid.
        """
        self.forget()
        pose, pixel = _pose("T_0_C", T_0_C), as_pixel("pixel", pixel)
        grey = as_grey(image, self.camera.size)
        direction = _direction(self.camera, pixel, pose, "pixel")
        ray = pose[:3, :3].T @ direction
        turn = pose[:3, :3] @ rotation_between(np.array([0.0, 0.0, 1.0]), ray)
        focal = focal_at(self.camera, ray[:2] / ray[2])
        view = self._view(grey, pose, turn, focal, _VIEW_PX, noise_variance(grey, pixel))
        middle = np.full(2, float(_VIEW_PX))
        if not view.holds(middle, _RADIUS_PX + 1):
            raise _refuse(pixel, _BORDER)
        template = Template(view, middle, _RADIUS_PX, 0)
        if template.worst_sigma_px > _MOST_SIGMA_PX:
            raise _refuse(pixel, _TEXTURELESS)
        same = search(template, view, [np.eye(2)])
        if same is None or not same[1]:
            raise _refuse(pixel, _REPEATING)
        self._focal, self._earlier = focal, np.zeros((2, 2))
        self._direction, self._motion, self._missed = direction, np.zeros(3), 0
        self._keep(template, view, turn)
        return TrackedPoint(pixel, image_sigma_px(view, middle, template.covariance))

    def _view(
        self, grey: NDArray[np.uint8], pose: FloatArray, turn: FloatArray, focal: float,
        half: int, noise: float,
    ) -> View:  # fmt: skip
        """View of this eye with a rotation R_0_V."""
        size = (2 * half + 1, 2 * half + 1)
        return look(
            self.camera, grey, pose[:3, :3].T @ turn, (focal, focal), (-half, -half), size, noise
        )

    def _keep(self, template: Template, view: View, turn: FloatArray) -> None:
        """Use a template that has been cut from the middle of a view."""
        self._template, self._turn, self._faint = template, turn, 0
        self._start, self._stretch = view.image.astype(np.uint8), np.eye(2)

    def find(
        self, image: ArrayLike, T_0_C: ArrayLike, predicted_px: ArrayLike | None = None
    ) -> TrackedPoint | None:
        """Find the point in the next image.

        Args:
            image: as in `begin`.
            T_0_C: (4, 4) pose of the camera at the exposure in the fixed frame 0, m.
            predicted_px: (2,) predicted pixel; None for the last direction in frame 0, and the last
                change of it.

        Returns:
            The point, with standard deviations of its error as the point given to `begin`; None if
            it is not seen, or before `begin`. A hidden point is searched in the next 240 images.

        Raises:
            ConfigurationError: the image, the pose or the prediction is invalid.
        """
        pose, grey = _pose("T_0_C", T_0_C), as_grey(image, self.camera.size)
        at = self._direction + self._motion if self._template is not None else None
        if predicted_px is not None:
            predicted = as_pixel("predicted_px", predicted_px)
            at = pose[:3, :3] @ np.append(self.camera.rays(predicted[None])[0], 1.0)
        if self._template is None or at is None or self._missed >= _LOST_IMAGES:
            return None
        found = self._find(grey, pose, at / np.linalg.norm(at))
        if found is None:
            self._missed += 1
            self._motion = np.zeros(3)
        else:
            self._missed = 0
        return found

    def _find(
        self, grey: NDArray[np.uint8], pose: FloatArray, at: FloatArray
    ) -> TrackedPoint | None:
        template = self._template
        assert template is not None
        ray = pose[:3, :3].T @ at
        if not ray[2] > LEAST_Z:  # nan as well
            return None
        pixel = self.camera.project(ray[None])[0]
        if not np.isfinite(pixel).all():
            return None
        half = _LOST_VIEW_PX if self._missed else _VIEW_PX
        turn = rotation_between(self._turn[:, 2], at) @ self._turn
        view = self._view(grey, pose, turn, self._focal, half, noise_variance(grey, pixel))
        fit = None if self._missed else self._flow(view)
        if fit is None:
            found = search(template, view, [self._stretch])
            if found is None or not found[1] or found[0].likeness < _LEAST_LIKENESS:
                return None
            fit = found[0]
        covariance = self._earlier + fit.covariance
        point = TrackedPoint(
            view.to_pixels(fit.place[None])[0], image_sigma_px(view, fit.place, covariance)
        )
        direction = turn @ np.append((fit.place + view.corner) / view.focal, 1.0)
        direction /= np.linalg.norm(direction)
        self._motion = np.zeros(3) if self._missed else direction - self._direction
        self._direction, self._stretch = direction, fit.stretch
        self._faint = self._faint + 1 if fit.likeness < _RENEWAL_LIKENESS else 0
        if self._faint >= _RENEWAL_IMAGES:
            turn = rotation_between(turn[:, 2], direction) @ turn
            view = self._view(grey, pose, turn, self._focal, _VIEW_PX, view.noise)
            middle = np.full(2, float(_VIEW_PX))
            renewed = Template(view, middle, _RADIUS_PX, 0)
            if view.holds(middle, _RADIUS_PX + 1) and renewed.worst_sigma_px < _MOST_SIGMA_PX:
                self._earlier = covariance
                self._keep(renewed, view, turn)
        return point

    def _flow(self, view: View) -> Fit | None:
        """Place of the template near the middle of a view; None if it is not there."""
        template = self._template
        assert template is not None
        middle = np.full(2, float(_VIEW_PX))
        warp = np.column_stack([self._stretch, middle - self._stretch @ middle])
        start = cv2.warpAffine(
            self._start, warp, self._start.shape, borderMode=cv2.BORDER_REPLICATE
        )
        first = middle.astype(np.float32)[None, None]
        flow, found, _ = cv2.calcOpticalFlowPyrLK(
            start, view.image.astype(np.uint8), first, first.copy(),
            winSize=(_LK_WINDOW_PX, _LK_WINDOW_PX), maxLevel=_LEVELS,
        )  # fmt: skip
        if not found[0, 0]:
            return None
        fit = template.align(view, flow[0, 0].astype(float), self._stretch)
        if fit is None or fit.likeness < _LEAST_LIKENESS:
            return None
        return fit if view.holds(fit.place, _RADIUS_PX) else None


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
    T = [_pose("poses", pose) for pose in as_operand("poses", poses, 2, 4, 4)]
    pixel = as_pixel("pixel", pixel)
    greys = [as_grey(image, camera.size) for image, camera in zip(images, cameras, strict=True)]
    there = _Pair(cameras, greys, T, eye, depth_range_m).match(pixel, near_depth_m)
    back = _Pair(cameras, greys, T, 1 - eye, depth_range_m).match(there.pixel, there.depth_m)
    if hypot(*(back.pixel - pixel)) > _CONSISTENT_PX:
        raise _refuse(pixel, "found elsewhere when searched back from the other eye")
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
        direction = _direction(camera, pixel, pose, "pixel")
        baseline = self.poses[other][:3, 3] - pose[:3, 3]
        length_m = float(np.linalg.norm(baseline))
        if length_m < 1e-3:
            raise ConfigurationError(
                f"poses: expected eyes apart from each other, got {1e3 * length_m:.3f} mm"
            )
        x_axis = baseline / length_m
        cosine = float(direction @ x_axis)
        if abs(cosine) > _ALONG_BASELINE:
            raise _refuse(pixel, "nearly in line with both eyes")
        sine = sqrt(1.0 - cosine**2)
        z_axis = (direction - cosine * x_axis) / sine
        turn = np.column_stack([x_axis, np.cross(z_axis, x_axis), z_axis])
        ray = pose[:3, :3].T @ direction
        local = focal_at(camera, ray[:2] / ray[2])
        # an angle off the axis is stretched by 1 / sine^2 along x, by 1 / sine across
        focal = (local * sine**2, local * sine)
        x = focal[0] * cosine / sine
        r = _RADIUS_PX + 2
        noise = noise_variance(self.greys[eye], pixel)
        view = look(
            camera, self.greys[eye], pose[:3, :3].T @ turn, focal, (x - r, -r),
            (2 * r + 1, 2 * r + 1), noise,
        )  # fmt: skip
        place = np.array([r, r], float)
        if not view.holds(place, _RADIUS_PX):
            raise _refuse(pixel, _BORDER)
        template, core = (Template(view, place, _RADIUS_PX, 2), Template(view, place, _CORE_PX, 0))
        if template.worst_sigma_px > _MOST_SIGMA_PX or core.worst_sigma_px > _MOST_CORE_SIGMA_PX:
            raise _refuse(pixel, _TEXTURELESS)

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
            raise _refuse(
                pixel, "nothing like it in the other eye" if seen else "out of the other eye's view"
            )
        fit, distinct = found
        if fit.likeness < _LEAST_LIKENESS:
            raise _refuse(pixel, f"nothing like it in the other eye (at best {fit.likeness:.2f})")
        if not distinct:
            raise _refuse(pixel, _REPEATING)
        small = core.align(strip_view, fit.place, fit.stretch)
        most_misfit = _CORE_NOISE * 2.0 * noise + _CORE_CONTRAST * template.contrast
        if (
            small is None
            or small.likeness < _LEAST_LIKENESS
            or fit.core > most_misfit
            or hypot(*(small.place - fit.place)) > 0.1 + 3.0 * core.worst_sigma_px
        ):
            raise _refuse(pixel, "at the edge of an object, beside which the eyes see other things")
        at = fit.place + strip_view.corner
        disparity = x - float(at[0])
        depth_m = focal[0] * length_m / (disparity * sine) if disparity > 0.0 else inf
        return Match(
            strip_view.to_pixels(fit.place[None])[0],
            image_sigma_px(strip_view, fit.place, fit.covariance),
            depth_m,
            fit.likeness,
        )
