"""Search for an image point that was named in one eye, in both eyes' images.

The eye in which the point was named is its origin; the other eye's point is matched from it, along
its epipolar line. What both eyes see must lie in one plane with the baseline, else the other eye's
point is dropped and matched anew. An eye that has lost the point is searched where the other one
sees it.
"""

import threading
from collections.abc import Sequence
from math import ceil, hypot, inf, sqrt
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError, PointRefusedError
from vergence.models.camera import Camera
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.operands import as_operand
from vergence.vision.detection import Detection, as_pixel
from vergence.vision.image import as_grey
from vergence.vision.objects.alignment import Template, focal_at, look, noise_variance, search
from vergence.vision.objects.patches import (
    BORDER,
    LEAST_LIKENESS,
    MOST_SIGMA_PX,
    RADIUS_PX,
    REPEATING,
    TEXTURELESS,
    PointTracker,
    TrackedPoint,
    as_pose,
    direction_of,
    refuse,
)
from vergence.vision.objects.sights import (
    EyeSearch,
    Found,
    SeenImage,
    SharedSearch,
    crossing,
    line_of_sight,
    pixel_of,
)
from vergence.vision.objects.targets import PointTarget

_CORE_PX: Final = 6
_MOST_APART_PX: Final = 0.6
"""Half the side of the smaller patch that must agree, and the largest distance of its place from
the whole one's, px (measured: as below, 3 % of the right matches and half of the false ones)."""
_ROWS_PX: Final = 6
"""Tolerance across the epipolar line, px (chosen: errors of encoders)."""
_MOST_UNLIKE_PX: Final = 0.85
"""Largest misfit of a quarter of a patch, as the displacement that would cause it, px (measured:
photographs, exceeded by 5 % of the right matches and two thirds of the false ones)."""
_STRETCHES: Final = tuple(np.diag([width, 1.0]) for width in (0.75, 1.0, 1.33))
"""Widths of a patch in the other eye for which it is searched (chosen: slants)."""
_CONSISTENT_PX: Final = 0.2
"""Largest way of a point from itself, there and back, px (measured: as above; 2 %, a third)."""
_ALONG_BASELINE: Final = 0.95
"""Largest cosine between a ray and the baseline (chosen: 18 degrees, where no depth is left)."""
_PAIR_S: Final = 0.05
"""Greatest time between two images in which a point is matched, s (chosen: cameras that are not in
step)."""
_AGREE_PX: Final = 3.0
"""Largest distance of both eyes' points from a common place, px, besides three standard deviations
(chosen: errors of encoders, and of eyes that are not in step)."""
_REMEMBERED_S: Final = 1.0
"""Time for which the distance of a point is remembered, s (chosen: objects that move)."""


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
    cameras: Sequence[Camera], images: Sequence[ArrayLike], poses: ArrayLike, pixel: ArrayLike,
    eye: int = 0, depth_range_m: tuple[float, float] = (0.2, inf),
    near_depth_m: float | None = None,
) -> Match:  # fmt: skip
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
    there = _match(cameras, greys, T, pixel, eye, depth_range_m, near_depth_m)
    back = _match(cameras, greys, T, there.pixel, 1 - eye, depth_range_m, there.depth_m)
    if hypot(*(back.pixel - pixel)) > _CONSISTENT_PX:
        raise refuse(pixel, "found elsewhere when searched back from the other eye")
    return there


def _match(
    cameras: Sequence[Camera], greys: Sequence[NDArray[np.uint8]], poses: Sequence[FloatArray],
    pixel: FloatArray, eye: int, depth_range_m: tuple[float, float],
    near_depth_m: float | None,
) -> Match:  # fmt: skip
    """The point in the other eye, without the way back."""
    other, pose = 1 - eye, poses[eye]
    direction = direction_of(cameras[eye], pixel, pose)
    baseline = poses[other][:3, 3] - pose[:3, 3]
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
    local = focal_at(cameras[eye], pose[:3, :3].T @ direction)
    # an angle off the axis is stretched by 1 / sine^2 along x, by 1 / sine across
    focal = (local * sine**2, local * sine)
    x = focal[0] * cosine / sine
    shift_px_m = focal[0] * length_m / sine  # disparity times distance
    noise = noise_variance(greys[eye], pixel)
    r = RADIUS_PX + 2
    view = look(
        cameras[eye], greys[eye], pose[:3, :3].T @ turn, focal, (x - r, -r),
        (2 * r + 1, 2 * r + 1), noise,
    )  # fmt: skip
    place = np.array([r, r], float)
    if not view.holds(place, RADIUS_PX):
        raise refuse(pixel, BORDER)
    template, core = Template(view, place, RADIUS_PX, 2), Template(view, place, _CORE_PX, 0)
    if template.worst_sigma_px > MOST_SIGMA_PX:
        raise refuse(pixel, TEXTURELESS)
    most, least = (shift_px_m / distance_m for distance_m in depth_range_m)
    room = r + _ROWS_PX
    strip = look(
        cameras[other], greys[other], poses[other][:3, :3].T @ turn, focal,
        (x - most - room, -room), (ceil(most - least) + 2 * room + 1, 2 * room + 1), noise,
    )  # fmt: skip
    near = None
    if near_depth_m is not None:
        near = np.array([x - shift_px_m / near_depth_m, 0.0]) - strip.corner
    found = search(template, strip, _STRETCHES, near)
    if found is None:
        nothing = "nothing like it in the other eye"
        raise refuse(pixel, nothing if strip.seen.any() else "out of the other eye's view")
    fit, distinct = found
    if fit.likeness < LEAST_LIKENESS:
        raise refuse(pixel, f"nothing like it in the other eye (at best {fit.likeness:.2f})")
    if not distinct:
        raise refuse(pixel, REPEATING)
    small = core.align(strip, fit.place, fit.stretch)
    apart_px = inf if small is None else hypot(*(small.place - fit.place))
    if fit.unlike_px > _MOST_UNLIKE_PX or apart_px > _MOST_APART_PX:
        raise refuse(pixel, "at the edge of an object, beside which the eyes see other things")
    disparity = x - float(fit.place[0] + strip.corner[0])
    return Match(
        strip.to_pixels(fit.place[None])[0],
        strip.sigma_px(fit.place, fit.covariance),
        shift_px_m / disparity if disparity > 0.0 else inf,
        fit.likeness,
        fit.model_px,
    )


