"""Follow any point of one eye's image, and find it in the other eye's.

Both work in virtual views: small undistorted pinhole images with a direction fixed in frame 0,
resampled from a camera's image by its lens model and its pose. A patch in such a view stays nearly
the same while the eye turns. What is left is a small displacement and an affine change of the
patch, which least squares estimate together with gain and offset of the grey levels (the inverse
compositional method, Baker and Matthews 2004). The covariance of the displacement is that of these
least squares: the inverse of the structure tensor, times the noise of both images, which is
estimated from the images (Immerkaer 1996) and from the residuals.

The covariance describes noise. It cannot hold where the patch's model fails: at the edges of
objects, on surfaces that are curved within the patch, on glossy ones, and behind what is
transparent. There a point is refused if patches of two sizes disagree.
"""

from collections.abc import Sequence
from math import acos, ceil, hypot, inf, sqrt
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError, PointRefusedError
from vergence.models.camera import Camera, rays_to_pixels
from vergence.models.parts import FloatArray
from vergence.operands import as_operand
from vergence.vision.detection import as_pixel
from vergence.vision.image import as_grey

Grey = NDArray[np.float32]

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
_AXES: Final = ((1, 0), (0, 1))
"""Orders of a derivative along x and along y (numerical)."""
_ITERATIONS: Final = 12
"""Most iterations of an alignment (chosen)."""
_CONVERGED_PX: Final = 0.005
"""Last step of an alignment that has converged, px (numerical)."""
_STRETCH_SIGMA: Final = 0.3
"""Standard deviation of a patch's affine change before it is measured (chosen: slants up to 60
degrees at the least distances)."""
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
_DISTINCT_NOISE: Final = 0.25
_DISTINCT_CONTRAST: Final = 0.15
"""Least excess of the second-best place's misfit, as shares of the best one's and of the variance
of the patch (chosen: repeating patterns against noise, whose misfits scatter by 6 %)."""
_ROWS_PX: Final = 6
"""Tolerance across the epipolar line, px (chosen: errors of encoders)."""
_APART_PX: Final = 4
"""Least distance of two places that a patch may be at, px (chosen: width of a correlation peak)."""
_CORE_NOISE: Final = 2.2
_CORE_CONTRAST: Final = 0.03
"""Largest misfit of a patch's middle, as shares of the noise and of the patch's variance (chosen:
edges of objects; 49 pixels of noise exceed it in no case in 10,000)."""
_PLACES: Final = 6
"""Most places whose alignment is tried (chosen: time against slanted surfaces)."""
_STRETCHES: Final = tuple(np.diag([width, 1.0]) for width in (0.75, 1.0, 1.33))
"""Widths of a patch in the other eye for which it is searched (chosen: slants)."""
_CONSISTENT_PX: Final = 1.0
"""Largest distance of a point from itself, there and back, px (chosen: false matches)."""
_ALONG_BASELINE: Final = 0.95
"""Largest cosine between a ray and the baseline (chosen: 18 degrees, where no depth is left)."""
_INTERPOLATED: Final = 0.75
"""Share of white noise that cubic interpolation leaves, mean over positions (numerical)."""
_GRADIENT_NOISE: Final = 0.23
"""Variance of Scharr's derivative of white noise of variance 1 (numerical)."""
_NOISE_KERNEL: Final = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
"""Difference of two Laplacians; noise of variance 1 becomes 36 (Immerkaer 1996, equation 4)."""
_NORMAL_MEDIAN: Final = 0.6745
"""Median of the magnitude of normal numbers of variance 1 (numerical)."""
_NOISE_REGION_PX: Final = 24
"""Half the side of the region whose noise is estimated, px (chosen: local against certain)."""
_ROUNDING: Final = 1.0 / 12.0
"""Variance of rounding to whole grey levels (numerical)."""
_NOWHERE_PX: Final = -1000.0
"""Coordinate of what no pixel shows (numerical)."""
_LEAST_Z: Final = 0.1
"""Least share of a direction along the optical axis of a camera that may see it (chosen)."""


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


