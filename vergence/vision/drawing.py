"""Render one eye's image of a planar target.

A frame is rendered in the order of a real camera: projection of the board by pinhole and lens
distortion, lens blur and motion blur, integration over the area of each pixel, the rig's contrast
(and the camera's response, if stated), white noise, and rounding to 8 bits. Only the board's
region of interest is drawn; the surroundings are plain background.

Sampling. A board of black and white squares is not band-limited, so sampling it causes aliasing,
which displaces edges by up to a tenth of a pixel at two samples a pixel. The board is therefore
sampled from a texture that is blurred by about a texel beforehand and whose texel is about half a
sample, since bilinear interpolation between larger texels would alias in turn. The blur of
texture, texel and sampling grid has a known variance; a Gaussian filter then adds the variance
still missing to that of the lens blur and the pixel area.

The texture's blur is isotropic. A board seen at a steep angle is foreshortened along one
direction, and a texel that is fine enough along that direction is coarse along the other. From an
incidence of 48 degrees on, more samples are taken per pixel, in proportion to the excess size of
the texel.
"""

import math
from bisect import bisect_right
from functools import lru_cache
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.models.camera import LINEAR, Camera, light_table
from vergence.models.parts import Rendering
from vergence.vision.optics import ray_table
from vergence.vision.targets import PlanarTarget, outline_m, texture


def gaussian_radius_and_sigma(wanted_sigma: float) -> tuple[int, float]:
    """Radius of a Gaussian kernel and the sigma that gives its taps the wanted one."""
    share = 0.5 * wanted_sigma**2
    if share < 0.01:
        return 0, 0.0
    if share < 0.36:  # three taps cost half as much as five, and reach a variance of 2/3
        share = min(share, 0.333)
        return 1, math.sqrt(-0.5 / math.log(share / (1 - 2 * share)))
    return round(2.5 * wanted_sigma), wanted_sigma


def motion_blur_kernel(displacement: NDArray[np.float64]) -> NDArray[np.float32]:
    """Kernel of a uniform motion: a line through its centre with a displacement in samples."""
    count = max(math.ceil(4 * math.hypot(displacement[0], displacement[1])), 2)
    fraction = (np.arange(count) + 0.5) / count - 0.5
    half_x, half_y = (math.ceil(0.5 * abs(value)) + 1 for value in displacement.tolist())
    x, y = fraction * displacement[0] + half_x, fraction * displacement[1] + half_y
    kernel = np.zeros((2 * half_y + 1, 2 * half_x + 1), np.float32)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    for down, rows in enumerate((top + 1 - y, y - top)):
        for right, columns in enumerate((left + 1 - x, x - left)):
            np.add.at(kernel, (top + down, left + right), columns * rows / count)
    return kernel


NOISE_MEAN: Final = 128
"""Stored level of noise 0 (numerical: middle of 8 bits)."""
NOISE_UNIT: Final = 24.0
"""Stored levels per standard deviation; 127 levels cover five of them (chosen: resolution
against clipping)."""


@lru_cache(maxsize=2)
def noise_bank(side: int) -> NDArray[np.uint8]:
    """Table of normal numbers n as ``NOISE_MEAN + NOISE_UNIT * n``, equal in every process.

    Sampling normal numbers for each frame would cost as much as rendering the board. Instead the
    frame's generator picks the region's start in this table among more than a million positions.
    The noise of a pixel is then independent from frame to frame, except if two windows start
    within a few pixels of each other, about once in 10,000 pairs.
    """
    numbers = np.random.default_rng(side).standard_normal((side, side), np.float32)
    bank = np.rint(NOISE_MEAN + NOISE_UNIT * numbers).clip(0, 255)
    levels: NDArray[np.uint8] = bank.astype(np.uint8)
    levels.setflags(write=False)
    return levels


