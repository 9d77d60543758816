"""Align a patch of an image with virtual views, and say how surely.

A virtual view is a small undistorted pinhole image with a direction fixed in frame 0, resampled
from a camera's image by its lens model and its pose. The displacement and the affine change of a
patch between two of them are estimated by least squares, together with gain, offset and blur of
the grey levels (the inverse compositional method, Baker and Matthews 2004). The covariance of the
displacement is that of these least squares: the inverse of the structure tensor, times the noise
of both images, which is estimated from the images (Immerkaer 1996) and from the residuals.
"""

from collections.abc import Sequence
from math import hypot, sqrt
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.models.camera import Camera, rays_to_pixels
from vergence.models.parts import FloatArray

Grey = NDArray[np.float32]

_AXES: Final = ((1, 0), (0, 1))
"""Orders of a derivative along x and along y (numerical)."""
_ITERATIONS: Final = 12
"""Most iterations of an alignment (chosen)."""
_CONVERGED_PX: Final = 0.005
"""Last step of an alignment that has converged, px (numerical)."""
_STRETCH_SIGMA: Final = 0.3
"""Standard deviation of a patch's affine change before it is measured (chosen: slants up to 60
degrees at the least distances)."""
_DISTINCT_NOISE: Final = 0.25
_DISTINCT_PX: Final = 0.3
"""Least excess of the second-best place's misfit: a share of the best one's, and a displacement
that would cause it, px (chosen: repeating patterns against noise, whose misfits scatter by 6 %)."""
_APART_PX: Final = 4
"""Least distance of two places that a patch may be at, px (chosen: width of a correlation peak)."""
_PLACES: Final = 6
"""Most places whose alignment is tried (chosen: time against slanted surfaces)."""
_INTERPOLATED: Final = 0.75
"""Share of white noise that cubic interpolation leaves, mean over positions (numerical)."""
_MODEL_SIGMA_PX: Final = 0.02
"""Standard deviation by interpolation, px (measured: by benchmarks/points.py)."""
_SAME_EYE_SIGMA_PX: Final = 0.012
"""The same for displacements between images of one eye (measured: by benchmarks/points.py)."""
_BLUR_SIGMA: Final = 0.04
"""Further one in an image whose blur differs, px per square of half the blur's variance in px^2
(measured: by benchmarks/points.py, smears up to 6 px)."""
_UNLIKE_SIGMA: Final = 0.2
"""Further one by misfits, px per px of displacement that would cause them (measured: photographs,
whose errors across epipolar lines are 0.06 px at none and 0.2 px at 0.8 px)."""
_FADING_PX: Final = 0.5
"""Distance over which a round patch fades, px (measured: balls before textured surfaces)."""
_GRADIENT_NOISE: Final = 0.23
"""Variance of Scharr's derivative of white noise of variance 1 (numerical)."""
_NOISE_KERNEL: Final = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
"""Difference of two Laplacians; noise of variance 1 becomes 36 (Immerkaer 1996, equation 4)."""
_NORMAL_MEDIAN: Final = 0.6745
"""Median of the magnitude of normal numbers of variance 1 (numerical)."""
_NOISE_REGION_PX: Final = 24
"""Half the side of the region whose noise is estimated, px (chosen: local against certain)."""
_LEAST_NOISE: Final = 2.0
"""Smallest variance of noise, squared grey levels (measured: JPEG at 92 hides noise from the
estimate, and leaves errors of 2 to 5)."""
_NOWHERE_PX: Final = -1000.0
"""Coordinate of what no pixel shows (numerical)."""
LEAST_Z: Final = 0.1
"""Least share of a direction along the optical axis of a camera that may see it (chosen)."""