class _View(NamedTuple):
    """A virtual view; its unit is a pixel of the image near its middle."""

    camera: Camera
    turn: FloatArray  # (3, 3) rotation R_C_V to the camera
    focal: tuple[float, float]
    corner: tuple[float, float]  # (x, y) of the upper left pixel, with 0 on the view's axis
    image: Grey
    pixels: Grey  # (height, width, 2) in the camera's image; far outside if there is none
    noise: float  # variance of the camera's grey levels

    def seen(self, part: tuple[slice, slice] = (slice(None), slice(None))) -> NDArray[np.bool_]:
        """Which places of a part lie in the camera's image."""
        pixels, (width, height) = self.pixels[part], self.camera.size
        u, v = pixels[..., 0], pixels[..., 1]
        return np.asarray((u >= 0.0) & (u <= width - 1) & (v >= 0.0) & (v <= height - 1))

    def to_pixels(self, places: FloatArray) -> FloatArray:
        """Pixels of the camera's image, (n, 2), for places of the view, (n, 2)."""
        rays = (places + self.corner) / self.focal
        turned = np.column_stack([rays, np.ones(len(rays))]) @ self.turn.T
        return np.asarray(rays_to_pixels(turned[:, :2] / turned[:, 2:], self.camera.row))

    def holds(self, place: FloatArray, radius: int) -> bool:
        """True if the camera sees a patch around a place."""
        x, y, (height, width) = round(place[0]), round(place[1]), self.image.shape
        if not (radius <= x < width - radius and radius <= y < height - radius):
            return False
        rows, columns = (slice(each - radius, each + radius + 1) for each in (y, x))
        return bool(self.seen((rows, columns)).all())