_LEAST_DEPTH_M: Final = 0.02
"""Smallest depth of a board's corner at which it is drawn, m (chosen: near views against
corners behind the camera)."""
_LEAST_INCIDENCE_COSINE: Final = 0.05
"""Least cosine between line of sight and the board's normal, about 87 degrees, at which it is
drawn (chosen: oblique views against the oversampling they need)."""
_TEXELS_PER_CELL: Final = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)
"""Texels per cell in each level of the texture pyramid (chosen: close levels against memory)."""
_LEAST_TEXEL_SAMPLES: Final = 0.45
"""Smallest size of a texel, in samples, along the most foreshortened direction (chosen: aliasing
against blur)."""
_TEXTURE_BLUR: Final = 1.35
"""Standard deviation of the texture's own blur, in texels. At the texel size above and two samples
a pixel it suits a lens blur of at least 0.45 pixels (chosen: aliasing against blur)."""
_LEAST_FINE_TEXEL_SAMPLES: Final = 0.22
"""Smallest size of a texel, in samples, for sharper images; the texture then has all the blur
(chosen: aliasing against blur)."""
_FINE_BLURS: Final = (1.35, 2.6)
"""Range of the texture's blur for these images, in texels (chosen: aliasing against blur)."""
_STEEP_RATIO: Final = 1.5
"""Ratio of the scales across and along the foreshortened direction above which a view is steep:
48 degrees (chosen: aliasing against time)."""
_OVERSAMPLING_MARGIN: Final = 1.1
"""Factor on the number of samples of steep views, for safety (chosen: aliasing against time)."""
_MOST_OVERSAMPLING: Final = 6
"""Largest factor on the number of samples along each axis (chosen: aliasing against time)."""
_TEXTURE_RIM: Final = 9
"""Surround of the board in a texture, texels (chosen: room for the texture's blur)."""
_EDGE_PARTS: Final = 8
"""Parts of an edge of the board whose ends bound it in an image with lens distortion (chosen)."""
_NOISE_MARGIN_PX: Final = 12
"""Width of the background around the board that has noise too, for detectors that look there,
px (chosen: realism against time)."""
_TABLE_MARGIN_PX: Final = 32
"""Margin of the ray table around the frame, and so the largest reach of a blur beyond it, px
(chosen: strong blur against memory)."""

Region = tuple[int, int, int, int]
"""Region of the pixels x0 <= u < x1, y0 <= v < y1 as (x0, y0, x1, y1)."""