class _Sight(NamedTuple):
    """A point in an eye's image."""

    camera: Camera
    seen: SeenImage
    point: TrackedPoint

    @property
    def ray(self) -> FloatArray:
        return line_of_sight(self.camera, self.seen.T_0_C, self.point.pixel)

    def tolerance(self, point: TrackedPoint) -> float:
        """Largest disagreement with the other eye's point, px."""
        sigma_px = hypot(np.max(point.sigma_px), np.max(self.point.sigma_px))
        return _AGREE_PX + 3.0 * sigma_px


class PointSeed(SharedSearch):
    """The point that both eyes follow: where it was named, and where each eye saw it last.

    Args:
        cameras: the left and the right eye's camera.
        target: the target.
        waits: True to name its pixel in images after the first `forget` only, as for a robot that
            has yet to drive to the start.

    Attributes:
        generation: number of points that have been named; what belongs to an earlier one is void.
        named: the eye and pixel that wait for the eye's next image.
        origin: the eye that the point was named in, once it is followed there.
        sights: where each eye sees the point, None if it does not.
        place: where both eyes saw it last in frame 0, m, and when.
    """

    def __init__(
        self, cameras: Sequence[Camera], target: PointTarget, *, waits: bool = False
    ) -> None:
        self.cameras, self.lock, self.generation = cameras, threading.RLock(), 0
        self._target = target
        self._name(None, None, clicked=False)
        if not waits:
            self.forget()

    def forget(self) -> None:
        """Start again from the pixel that the target names, in the eye's next image."""
        self._name(self._target.eye, self._target.pixel, clicked=False)

    def click(self, eye: int, pixel: ArrayLike) -> None:
        """Follow another point from the eye's next image on; both eyes drop the present one."""
        self._name(eye, as_pixel("pixel", pixel), clicked=True)

    def _name(self, eye: int | None, pixel: ArrayLike | None, *, clicked: bool) -> None:
        with self.lock:
            self.generation += 1
            self.clicked = clicked
            self.named = None if eye is None or pixel is None else (eye, np.asarray(pixel, float))
            self.origin: int | None = None
            self.sights: list[_Sight | None] = [None, None]
            self.place: tuple[FloatArray, float] | None = None
            self.remark = ""