class View(NamedTuple):
    """A virtual view; its unit is a pixel of the image near its middle."""

    camera: Camera
    turn: FloatArray  # (3, 3) rotation R_C_V to the camera
    focal: tuple[float, float]
    corner: tuple[float, float]  # (x, y) of the upper left pixel, with 0 on the view's axis
    image: Grey
    seen: NDArray[np.uint8]  # 255 where the camera's image shows a place, else 0
    noise: float  # variance of the camera's grey levels

    def to_pixels(self, places: FloatArray) -> FloatArray:
        """Pixels of the camera's image, (n, 2), for places of the view, (n, 2)."""
        rays = (places + self.corner) / self.focal
        turned = np.column_stack([rays, np.ones(len(rays))]) @ self.turn.T
        return np.asarray(rays_to_pixels(turned[:, :2] / turned[:, 2:], self.camera.row))

    def holds(self, place: FloatArray, radius: int, whole: bool = True) -> bool:
        """True if the view has a patch around a place, and the camera sees it or its middle."""
        x, y, (height, width) = round(place[0]), round(place[1]), self.image.shape
        reach = radius if whole else 0
        part = self.seen[y - reach : y + reach + 1, x - reach : x + reach + 1]
        inside = radius <= x < width - radius and radius <= y < height - radius
        return inside and bool(part.all())

    def jacobian(self, place: FloatArray) -> FloatArray:
        """Derivative of the camera's pixel by a place of the view, (2, 2)."""
        a, b, c, d = self.to_pixels(place + 0.5 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))
        return np.column_stack([a - b, c - d])

    def sigma_px(self, place: FloatArray, covariance: FloatArray) -> FloatArray:
        """Standard deviations in the camera's image of a place with a covariance."""
        jacobian = self.jacobian(place)
        return np.asarray(np.sqrt(np.diagonal(jacobian @ covariance @ jacobian.T)))