class TargetRenderer:
    """Renders one eye's frames of a planar target, with blur, contrast and noise.

    Attributes:
        camera: the eye's intrinsics, and the response that maps light to grey levels; linear if
            it has none.
        target: the board.
        rendering: the rig's grey levels.
        frame: the image, uint8, shape (height, width), redrawn in place by `draw`.
        region: the part of the frame with the board and the noise around it; None if empty.

    Raises:
        ConfigurationError: grey levels outside 0 to 255 or not in the order black, background,
            white; a negative blur or noise; fewer than one sample a pixel.
    """

    def __init__(self, camera: Camera, target: PlanarTarget, rendering: Rendering) -> None:
        """Start with an empty frame."""
        greys = (rendering.black_grey, rendering.background_grey, rendering.white_grey)
        if not (0 <= greys[0] <= greys[1] <= greys[2] <= 255 and greys[0] < greys[2]):
            raise ConfigurationError(
                f"rendering: expected 0 <= black <= background <= white <= 255, got {greys}"
            )
        if rendering.blur_px < 0 or rendering.noise_grey < 0 or rendering.supersampling < 1:
            raise ConfigurationError(
                "rendering: expected blur and noise not negative and at least one sample a pixel, "
                f"got {rendering}"
            )
        self.camera = camera
        self.target = target
        self.rendering = rendering
        self.region: Region | None = None
        self._contrast = (rendering.white_grey - rendering.black_grey) / 255.0
        surround = (rendering.background_grey - rendering.black_grey) / self._contrast
        self._encoded: NDArray[np.uint8] | None = None
        if camera.response not in (None, LINEAR):
            surround, self._encoded = _encoding(rendering, light_table(camera.response))
        self._surround = round(surround)
        self._background = round(rendering.background_grey)
        self.frame: NDArray[np.uint8] = np.full(
            (camera.height, camera.width), self._background, np.uint8
        )
        self._outline_T = np.pad(outline_m(target), ((0, 0), (0, 1)), constant_values=1.0)
        if camera.distorts:  # points along the edges, which the lens bends
            steps = np.arange(_EDGE_PARTS)[:, None, None] / _EDGE_PARTS
            along = np.roll(self._outline_T, -1, axis=0) - self._outline_T
            self._outline_T = (self._outline_T + steps * along).reshape(-1, 3)

    def draw(
        self,
        T_C_T: ArrayLike,
        rng: np.random.Generator | None = None,
        smear_px: ArrayLike = (0.0, 0.0),
    ) -> None:
        """Redraw the frame with the target at a pose.

        A target behind the camera, outside the field of view, seen from its back or edge-on
        leaves plain background.

        Args:
            T_C_T: pose of the target in the camera frame at mid-exposure, metres, shape (4, 4).
            rng: generator of the noise; None for an image without noise.
            smear_px: displacement (u, v) of the target's image during the exposure, shape (2,).
        """
        if self.region is not None:
            x0, y0, x1, y1 = self.region
            self.frame[y0:y1, x0:x1] = self._background
            self.region = None
        pose = np.asarray(T_C_T, float)
        board = pose[:3, [0, 1, 3]]
        bounds = self._bounds_px(board, pose)
        if bounds is None:
            return
        least, greatest = self._sample_spacing(pose)
        oversampling = 1
        if greatest > _STEEP_RATIO * least:
            wanted = math.ceil(_OVERSAMPLING_MARGIN * greatest / least)
            oversampling = min(wanted, _MOST_OVERSAMPLING)
        scale = oversampling * self.rendering.supersampling
        texels, texture_blur, blur = self._choose_level(
            oversampling * least, oversampling * greatest, scale
        )
        smear = scale * np.asarray(smear_px, float)
        smear_length = math.hypot(smear[0], smear[1])
        half_kernel, sigma = gaussian_radius_and_sigma(blur)
        # of the blur around the board within the frame
        reach = math.ceil((half_kernel + 0.5 * smear_length) / scale) + 2
        reach = min(reach, _TABLE_MARGIN_PX)
        width, height = self.camera.width, self.camera.height
        u0, v0, u1, v1 = bounds
        left, right = max(math.floor(u0), 0) - reach, min(math.ceil(u1), width) + reach + 1
        top, bottom = max(math.floor(v0), 0) - reach, min(math.ceil(v1), height) + reach + 1
        x0, y0, x1, y1 = max(left, 0), max(top, 0), min(right, width), min(bottom, height)
        if x0 >= x1 or y0 >= y1:
            return
        padded = (left, top, right, bottom)
        samples: NDArray[Any] = self._sample(board, padded, texels, texture_blur, oversampling)
        if half_kernel > 0:
            size = 2 * half_kernel + 1
            samples = cv2.GaussianBlur(samples, (size, size), sigma)
        if smear_length > 0.1:
            samples = cv2.filter2D(samples, -1, motion_blur_kernel(smear))
        if scale > 1:
            size_px = (right - left, bottom - top)
            samples = cv2.resize(samples, size_px, interpolation=cv2.INTER_AREA)
        inner = samples[y0 - top : y1 - top, x0 - left : x1 - left]
        self._expose(inner, (x0, y0, x1, y1), rng)

    def _bounds_px(
        self, board: NDArray[np.float64], pose: NDArray[np.float64]
    ) -> tuple[float, float, float, float] | None:
        """Smallest u and v of the board and the largest; None if its front is not visible."""
        points = self._outline_T @ board.T
        if min(points[:, 2].tolist()) < _LEAST_DEPTH_M:
            return None
        (_, _, a, x), (_, _, b, y), (_, _, c, z), _ = pose.tolist()
        if a * x + b * y + c * z < _LEAST_INCIDENCE_COSINE * math.sqrt(x * x + y * y + z * z):
            return None
        u, v = self.camera.project(points).T.tolist()
        if math.isnan(sum(u) + sum(v)):  # beyond the lens model: may be anywhere in the frame
            return 0.0, 0.0, self.camera.width, self.camera.height
        return min(u), min(v), max(u), max(v)

    def _sample_spacing(self, pose: NDArray[np.float64]) -> tuple[float, float]:
        """Samples per metre on the board at T's origin, smallest and largest by direction."""
        (ax, ay, _, x), (bx, by, _, y), (cx, cy, _, z), _ = pose.tolist()
        (f_u, f_v), scale = self.camera.focal.tolist(), self.rendering.supersampling
        # the derivative of the projection with respect to the board's x and y
        a, b = f_u * (ax - x / z * cx) / z, f_u * (ay - x / z * cy) / z
        c, d = f_v * (bx - y / z * cx) / z, f_v * (by - y / z * cy) / z
        if self.camera.bends_boards:
            (xx, xy), (_, yy) = self.camera.distortion_jacobian(x / z, y / z).tolist()
            k = f_u / f_v
            a, c = xx * a + xy * k * c, xy / k * a + yy * c
            b, d = xx * b + xy * k * d, xy / k * b + yy * d
        sum_, difference = math.hypot(a + d, b - c), math.hypot(a - d, b + c)
        return 0.5 * scale * abs(sum_ - difference), 0.5 * scale * (sum_ + difference)

    def _choose_level(self, least: float, greatest: float, scale: int) -> tuple[int, float, float]:
        """Texels per cell, their blur, and the remaining blur in samples, by samples per metre."""
        wanted = (scale * self.rendering.blur_px) ** 2 + scale**2 / 12 - (scale**2 - 1) / 12
        least, greatest = least * self.target.cell_m, greatest * self.target.cell_m
        mean = 0.5 * (least + greatest)
        texels = _texels(least, _LEAST_TEXEL_SAMPLES)
        blur = _TEXTURE_BLUR
        done = (mean / texels) ** 2 * (1 / 12 + blur**2)
        if done > wanted:
            texels = _texels(least, _LEAST_FINE_TEXEL_SAMPLES)
            exact = math.sqrt(max(wanted * (texels / mean) ** 2 - 1 / 12, 0.0))
            # rounded, so that a gaze needs few textures
            blur = min(max(math.floor(10 * exact) / 10, _FINE_BLURS[0]), _FINE_BLURS[1])
            done = (mean / texels) ** 2 * (1 / 12 + blur**2)
        return texels, blur, math.sqrt(max(wanted - done, 0.0))

    def _sample(
        self, board: NDArray[np.float64], region: Region, texels: int, blur: float,
        oversampling: int,
    ) -> NDArray[np.uint8]:  # fmt: skip
        """Grey of the board at each sample of a region, 0 black to 255 white."""
        scale = self.rendering.supersampling
        x0, y0, x1, y1 = region
        image, texture_from_board = _level(self.target, texels, blur, self._surround)
        texture_from_ray = texture_from_board @ cv2.invert(board)[1]
        if self.camera.distorts:
            margin = _TABLE_MARGIN_PX
            rays = ray_table(self.camera, scale, margin)[
                (y0 + margin) * scale : (y1 + margin) * scale,
                (x0 + margin) * scale : (x1 + margin) * scale,
            ]
            if oversampling > 1:  # rays are linear within a sample
                finest: Any = cv2.resize(rays, None, fx=oversampling, fy=oversampling)  # bilinear
                rays = finest
            where = cv2.perspectiveTransform(rays, texture_from_ray)
            remap: Any = cv2.remap
            return np.asarray(
                remap(image, where, None, cv2.INTER_LINEAR, borderValue=self._surround), np.uint8
            )
        scale *= oversampling
        half = 0.5 / scale - 0.5
        pixel_from_sample = np.array(
            [[1 / scale, 0, x0 + half], [0, 1 / scale, y0 + half], [0, 0, 1]]
        )
        transform = texture_from_ray @ self.camera.inverse_matrix @ pixel_from_sample
        size, flags = (
            ((x1 - x0) * scale, (y1 - y0) * scale),
            cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        )
        drawn = cv2.warpPerspective(image, transform, size, flags=flags, borderValue=self._surround)
        return np.asarray(drawn, np.uint8)

    def _expose(
        self, board: NDArray[np.uint8], drawn: Region, rng: np.random.Generator | None
    ) -> None:
        """Write the board's region into the frame with contrast, noise and rounding."""
        rendering = self.rendering
        if self._encoded is not None:
            board = np.asarray(cv2.LUT(board, self._encoded), np.uint8)
        x0, y0, x1, y1 = drawn
        if rng is None or rendering.noise_grey == 0:
            frame = self.frame[y0:y1, x0:x1]
            cv2.convertScaleAbs(board, frame, self._contrast, rendering.black_grey)
            self.region = drawn
            return
        height, width = self.frame.shape
        rx0, ry0 = max(x0 - _NOISE_MARGIN_PX, 0), max(y0 - _NOISE_MARGIN_PX, 0)
        rx1, ry1 = min(x1 + _NOISE_MARGIN_PX, width), min(y1 + _NOISE_MARGIN_PX, height)
        side = max(width, height)
        bank = noise_bank(max(2048, 1 << (side + side // 2 - 1).bit_length()))
        columns = len(bank) - (rx1 - rx0)
        y, x = divmod(int(rng.integers((len(bank) - (ry1 - ry0)) * columns)), columns)
        noise = bank[y : y + ry1 - ry0, x : x + rx1 - rx0]
        gain = rendering.noise_grey / NOISE_UNIT
        self.region = (rx0, ry0, rx1, ry1)
        # around the board: plain background and noise
        around = rendering.background_grey - NOISE_MEAN * gain
        cv2.convertScaleAbs(noise, self.frame[ry0:ry1, rx0:rx1], gain, around)
        noise = noise[y0 - ry0 : y1 - ry0, x0 - rx0 : x1 - rx0]
        black = rendering.black_grey - NOISE_MEAN * gain
        frame = self.frame[y0:y1, x0:x1]
        cv2.addWeighted(board, self._contrast, noise, gain, black, frame)


def _encoding(rendering: Rendering, light: NDArray[np.float64]) -> tuple[float, NDArray[np.uint8]]:
    """Fraction of light of the background between black and white, and of grey by that of light.

    Fractions are 0 to 255. The light is that of each grey level, (256,), see `light_table`.
    """
    levels, contrast = np.arange(256.0), rendering.white_grey - rendering.black_grey
    greys = (rendering.black_grey, rendering.background_grey, rendering.white_grey)
    black, background, white = np.interp(greys, levels, light).tolist()
    seen = np.interp(black + levels / 255.0 * (white - black), light, levels)
    encoded = np.rint(255.0 * (seen - rendering.black_grey) / contrast).astype(np.uint8)
    surround = 255.0 * (background - black) / (white - black)
    # exact for the background, so that the drawn region has no visible border
    encoded[round(surround)] = round(255.0 * (rendering.background_grey - greys[0]) / contrast)
    return surround, encoded


def _texels(samples: float, least: float) -> int:
    """Most texels for a cell of `samples` samples with texels of at least `least` samples."""
    return _TEXELS_PER_CELL[max(bisect_right(_TEXELS_PER_CELL, samples / least) - 1, 0)]


@lru_cache(maxsize=256)
def _level(
    target: PlanarTarget, texels: int, blur: float, surround: int
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Blurred texture, and the transform from the board's plane in T to its pixels."""
    image = texture(target, texels, surround=surround, rim_px=_TEXTURE_RIM, blur_px=blur)
    scale = texels / target.cell_m
    x, y = target.origin_cells
    shift = _TEXTURE_RIM - 0.5
    to_texture = [[scale, 0, texels * x + shift], [0, scale, texels * y + shift], [0, 0, 1]]
    return image, np.array(to_texture)