def _look(
    camera: Camera, grey: NDArray[np.uint8], turn: FloatArray, focal: tuple[float, float],
    bounds: tuple[int, int, int, int], noise: float,
) -> _View:  # fmt: skip
    """Virtual view of whole pixels from (x0, y0) to (x1, y1) inclusive, with 0 on its axis."""
    x0, y0, x1, y1 = bounds
    grid = np.empty((y1 - y0 + 1, x1 - x0 + 1, 2))
    grid[..., 0] = np.arange(x0, x1 + 1) / focal[0]
    grid[..., 1] = np.arange(y0, y1 + 1)[:, None] / focal[1]
    pixels = np.asarray(rays_to_pixels(cv2.perspectiveTransform(grid, turn), camera.row))
    pixels[grid @ turn[2, :2] + turn[2, 2] < _LEAST_Z] = np.nan
    where = pixels.astype(np.float32)
    cv2.patchNaNs(where, _NOWHERE_PX)
    image: Any = cv2.remap(grey, where, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
    return _View(camera, turn, focal, (x0, y0), image.astype(np.float32), where, noise)


def _noise(grey: NDArray[np.uint8], pixel: FloatArray) -> float:
    """Variance of the noise of grey levels around a pixel (Immerkaer 1996, by the median)."""
    u, v = (
        int(np.clip(value, 0, size)) for value, size in zip(pixel, grey.shape[::-1], strict=True)
    )
    r = _NOISE_REGION_PX
    region = grey[max(v - r, 0) : v + r, max(u - r, 0) : u + r]
    if min(region.shape) < 8:
        return _ROUNDING
    response = np.abs(cv2.filter2D(region, cv2.CV_32F, _NOISE_KERNEL)[1:-1, 1:-1])
    return max(float(np.median(response)) / (6.0 * _NORMAL_MEDIAN), sqrt(_ROUNDING)) ** 2


def _focal_at(camera: Camera, ray: FloatArray) -> float:
    """Pixels per radian of an image around a ray (x, y), mean over directions."""
    x, y = ray
    step = 1e-3
    a, b, c, d = camera.project(
        [[x + step, y, 1], [x - step, y, 1], [x, y + step, 1], [x, y - step, 1]]
    )
    jacobian = np.column_stack([a - b, c - d]) / (2 * step)
    return sqrt(abs(np.linalg.det(jacobian)) * (1.0 + x * x + y * y) ** 1.5)


def _rotation(source: FloatArray, target: FloatArray) -> FloatArray:
    """Smallest rotation between two directions, (3, 3)."""
    axis, cosine = np.cross(source, target), float(source @ target)
    sine = float(np.linalg.norm(axis))
    angle = acos(min(max(cosine, -1.0), 1.0))
    return np.asarray(cv2.Rodrigues(axis * (angle / sine if sine > 0.0 else 1.0))[0])


class _Fit(NamedTuple):
    """A template aligned with a view."""

    stretch: FloatArray  # (2, 2) from the template to the view
    place: FloatArray  # (2,) of the template's middle in the view
    covariance: FloatArray  # (2, 2) of it, px^2
    misfit: float  # variance of the template that the view does not explain
    core: float  # the same of its middle alone
    likeness: float  # correlation without noise


class _Template:
    """A patch to align with views, and the least squares that do so."""

    def __init__(self, view: _View, place: FloatArray, radius: int, affine: int = 4) -> None:
        side = 2 * radius + 1
        self.radius, self.noise = radius, view.noise
        around = cv2.getRectSubPix(view.image, (side + 4, side + 4), place.tolist())
        self.patch: Grey = np.asarray(around[2:-2, 2:-2])
        slopes = [cv2.Scharr(around, cv2.CV_32F, *order, scale=1 / 32) for order in _AXES]
        # what more blur changes: second derivatives
        bends = [cv2.Scharr(slopes[i], cv2.CV_32F, *_AXES[j], scale=1 / 32)
                 for i, j in ((0, 0), (0, 1), (1, 1))]  # fmt: skip
        gx, gy, *bends = (each[2:-2, 2:-2].ravel().astype(float) for each in (*slopes, *bends))
        x, y = (np.arange(side) - radius) / radius, (np.arange(side)[:, None] - radius) / radius
        x, y = (np.broadcast_to(each, (side, side)).ravel() for each in (x, y))
        level = self.patch.ravel() - float(self.patch.mean())
        slopes = [gx, gy, x * gx, y * gx, x * gy, y * gy][: 2 + affine]
        columns = np.column_stack([*slopes, np.ones(side * side), level, *bends])
        normal = columns.T @ columns
        # prior knowledge, which steps without texture do not leave
        weight = np.full(len(slopes), 2 * self.noise / (_STRETCH_SIGMA * radius) ** 2)
        weight[:2] = 1e-3 * self.noise
        prior = np.diag([*weight, 1e-6, 1e-6, *[1e-2 * self.noise * side] * 3])
        self._step = np.linalg.inv(normal + prior) @ columns.T
        self._columns, self.affine = columns, affine
        self.contrast = float(level.var())
        # the structure tensor without what noise adds to it
        share = np.array([1, 1, *[np.mean(x**2)] * 4])[: 2 + affine]
        count = len(slopes)
        normal[:count, :count] -= np.diag(share) * (
            _GRADIENT_NOISE * _INTERPOLATED * self.noise * side**2
        )
        values, vectors = np.linalg.eigh(normal + prior)
        values = np.maximum(values, 1e-3 * self.noise)
        self._spread = ((vectors / values) @ vectors.T)[:2, :2]
        self.covariance = 2 * self.noise * self._spread

    @property
    def worst_sigma_px(self) -> float:
        """Standard deviation in the direction in which it is largest."""
        return sqrt(float(np.linalg.eigvalsh(self.covariance)[-1]))

    def stretched(self, stretch: FloatArray) -> Grey:
        """The patch after an affine change about its middle."""
        middle = np.full(2, float(self.radius))
        warp = np.column_stack([stretch, middle - stretch @ middle])
        image: Any = cv2.warpAffine(
            self.patch, warp, self.patch.shape, borderMode=cv2.BORDER_REFLECT_101
        )
        return np.asarray(image)

    def align(self, view: _View, place: FloatArray, stretch: FloatArray) -> _Fit | None:
        """Align with a view from a first place and stretch; None if it does not converge there."""
        side, start = 2 * self.radius + 1, place
        warp, steps = np.empty((2, 3)), np.zeros(6)
        for _ in range(_ITERATIONS):
            warp[:, :2], warp[:, 2] = stretch, place - self.radius * stretch.sum(axis=1)
            seen: Any = cv2.warpAffine(
                view.image, warp, (side, side), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_REPLICATE,
            )  # fmt: skip
            levels = seen.ravel().astype(float)
            found = self._step @ levels
            gain = found[3 + self.affine]
            if gain < 0.2:
                return None
            steps[: 2 + self.affine] = found[: 2 + self.affine] / gain
            place = place - stretch @ steps[:2]
            stretch = stretch - stretch @ steps[2:].reshape(2, 2) / self.radius
            (a, b), (c, d) = stretch.tolist()
            if hypot(*(place - start)) > self.radius or not 0.3 < a * d - b * c < 3.0:
                return None
            if hypot(steps[0], steps[1]) < _CONVERGED_PX:
                break
        else:
            return None
        squares = (levels - self._columns @ found).reshape(side, side) ** 2
        residual, r = float(squares.mean()), self.radius
        core = float(squares[r - 3 : r + 4, r - 3 : r + 4].mean()) / gain**2
        variance = float(levels.var())
        both = view.noise + gain**2 * self.noise
        excess = max(residual - _INTERPOLATED * both, 0.0)
        likeness = sqrt(max(1.0 - excess / max(variance - _INTERPOLATED * view.noise, 1e-9), 0.0))
        misfit = self.contrast * residual / max(variance, 1e-9)
        noise = max(residual, both) / gain**2
        covariance = stretch @ (noise * self._spread) @ stretch.T
        return _Fit(stretch, place, covariance, misfit, core, likeness)


def _sigma_px(view: _View, place: FloatArray, covariance: FloatArray) -> FloatArray:
    """Standard deviations in the camera's image of a place with a covariance."""
    a, b, c, d = view.to_pixels(place + 0.5 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))
    jacobian = np.column_stack([a - b, c - d])
    return np.asarray(np.sqrt(np.diagonal(jacobian @ covariance @ jacobian.T)))