class PointSearch(EyeSearch):
    """Search for an image point that was named in one of the eyes."""

    def __init__(self, eye: int, seed: PointSeed) -> None:
        self._eye, self._seed = eye, seed
        self._camera = seed.cameras[eye]
        self._tracker = PointTracker(self._camera)
        self._generation, self._begun = -1, False

    def forget(self) -> None:
        """See `EyeSearch.forget`."""
        self._found = None

    def look(self, image: Any, T_0_C: FloatArray, time_s: float, *, search: bool = True) -> None:
        """See `EyeSearch.look`."""
        seed, seen, named = self._seed, SeenImage(np.asarray(image), T_0_C, time_s), None
        with seed.lock:
            if seed.named is not None and seed.named[0] == self._eye:
                seed.origin, named, seed.named = self._eye, seed.named[1], None
            generation, origin, other = seed.generation, seed.origin, seed.sights[1 - self._eye]
            recent = seed.place is not None and abs(seed.place[1] - time_s) <= _REMEMBERED_S
            place = seed.place[0] if seed.place is not None and recent else None
        if generation != self._generation:
            self._generation, self._begun = generation, False
            self._tracker.forget()
        if other is not None and abs(other.seen.time_s - time_s) > _PAIR_S:
            other = None
        point, refusal = None, None
        try:
            if named is not None:
                self._tracker.begin(seen.image, named, T_0_C)
                self._begun = True
            if origin == self._eye:
                point = self._follow(seen, other, place)
            elif origin is not None:
                point = self._accompany(seen, other, place)
        except PointRefusedError as error:
            if named is not None and not seed.clicked:
                raise
            refusal = str(error) if named is not None else f"{EYE_NAMES[self._eye]} eye: {error}"
        with seed.lock:
            if generation != seed.generation:
                point = None  # another one was clicked meanwhile
            else:
                self._keep(seen, point, refusal)
            detection = None if point is None else Detection(point.pixel, point.sigma_px)
            self._found = Found(detection)

    def _keep(self, seen: SeenImage, point: TrackedPoint | None, refusal: str | None) -> None:
        """Share what this eye sees with the other one; a refused point is followed no longer."""
        seed, eye = self._seed, self._eye
        if refusal is not None and seed.origin == eye and not self._begun:
            seed.origin = None
        seed.sights[eye] = None if point is None else _Sight(self._camera, seen, point)
        if refusal is not None or (point is not None and eye != seed.origin):
            seed.remark = refusal or ""
        both = [sight for sight in seed.sights if sight is not None]
        if len(both) == 2 and abs(both[0].seen.time_s - both[1].seen.time_s) <= _PAIR_S:
            depths, place = crossing([one.seen.T_0_C[:3, 3] for one in both],
                                     [one.ray for one in both])  # fmt: skip
            seed.place = (place, seen.time_s) if (depths > 0.0).all() else None

    def _follow(
        self, seen: SeenImage, other: _Sight | None, place: FloatArray | None
    ) -> TrackedPoint | None:
        """Follow the point in the eye that it was named in."""
        if not self._begun:
            return None
        point = self._tracker.find(seen.image, seen.T_0_C, renew=other is not None)
        if point is not None or other is None:
            return point
        matched, _ = self._match(seen, other, place)
        found = self._tracker.find(seen.image, seen.T_0_C, matched.pixel)
        near = found is not None and hypot(*(found.pixel - matched.pixel)) < _AGREE_PX
        return found if near else None

    def _accompany(
        self, seen: SeenImage, other: _Sight | None, place: FloatArray | None
    ) -> TrackedPoint | None:
        """Follow the point that the other eye was named, and that is matched from there."""
        tracker = self._tracker
        point = tracker.find(seen.image, seen.T_0_C, renew=False) if self._begun else None
        if other is None:
            return point
        if point is not None and self._off_line_px(seen, point, other) > other.tolerance(point):
            point = None
        if point is not None and not tracker.faint:
            return point
        try:
            match, model_sigma_px = self._match(seen, other, place)
        except PointRefusedError:
            if point is not None:
                return point
            self._begun = False
            tracker.forget()
            raise
        tracker.begin(seen.image, match.pixel, seen.T_0_C, checked=False, sigma_px=model_sigma_px)
        self._begun = True
        return match

    def _off_line_px(self, seen: SeenImage, point: TrackedPoint, other: _Sight) -> float:
        """Distance of this eye's point from the other one's epipolar line."""
        normal = np.cross(other.seen.T_0_C[:3, 3] - seen.T_0_C[:3, 3], other.ray)
        ray = line_of_sight(self._camera, seen.T_0_C, point.pixel)
        sine = float(normal @ ray / np.linalg.norm(normal))
        return abs(sine) * float(self._camera.focal.mean())

    def _match(
        self, seen: SeenImage, other: _Sight, place: FloatArray | None
    ) -> tuple[TrackedPoint, FloatArray]:
        """Find the point that the other eye sees, at the distance that it had if it rests.

        Noise of this image moves the match, and does not move what is then followed of it: the
        second result is the standard deviation without noise.
        """
        pair = (seen, other.seen) if self._eye == 0 else (other.seen, seen)
        T_0_other, expected, near_m = other.seen.T_0_C, None, None
        if place is not None:
            off = pixel_of(other.camera, T_0_other, place) - other.point.pixel
            if np.linalg.norm(off) <= other.tolerance(other.point):
                near_m = float(np.linalg.norm(place - T_0_other[:3, 3]))
                expected = pixel_of(self._camera, seen.T_0_C, T_0_other[:3, 3] + near_m * other.ray)
        match = match_point(
            self._seed.cameras, [one.image for one in pair], [one.T_0_C for one in pair],
            other.point.pixel, 1 - self._eye, near_depth_m=near_m,
        )  # fmt: skip
        # noise of the other eye's image moves its point and the match, which make up for it
        excess = np.maximum(other.point.sigma_px**2 - match.sigma_px**2, 0.0)
        point = TrackedPoint(match.pixel, np.sqrt(match.sigma_px**2 + excess))
        if expected is not None and not (
            np.linalg.norm(expected - match.pixel) <= other.tolerance(point)
        ):
            raise PointRefusedError(
                "pixel: expected the distance that the point had, got another one where it rests"
            )
        return point, np.sqrt(match.model_sigma_px**2 + excess)
