"""Follow any point of one eye's image.

The point is followed in virtual views with its direction, see `vergence.vision.objects.alignment`.
A patch in such a view stays nearly the same while the eye turns.

The standard deviations describe noise, interpolation and blur. They cannot hold where the patch's
model fails: at the edges of objects, on surfaces that are curved within the patch, on glossy ones,
and behind what is transparent. A match is refused where a quarter or the middle does not fit.
"""

from math import hypot, inf, pi, sqrt
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
    look,
    noise_variance,
    rotation_between,
    search,
)
from vergence.vision.objects.sights import line_of_sight

RADIUS_PX: Final = 12
"""Half the side of a patch, without its middle, px (chosen: texture against edges of objects)."""
_VIEW_PX: Final = 40
"""Half the side of the view in which a point is followed, px (chosen: sudden motion against
time)."""
_LOST_VIEW_PX: Final = 100
"""Half the side of the view in which a lost point is searched, px (chosen: as above)."""
_LOST_IMAGES: Final = 240
"""Images in which a lost point is searched, 2 s at 120 Hz (chosen: long hiding against another
surface that looks the same)."""
LEAST_LIKENESS: Final = 0.85
"""Smallest correlation, without noise, of a patch with the template (chosen: occlusion and false
matches against appearance that changes)."""
_LEAST_OBJECT_LIKENESS: Final = 0.75
"""The same for an object, whose surroundings are another (chosen: as above)."""
_RENEWAL_LIKENESS: Final = 0.92
"""Correlation below which a template is renewed (chosen: above the smallest)."""
_RENEWAL_IMAGES: Final = 10
"""Images in succession below it before that (chosen: not for a hand that passes)."""
_STILL_PX: Final = 1.0
"""Largest motion in the image since the last one that does not blur it, px (chosen: by half of
that at most)."""
_SURE_PX: Final = 4.0
"""Largest distance from the prediction within which no other place is looked for, px (chosen:
errors of encoders)."""
_OBJECT_PX: Final = 10.0
"""Half the width of an object in its view, px (chosen: its outline within the patch)."""
_OBJECT_JUMP_PX: Final = 8.0
"""Distance of an object from its prediction that is no jump, px of the image, for each image since
it was seen (chosen: objects that start); larger objects may jump by half their width."""
_OBJECT_GAIN: Final = 1.4
_OBJECT_RISE: Final = 0.5
"""Largest change of an object's contrast as a factor, and of its grey level as a share of its
contrast (chosen: other things of its shape against shades)."""
_OBJECT_SIGMA_PX: Final = 0.3
"""Standard deviation by what is behind an object, px of the image (measured: balls before textured
surfaces)."""
_LEAST_COARSE_NOISE: Final = 0.5
"""Smallest variance of noise in a coarser view, squared grey levels (chosen: roundings)."""
MOST_SIGMA_PX: Final = 0.2
"""Largest standard deviation of a point with sufficient texture, px (chosen: noise alone seems to
have 0.5)."""


class TrackedPoint(NamedTuple):
    """A point that is followed, in one image."""

    pixel: FloatArray
    """(u, v), shape (2,)."""
    sigma_px: FloatArray
    """Standard deviations of u and v about the point that was given first, shape (2,)."""


def direction_of(camera: Camera, pixel: FloatArray, T_0_C: FloatArray) -> FloatArray:
    """Direction of a pixel in frame 0, (3,), or the refusal of one outside of the image."""
    width, height = camera.size
    direction = line_of_sight(camera, T_0_C, pixel)
    inside = 0.0 <= pixel[0] <= width - 1 and 0.0 <= pixel[1] <= height - 1
    if not inside or not np.isfinite(direction).all():
        raise PointRefusedError(
            f"pixel: expected a pixel of the {width} x {height} px image, "
            f"got {pixel[0]:.1f} {pixel[1]:.1f}"
        )
    return direction


def refuse(pixel: FloatArray, why: str) -> PointRefusedError:
    """Error that says why a point cannot be followed or matched."""
    return PointRefusedError(
        f"pixel: expected a point with texture of its own, got {pixel[0]:.1f} {pixel[1]:.1f}: {why}"
    )


TEXTURELESS: Final = "textureless against the noise, or a straight edge"
REPEATING: Final = "a repeating pattern, its neighbourhood looks the same at several places"
BORDER: Final = f"less than {RADIUS_PX + 1} px from the border of the image"


def as_pose(name: str, T_0_C: ArrayLike) -> FloatArray:
    """A finite pose, (4, 4), or a `ConfigurationError`."""
    pose = as_operand(name, T_0_C, 4, 4)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise ConfigurationError(f"{name}: expected a pose (4, 4), got shape {pose.shape}")
    return pose


class _Held(NamedTuple):
    """A template that is searched."""

    template: Template
    turn: FloatArray  # (3, 3) rotation R_0_V of the view that it was cut from
    start: NDArray[np.uint8]  # that view
    earlier: FloatArray  # (2, 2) covariance of its middle about the point, px^2