def look(
    camera: Camera, grey: NDArray[np.uint8], turn: FloatArray, focal: tuple[float, float],
    corner: tuple[float, float], size: tuple[int, int], noise: float,
) -> View:  # fmt: skip
    """Virtual view of a size (width, height), whose axis is at 0."""
    grid = np.empty((size[1], size[0], 2))
    grid[..., 0] = (np.arange(size[0]) + corner[0]) / focal[0]
    grid[..., 1] = (np.arange(size[1])[:, None] + corner[1]) / focal[1]
    pixels = np.asarray(rays_to_pixels(cv2.perspectiveTransform(grid, turn), camera.row))
    pixels[grid @ turn[2, :2] + turn[2, 2] < LEAST_Z] = np.nan
    where: Any = pixels.astype(np.float32)
    cv2.patchNaNs(where, _NOWHERE_PX)
    image: Any = cv2.remap(grey, where, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
    seen: Any = cv2.inRange(where, (0.0, 0.0), (camera.width - 1.0, camera.height - 1.0))
    return View(camera, turn, focal, corner, image.astype(np.float32), seen, noise)


def noise_variance(grey: NDArray[np.uint8], pixel: FloatArray) -> float:
    """Variance of the noise of grey levels around a pixel (Immerkaer 1996, by the median)."""
    u, v = np.clip(np.rint(pixel), 0, grey.shape[::-1]).astype(int).tolist()
    r = _NOISE_REGION_PX
    region = grey[max(v - r, 0) : v + r, max(u - r, 0) : u + r]
    if min(region.shape) < 8:
        return _LEAST_NOISE
    response = np.abs(cv2.filter2D(region, cv2.CV_32F, _NOISE_KERNEL)[1:-1, 1:-1])
    return max(float(np.median(response)) / (6.0 * _NORMAL_MEDIAN), sqrt(_LEAST_NOISE)) ** 2


def focal_at(camera: Camera, ray: FloatArray) -> float:
    """Pixels per radian of an image around a ray, mean over directions."""
    x, y = ray[:2] / ray[2]
    step = 1e-3
    around = np.array([[step, 0, 0], [-step, 0, 0], [0, step, 0], [0, -step, 0]])
    a, b, c, d = camera.project(around + (x, y, 1.0))
    jacobian = np.column_stack([a - b, c - d]) / (2 * step)
    return sqrt(abs(np.linalg.det(jacobian)) * (1.0 + x * x + y * y) ** 1.5)


def rotation_between(source: FloatArray, target: FloatArray) -> FloatArray:
    """Smallest rotation between two directions that are not opposite, (3, 3)."""
    across = np.cross(np.eye(3), np.cross(source, target))
    return np.asarray(np.eye(3) + across + across @ across / (1.0 + source @ target))


class Fit(NamedTuple):
    """A template aligned with a view."""

    stretch: FloatArray  # (2, 2) from the template to the view
    place: FloatArray  # (2,) of the template's middle in the view
    covariance: FloatArray  # (2, 2) of it, px^2
    model_px: float  # standard deviation by the share of that which is no noise
    misfit: float  # variance of the template that the view does not explain
    unlike_px: float  # displacement that would cause the misfit of the worst quarter beyond noise
    likeness: float  # correlation without noise
    gain: float  # contrast of the view by that of the template
    rise: float  # mean grey level of the view above that of the template


class Template:
    """A patch to align with views, and the least squares that do so.

    A round one counts in full within a distance from its middle, and fades from there.
    """

    def __init__(
        self, view: View, place: FloatArray, radius: int, affine: int = 4,
        within_px: float | None = None,
    ) -> None:  # fmt: skip
        side = 2 * radius + 1
        self.radius, self.noise, self.round = radius, view.noise, within_px is not None
        around = cv2.getRectSubPix(view.image, (side + 4, side + 4), place.tolist())
        self.patch: Grey = np.asarray(around[2:-2, 2:-2])
        slopes = [cv2.Scharr(around, cv2.CV_32F, *order, scale=1 / 32) for order in _AXES]
        # what more blur changes: second derivatives
        bends = [cv2.Scharr(slopes[i], cv2.CV_32F, *_AXES[j], scale=1 / 32)
                 for i, j in ((0, 0), (0, 1), (1, 1))]  # fmt: skip
        gx, gy, *bends = (each[2:-2, 2:-2].ravel().astype(float) for each in (*slopes, *bends))
        y, x = np.mgrid[-1 : 1 : side * 1j, -1 : 1 : side * 1j].reshape(2, -1)
        self.weight: Grey = np.ones((side, side), np.float32)
        if within_px is not None:
            beyond_px = radius * np.hypot(x, y) - within_px
            self.weight[:] = (1.0 - beyond_px / _FADING_PX).clip(0, 1).reshape(side, side)
        weight = self._weight = self.weight.ravel() / float(self.weight.mean())
        self._mean = float((weight * self.patch.ravel()).mean())
        level = self.patch.ravel() - self._mean
        slopes = [gx, gy, x * gx, y * gx, x * gy, y * gy][: 2 + affine]
        columns = np.column_stack([*slopes, np.ones(side * side), level, *bends])
        weighted = columns * weight[:, None]
        normal = columns.T @ weighted
        # prior knowledge, which steps without texture do not leave
        known = np.full(len(slopes), 2 * self.noise / (_STRETCH_SIGMA * radius) ** 2)
        known[:2] = 1e-3 * self.noise
        prior = np.diag([*known, 1e-6, 1e-6, *[1e-2 * self.noise * side] * 3])
        self._step = np.linalg.inv(normal + prior) @ weighted.T
        self._columns, self.affine = columns, affine
        self.contrast = float((weight * level**2).mean())
        # the structure tensor without what noise adds to it
        share = np.array([1, 1, *[np.mean(x**2)] * 4])[: 2 + affine]
        count = len(slopes)
        normal[:count, :count] -= np.diag(share) * (
            _GRADIENT_NOISE * _INTERPOLATED * self.noise * side**2
        )
        slopes_2 = (gx**2 + gy**2).reshape(side, side)  # misfits by a displacement, per px^2
        self.slopes: Any = cv2.resize(slopes_2, (2, 2), interpolation=cv2.INTER_AREA).clip(1e-3)
        values, vectors = np.linalg.eigh(normal + prior)
        values = np.maximum(values, 1e-3 * self.noise)
        self._spread = ((vectors / values) @ vectors.T)[:2, :2]
        self.covariance = 2 * self.noise * self._spread

    @property
    def worst_sigma_px(self) -> float:
        """Standard deviation in the direction in which it is largest."""
        return sqrt(float(np.linalg.eigvalsh(self.covariance)[-1]))

    def align(self, view: View, place: FloatArray, stretch: FloatArray) -> Fit | None:
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
            step = found[: 2 + self.affine] / gain
            # half of it where the last one went too far
            steps[: 2 + self.affine] = step if step[:2] @ steps[:2] >= 0.0 else 0.5 * step
            place = place - stretch @ steps[:2]
            stretch = stretch - stretch @ steps[2:].reshape(2, 2) / self.radius
            (a, b), (c, d) = stretch.tolist()
            if hypot(*(place - start)) > self.radius or not 0.3 < a * d - b * c < 3.0:
                return None
            if hypot(steps[0], steps[1]) < _CONVERGED_PX:
                break
        else:
            return None
        squares = (self._weight * (levels - self._columns @ found) ** 2).reshape(side, side)
        quarters = cv2.resize(squares, (2, 2), interpolation=cv2.INTER_AREA)
        residual = float(quarters.mean())
        mean = float((self._weight * levels).mean())
        variance = float((self._weight * (levels - mean) ** 2).mean())
        both = view.noise + gain**2 * self.noise
        excess = max(residual - _INTERPOLATED * both, 0.0)
        likeness = sqrt(max(1.0 - excess / max(variance - _INTERPOLATED * view.noise, 1e-9), 0.0))
        beyond = float(((quarters - both) / self.slopes).max())  # noise alone leaves less
        unlike_px = sqrt(max(beyond, 0.0)) / gain
        noise = max(residual, both) / gain**2
        covariance = stretch @ (noise * self._spread) @ stretch.T
        blur_px2 = float(np.linalg.norm(found[4 + self.affine :])) / gain
        unlike = hypot(_MODEL_SIGMA_PX, _UNLIKE_SIGMA * unlike_px)
        model_px = hypot(unlike if self.affine else _SAME_EYE_SIGMA_PX, _BLUR_SIGMA * blur_px2**2)
        covariance += model_px**2 * np.eye(2)
        return Fit(
            stretch, place, covariance, model_px, residual / gain**2, unlike_px, likeness,
            float(gain), mean - self._mean,
        )  # fmt: skip


def search(
    template: Template, view: View, stretches: Sequence[FloatArray],
    near: FloatArray | None = None, whole: bool = True,
) -> tuple[Fit, bool] | None:  # fmt: skip
    """Best place of a template in a view, and true if no other place is nearly as good.

    The camera must see all of the patch if it is to be whole, else its middle.
    """
    r = template.radius
    valid: Any = view.seen
    if whole:
        valid = cv2.erode(valid, np.ones((2 * r + 1, 2 * r + 1)), borderValue=0)
    valid = valid[r:-r, r:-r] > 0
    if not valid.any():
        return None
    starts = []
    for k, stretch in enumerate(stretches):
        warp = np.column_stack([stretch, r * (1.0 - stretch.sum(axis=1))])
        patch = cv2.warpAffine(
            template.patch, warp, template.patch.shape, borderMode=cv2.BORDER_REFLECT_101
        )
        mask = template.weight if template.round else None
        scores: Any = cv2.matchTemplate(view.image, patch, cv2.TM_CCOEFF_NORMED, mask=mask)
        # where there is no contrast a score may be anything
        scores[~valid | (np.abs(scores) >= 1.01)] = -1.0
        highest = scores == cv2.dilate(scores, np.ones((2 * _APART_PX + 1, 2 * _APART_PX + 1)))
        rows, columns = np.nonzero(highest & (scores > 0.0))
        order = np.argsort(-scores[rows, columns])[:_PLACES]
        starts += [(float(scores[rows[i], columns[i]]), columns[i] + r, rows[i] + r, k)
                   for i in order]  # fmt: skip
    starts.sort(reverse=True)
    if near is not None:
        starts.insert(0, (1.0, near[0], near[1], len(stretches) // 2))
    tried: list[tuple[float, float]] = []
    fits: list[Fit] = []
    for _, x, y, k in starts:
        if len(tried) == _PLACES:
            break
        if any(hypot(x - u, y - v) < _APART_PX for u, v in tried):
            continue
        tried.append((x, y))
        fit = template.align(view, np.array([x, y], float), stretches[k])
        if fit is not None and view.holds(fit.place, r, whole):
            fits.append(fit)
    if not fits:
        return None
    best = max(fits, key=lambda fit: fit.likeness)
    others = [fit for fit in fits if hypot(*(fit.place - best.place)) > _APART_PX]
    least = max(best.misfit, view.noise + template.noise)
    limit = (1.0 + _DISTINCT_NOISE) * least + _DISTINCT_PX**2 * float(template.slopes.mean())
    return best, all(fit.misfit > limit for fit in others)