def _peaks(scores: Grey, most: int) -> list[tuple[int, int]]:
    """Highest local maxima (x, y) of a map, best first."""
    side = 2 * _APART_PX + 1
    top = (scores >= cv2.dilate(scores, np.ones((side, side), np.uint8))) & (scores > 0.0)
    rows, columns = np.nonzero(top)
    order = np.argsort(-scores[rows, columns])[:most]
    return [(int(columns[i]), int(rows[i])) for i in order]


def _search(
    template: _Template, view: _View, stretches: Sequence[FloatArray],
    near: FloatArray | None = None,
) -> tuple[_Fit, bool] | None:  # fmt: skip
    """Best place of a template in a view, and true if no other place is nearly as good."""
    fits: list[_Fit] = []
    r = template.radius
    kernel = np.ones((2 * r + 1, 2 * r + 1), np.uint8)
    valid = cv2.erode(view.seen().astype(np.uint8), kernel, borderValue=0)[r:-r, r:-r]
    if min(valid.shape) < 1 or not valid.any():
        return None
    starts = []
    for k, stretch in enumerate(stretches):
        patch = template.stretched(stretch)
        scores: Any = cv2.matchTemplate(view.image, patch, cv2.TM_CCOEFF_NORMED)
        scores = np.where(valid > 0, np.nan_to_num(scores), -1.0).astype(np.float32)
        starts += [(float(scores[y, x]), x + r, y + r, k) for x, y in _peaks(scores, _PLACES)]
    starts.sort(reverse=True)
    if near is not None:
        starts.insert(0, (1.0, near[0], near[1], len(stretches) // 2))
    tried: list[tuple[float, float]] = []
    for _, x, y, k in starts:
        if any(hypot(x - u, y - v) < _APART_PX for u, v in tried):
            continue
        tried.append((x, y))
        if len(tried) > _PLACES:
            break
        fit = template.align(view, np.array([x, y], float), stretches[k])
        if fit is not None and view.holds(fit.place, r):
            fits.append(fit)
    if not fits:
        return None
    best = max(fits, key=lambda fit: fit.likeness)
    others = [fit for fit in fits if hypot(*(fit.place - best.place)) > _APART_PX]
    least = max(best.misfit, view.noise + template.noise)
    clean = max(template.contrast - template.noise, 0.0)
    limit = (1.0 + _DISTINCT_NOISE) * least + _DISTINCT_CONTRAST * clean
    return best, all(fit.misfit > limit for fit in others)


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
        self._template: _Template | None = None

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
        turn = pose[:3, :3] @ _rotation(np.array([0.0, 0.0, 1.0]), ray)
        focal = _focal_at(self.camera, ray[:2] / ray[2])
        view = self._view(grey, pose, turn, focal, _VIEW_PX, _noise(grey, pixel))
        middle = np.full(2, float(_VIEW_PX))
        if not view.holds(middle, _RADIUS_PX + 1):
            raise _refuse(pixel, _BORDER)
        template = _Template(view, middle, _RADIUS_PX)
        if template.worst_sigma_px > _MOST_SIGMA_PX:
            raise _refuse(pixel, _TEXTURELESS)
        same = _search(template, view, [np.eye(2)])
        if same is None or not same[1]:
            raise _refuse(pixel, _REPEATING)
        self._focal, self._earlier = focal, np.zeros((2, 2))
        self._direction, self._motion, self._missed = direction, np.zeros(3), 0
        self._keep(template, view, turn)
        return TrackedPoint(pixel, _sigma_px(view, middle, template.covariance))

    def _view(
        self, grey: NDArray[np.uint8], pose: FloatArray, turn: FloatArray, focal: float,
        half: int, noise: float,
    ) -> _View:  # fmt: skip
        """View of this eye with a rotation R_0_V."""
        bounds = (-half, -half, half, half)
        return _look(self.camera, grey, pose[:3, :3].T @ turn, (focal, focal), bounds, noise)

    def _keep(self, template: _Template, view: _View, turn: FloatArray) -> None:
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
        if not ray[2] > _LEAST_Z:  # nan as well
            return None
        pixel = self.camera.project(ray[None])[0]
        if not np.isfinite(pixel).all():
            return None
        half = _LOST_VIEW_PX if self._missed else _VIEW_PX
        turn = _rotation(self._turn[:, 2], at) @ self._turn
        view = self._view(grey, pose, turn, self._focal, half, _noise(grey, pixel))
        fit = None if self._missed else self._flow(view)
        if fit is None:
            found = _search(template, view, [self._stretch])
            if found is None or not found[1] or found[0].likeness < _LEAST_LIKENESS:
                return None
            fit = found[0]
        covariance = self._earlier + fit.covariance
        point = TrackedPoint(
            view.to_pixels(fit.place[None])[0], _sigma_px(view, fit.place, covariance)
        )
        direction = turn @ np.append((fit.place + view.corner) / view.focal, 1.0)
        direction /= np.linalg.norm(direction)
        self._motion = np.zeros(3) if self._missed else direction - self._direction
        self._direction, self._stretch = direction, fit.stretch
        self._faint = self._faint + 1 if fit.likeness < _RENEWAL_LIKENESS else 0
        if self._faint >= _RENEWAL_IMAGES:
            turn = _rotation(turn[:, 2], direction) @ turn
            view = self._view(grey, pose, turn, self._focal, _VIEW_PX, view.noise)
            middle = np.full(2, float(_VIEW_PX))
            renewed = _Template(view, middle, _RADIUS_PX)
            if view.holds(middle, _RADIUS_PX + 1) and renewed.worst_sigma_px < _MOST_SIGMA_PX:
                self._earlier = covariance
                self._keep(renewed, view, turn)
        return point

    def _flow(self, view: _View) -> _Fit | None:
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
            f"depth_range_m: expected two distances above 0, the second larger, got {near} {far}"
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
        local = _focal_at(camera, ray[:2] / ray[2])
        # an angle off the axis is stretched by 1 / sine^2 along x, by 1 / sine across
        focal = (local * sine**2, local * sine)
        x = focal[0] * cosine / sine
        middle, r = round(x), _RADIUS_PX + 1
        noise = _noise(self.greys[eye], pixel)
        bounds = (middle - r - 1, -r, middle + r + 1, r)
        view = _look(camera, self.greys[eye], pose[:3, :3].T @ turn, focal, bounds, noise)
        place = np.array([x, 0.0]) - view.corner
        if not view.holds(place, _RADIUS_PX):
            raise _refuse(pixel, _BORDER)
        template, core = (
            _Template(view, place, _RADIUS_PX, 2),
            _Template(view, place, _CORE_PX, 0),
        )
        if template.worst_sigma_px > _MOST_SIGMA_PX or core.worst_sigma_px > _MOST_CORE_SIGMA_PX:
            raise _refuse(pixel, _TEXTURELESS)

        def shift_px(distance_m: float) -> float:
            return focal[0] * length_m / (distance_m * sine)

        least, most = (shift_px(distance_m) for distance_m in self.depth_range_m[::-1])
        room = r + _ROWS_PX
        strip = (
            ceil(x - most) - room, -room, ceil(x - least) + room, room
        )  # fmt: skip
        strip_view = _look(
            self.cameras[other], self.greys[other], self.poses[other][:3, :3].T @ turn, focal,
            strip, noise,
        )  # fmt: skip
        near = None
        if near_depth_m is not None:
            near = np.array([x - shift_px(near_depth_m), 0.0]) - strip_view.corner
        found = _search(template, strip_view, _STRETCHES, near)
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
            _sigma_px(strip_view, fit.place, fit.covariance),
            depth_m,
            fit.likeness,
        )