class PointTracker:
    """Follows one image point of one eye.

    Pyramidal Lucas-Kanade finds the point near its prediction in a virtual view; the alignment with
    the template of the first image then measures it, so that errors do not add up. If the template
    does not correlate there, the point is searched; if it is nowhere, it is not seen. A further
    template is used once the appearance has changed in sharp images, and the standard deviations
    say so; the first one returns as soon as it correlates again.

    Args:
        camera: camera of the eye.
    """

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.forget()

    def forget(self) -> None:
        """Drop the point."""
        self._held: _Held | None = None
        self._faint = self._missed = 0

    def begin(
        self, image: ArrayLike, pixel: ArrayLike, T_0_C: ArrayLike, half_px: float | None = None,
        checked: bool = True, sigma_px: ArrayLike = (0.0, 0.0),
    ) -> TrackedPoint:  # fmt: skip
        """Begin to follow a point, or an object around it.

        Args:
            image: grey (height, width) or BGR (height, width, 3).
            pixel: (u, v) of the point, shape (2,).
            T_0_C: (4, 4) pose of the camera in the fixed frame 0, m:
                `head.base_pose(q) @ head.camera_poses(q)` of one eye at the measured joint angles.
            half_px: half the width of an object that is followed as a whole, px: by its outline,
                what is inside, and its grey level, in views in which it is at most 20 px wide; None
                for the texture around a point.
            checked: whether what cannot be told apart from its surroundings is refused, and what
                reaches over the border of the image.
            sigma_px: (2,) standard deviations of the pixel itself, px.

        Returns:
            The pixel itself, with the standard deviations to expect in the next image.

        Raises:
            PointRefusedError: the point is outside of the image; or, if it is checked, it is too
                near the border, has no texture in some direction, or repeats.
            ConfigurationError: an argument is invalid.
        """
        self.forget()
        pose, pixel = as_pose("T_0_C", T_0_C), as_pixel("pixel", pixel)
        if half_px is not None and not 0.0 < half_px < inf:
            raise ConfigurationError(f"half_px: expected half a width, got {half_px!r:.80}")
        grey = as_grey(image, self.camera.size)
        direction = direction_of(self.camera, pixel, pose)
        ray = pose[:3, :3].T @ direction
        turn = pose[:3, :3] @ rotation_between(np.array([0.0, 0.0, 1.0]), ray)
        self._coarse = max((half_px or 0.0) / _OBJECT_PX, 1.0)
        self._whole = checked
        self._within_px = None if half_px is None else half_px / self._coarse
        self._focal = focal_at(self.camera, ray) / self._coarse
        middle = np.full(2, float(_VIEW_PX))
        view, template = self._cut(grey, pose, turn, pixel)
        if not view.holds(middle, RADIUS_PX + 1, checked):
            raise refuse(pixel, BORDER)
        if checked:
            if template.worst_sigma_px > MOST_SIGMA_PX:
                raise refuse(pixel, TEXTURELESS)
            same = search(template, view, [np.eye(2)])
            if same is None or not same[1]:
                raise refuse(pixel, REPEATING)
        inverse = np.linalg.inv(view.jacobian(middle))
        named = inverse @ np.diag(np.square(as_operand("sigma_px", sigma_px, 2))) @ inverse.T
        self._direction, self._motion, self._missed = direction, np.zeros(3), 0
        self._pixel, self._faint, self._covariance = pixel, 0, named
        self._first = self._held = _Held(template, turn, view.image.astype(np.uint8), named)
        return TrackedPoint(pixel, view.sigma_px(middle, named + template.covariance))

    def _view(
        self, grey: NDArray[np.uint8], pose: FloatArray, turn: FloatArray, half: int,
        pixel: FloatArray,
    ) -> View:  # fmt: skip
        """View of this eye with a rotation R_0_V, coarser for larger objects."""
        noise, focal = noise_variance(grey, pixel), self._focal
        if self._coarse > 1.0:
            sigma = 0.5 * sqrt(self._coarse**2 - 1.0)
            grey = np.asarray(cv2.GaussianBlur(grey, (0, 0), sigma))
            noise = max(noise / max(4.0 * pi * sigma**2, 1.0), _LEAST_COARSE_NOISE)
        size = (2 * half + 1, 2 * half + 1)
        R_C_V = pose[:3, :3].T @ turn
        return look(self.camera, grey, R_C_V, (focal, focal), (-half, -half), size, noise)

    def _cut(
        self, grey: NDArray[np.uint8], pose: FloatArray, turn: FloatArray, pixel: FloatArray
    ) -> tuple[View, Template]:
        """View of this eye, and the template from its middle."""
        view = self._view(grey, pose, turn, _VIEW_PX, pixel)
        return view, Template(view, np.full(2, float(_VIEW_PX)), RADIUS_PX, 0, self._within_px)

    @property
    def faint(self) -> bool:
        """True if the appearance has changed, in several sharp images in succession."""
        return self._faint >= _RENEWAL_IMAGES

    def find(
        self, image: ArrayLike, T_0_C: ArrayLike, predicted_px: ArrayLike | None = None,
        renew: bool = True,
    ) -> TrackedPoint | None:  # fmt: skip
        """Find the point in the next image.

        Args:
            image: as in `begin`.
            T_0_C: (4, 4) pose of the camera at the exposure in the fixed frame 0, m.
            predicted_px: (2,) predicted pixel; None for the last direction in frame 0, and the last
                change of it.
            renew: whether a further template is used once the point is faint.

        Returns:
            The point, with standard deviations of its error as the point given to `begin`; None if
            it is not seen, or before `begin`. A hidden point is searched in the next 240 images,
            and in all for which there is a prediction.

        Raises:
            ConfigurationError: the image, the pose or the prediction is invalid.
        """
        pose, grey = as_pose("T_0_C", T_0_C), as_grey(image, self.camera.size)
        lost = predicted_px is None and self._missed >= _LOST_IMAGES
        if self._held is None or lost:
            return None
        at = self._direction + self._motion
        if predicted_px is not None:
            at = line_of_sight(self.camera, pose, as_pixel("predicted_px", predicted_px))
        found = self._find(self._held, grey, pose, at / np.linalg.norm(at))
        if found is None:
            self._missed += 1
            self._motion = np.zeros(3)
            return None
        self._missed = 0
        if renew and self.faint:
            self._renew(self._held, grey, pose)
        return found

    def _find(
        self, held: _Held, grey: NDArray[np.uint8], pose: FloatArray, at: FloatArray
    ) -> TrackedPoint | None:
        ray = pose[:3, :3].T @ at
        if not ray[2] > LEAST_Z:  # nan as well
            return None
        pixel = self.camera.project(ray[None])[0]
        if not np.isfinite(pixel).all():
            return None
        half = _LOST_VIEW_PX if self._missed and not self._within_px else _VIEW_PX
        turn = rotation_between(held.turn[:, 2], at) @ held.turn
        view = self._view(grey, pose, turn, half, pixel)
        fit = None if self._missed or self._within_px else self._flow(held, view)
        if fit is None:
            near = np.full(2, float(half)) if self._within_px else None
            found = search(held.template, view, [np.eye(2)], near, self._whole)
            if found is None or not found[1]:
                return None
            fit = found[0]
            if not self._is_same(held, view, fit):
                return None
        covariance = held.earlier + fit.covariance
        if self._within_px:
            covariance = covariance + (_OBJECT_SIGMA_PX / self._coarse) ** 2 * np.eye(2)
        point = TrackedPoint(
            view.to_pixels(fit.place[None])[0], view.sigma_px(fit.place, covariance)
        )
        direction = turn @ np.append((fit.place + view.corner) / view.focal, 1.0)
        direction /= np.linalg.norm(direction)
        self._motion = np.zeros(3) if self._missed else direction - self._direction
        still = hypot(*(point.pixel - self._pixel)) < _STILL_PX
        self._direction, self._pixel = direction, point.pixel
        if still and held is not self._first:
            first = self._first.template.align(view, fit.place, np.eye(2))
            if first is not None and first.likeness > _RENEWAL_LIKENESS:
                self._held, fit = self._first, first
        if still:
            self._faint = self._faint + 1 if fit.likeness < _RENEWAL_LIKENESS else 0
        self._covariance = covariance
        return point

    def _renew(self, held: _Held, grey: NDArray[np.uint8], pose: FloatArray) -> None:
        """Use a further template, where the point has been found."""
        turn = rotation_between(held.turn[:, 2], self._direction) @ held.turn
        view, template = self._cut(grey, pose, turn, self._pixel)
        whole = view.holds(np.full(2, float(_VIEW_PX)), RADIUS_PX + 1)
        if whole and template.worst_sigma_px < MOST_SIGMA_PX:
            start = view.image.astype(np.uint8)
            self._held, self._faint = _Held(template, turn, start, self._covariance), 0

    def _is_same(self, held: _Held, view: View, fit: Fit) -> bool:
        """True if what has been found is like the template; an object near its prediction."""
        if not self._within_px:
            return fit.likeness >= LEAST_LIKENESS
        most_px = (1 + self._missed) * max(self._within_px, _OBJECT_JUMP_PX / self._coarse)
        return (
            hypot(*(fit.place + view.corner)) < most_px
            and 1.0 / _OBJECT_GAIN < fit.gain < _OBJECT_GAIN
            and abs(fit.rise) < _OBJECT_RISE * sqrt(held.template.contrast)
            and fit.likeness >= _LEAST_OBJECT_LIKENESS
        )

    def _flow(self, held: _Held, view: View) -> Fit | None:
        """Place of the template near the middle of a view; None if it is not surely there."""
        middle = np.full(2, float(_VIEW_PX))
        first = middle.astype(np.float32)[None, None]
        flow, found, _ = cv2.calcOpticalFlowPyrLK(
            held.start, view.image.astype(np.uint8), first, first.copy()
        )  # fmt: skip
        fit = (
            held.template.align(view, flow[0, 0].astype(float), np.eye(2)) if found[0, 0] else None
        )
        sure = (
            fit is not None
            and fit.likeness >= LEAST_LIKENESS
            and hypot(*(fit.place - middle)) <= _SURE_PX
            and view.holds(fit.place, RADIUS_PX, self._whole)
        )
        return fit if sure else None
