"""Render one eye's image of a textured room with a thing in it, in colour and without OpenGL.

The room is a box, fixed in frame 0, around the head. A ray of every pixel, through pinhole and
lens, is followed to the wall that it hits; the colour there is sampled from the walls' texture,
which is blurred in advance as its distance requires (see `vergence.vision.objects.walls`). The
thing is painted on a layer of its own, with coverage, and laid over the room. Both have the lens's
blur and the blur of their own motion. Layers hold light; the camera's response and white noise
come last, as in `vergence.vision.drawing`.
"""

import math
from functools import lru_cache
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.kernels import compiled
from vergence.models.camera import SRGB, Camera, default_response, light_table
from vergence.models.parts import FloatArray, Rendering
from vergence.vision.drawing import (
    NOISE_MEAN,
    NOISE_UNIT,
    gaussian_radius_and_sigma,
    motion_blur_kernel,
    noise_bank,
)
from vergence.vision.objects.scenes import BORDER, Scene, hit, parse_scene, poster_size_m
from vergence.vision.objects.walls import (
    BLUR_PX,
    HIGH_M,
    LOW_M,
    Colours,
    atlas,
    fitted,
    painted,
    read_colours,
    to_light,
)
from vergence.vision.optics import ray_table

__all__ = ["RoomRenderer", "Scene", "hit", "parse_scene", "poster_size_m"]

_POSTER_TEXELS: Final = 1536
"""Texels along a poster's longer side in its finest texture (chosen: 640 x 480 views of a part
against memory)."""
_TEXEL_PX: Final = 0.55
"""Largest texel of a poster's texture, in px along its most foreshortened direction (chosen: exact
places against time)."""
_LEVELS_PER_OCTAVE: Final = 4
"""Textures of a poster for each factor of 2 in scale (chosen: memory against sharpness)."""
_POSTER_BLUR: Final = 0.9
"""Blur of a poster's texture, texels: with those of texels and their interpolation, `BLUR_PX` at
a texel's mean size (chosen: aliasing against sharpness)."""
_RIM: Final = 4
"""Transparent surround of a poster in its texture, texels (chosen: room for its blur)."""
_EDGE_PARTS: Final = 8
"""Parts of an edge of a poster whose ends bound it in an image with lens distortion (chosen)."""
_LEAST_DEPTH_M: Final = 0.02
"""Smallest depth at which a thing is drawn, m (chosen: near views against what is behind)."""
_LEAST_INCIDENCE_COSINE: Final = 0.05
"""Least cosine between line of sight and a poster's normal at which it is drawn (chosen)."""
_AMBIENT: Final = 0.45
"""Share of a ball's light that comes from everywhere (chosen: looks)."""
_TO_LAMP: Final = np.array([-0.45, -0.75, -0.48])
"""Unit vector to the lamp in frame 0: behind the head, above and left of it (chosen: looks)."""
_OUTLINE_POINTS: Final = 32
"""Points of a ball's outline that bound it in the image (chosen: to 0.5 % of its radius)."""
_MARGIN_PX: Final = 32
"""Margin of the ray table around the frame, and so the largest reach of a blur beyond it, px
(chosen: strong blur against memory)."""
_PART_BITS: Final = 5
"""Bits of the parts of a texel that OpenCV's remap tells apart (numerical: its INTER_BITS)."""
_LEAST_SMEAR_PX: Final = 0.1
"""Motion during the exposure below which an image is sharp, px (chosen: time)."""
_LEAST_NOISE_SIDE: Final = 4096
"""Least side of the table of noise (chosen: a million places for a frame of 640 x 480)."""


@compiled
def _find_on_walls(
    rays: NDArray[np.float32], R: NDArray[np.float32], room: NDArray[np.float32],
    texels_per_m: np.float32, first_rows: NDArray[np.float32], margin: int,
    where: NDArray[np.int16], parts: NDArray[np.uint16],
) -> None:  # fmt: skip
    """Find the pixels of the atlas, (rows, columns, 2), that rays hit, in OpenCV's fixed point.

    `R` (3, 3) turns rays into frame 0. The walls, `room` (2, 3), are relative to the camera. The
    first ray is that of a sample by a margin off the table's corner.
    """
    mask = (1 << _PART_BITS) - 1
    fine = np.float32(1 << _PART_BITS)
    scale, start = fine * texels_per_m, np.float32(0.5) - np.float32(0.5) * fine
    left, right, top, bottom = room[0, 0], room[1, 0], room[0, 1], room[1, 1]
    back, front = room[0, 2], room[1, 2]
    for i in range(where.shape[0]):
        line = rays[i + margin, margin:]
        for j in range(where.shape[1]):
            x, y = line[j, 0], line[j, 1]
            dx = R[0, 0] * x + R[0, 1] * y + R[0, 2]
            dy = R[1, 0] * x + R[1, 1] * y + R[1, 2]
            dz = R[2, 0] * x + R[2, 1] * y + R[2, 2]
            tx = (right if dx > 0 else left) / dx
            ty = (bottom if dy > 0 else top) / dy
            tz = (front if dz > 0 else back) / dz
            if tz <= tx and tz <= ty:
                wall = 5 if dz > 0 else 4
                a, b = tz * dx - left, tz * dy - top
            elif tx <= ty:
                wall = 1 if dx > 0 else 0
                a, b = tx * dz - back, tx * dy - top
            else:
                wall = 3 if dy > 0 else 2
                a, b = ty * dx - left, ty * dz - back
            column = int(scale * a + start)
            row = int(scale * b + (fine * first_rows[wall] + start))
            where[i, j, 0], where[i, j, 1] = column >> _PART_BITS, row >> _PART_BITS
            parts[i, j] = (row & mask) << _PART_BITS | column & mask


class RoomRenderer:
    """Renders one eye's frames of a room with a thing in it.

    Attributes:
        camera: the eye's intrinsics, and the response that maps light to levels; sRGB, as that of
            colours, if it has none.
        scene: what is in the room.
        rendering: the rig's grey levels: black and white surfaces, blur and noise.
        frame: the image, uint8 BGR, shape (height, width, 3), redrawn in place by `draw`.

    Raises:
        ConfigurationError: grey levels outside 0 to 255 or not in order, a negative blur or noise,
            or a file of the scene that is no image.
    """

    def __init__(self, camera: Camera, scene: Scene, rendering: Rendering) -> None:
        """Start with a black frame."""
        greys = (rendering.black_grey, rendering.white_grey)
        if not 0 <= greys[0] < greys[1] <= 255:
            raise ConfigurationError(f"rendering: expected 0 <= black < white <= 255, got {greys}")
        if rendering.blur_px < 0 or rendering.noise_grey < 0:
            raise ConfigurationError(
                f"rendering: expected blur and noise not negative, got {rendering}"
            )
        self.camera = camera
        self.scene = scene
        self.rendering = rendering
        self.frame: Colours = np.zeros((camera.height, camera.width, 3), np.uint8)
        levels = np.arange(256.0)
        light = light_table(camera.response or default_response(colour=True))
        black, white = np.interp(greys, levels, light).tolist()
        encoded = np.interp(levels / 255.0 * white, light, levels)
        self._encoded = np.rint(encoded).astype(np.uint8)
        self._black = black / white
        self._room = atlas(scene.wall, float(camera.focal.max()), self._black)
        self._rays = ray_table(camera, 1, _MARGIN_PX)
        blur = math.sqrt(max(rendering.blur_px**2 + 1.0 / 12.0 - BLUR_PX**2, 0.0))
        self._radius, self._sigma = gaussian_radius_and_sigma(blur)
        self._ball_radius, self._ball_sigma = gaussian_radius_and_sigma(rendering.blur_px)
        count = self._rays.shape[0] * self._rays.shape[1]
        self._buffers: tuple[NDArray[Any], ...] = (
            np.empty((count, 2), np.int16), np.empty(count, np.uint16),
            np.empty((count, 3), np.uint8), np.empty((count, 3), np.uint8),
        )  # fmt: skip

    def draw(
        self,
        T_0_C: ArrayLike,
        thing: ArrayLike,
        rng: np.random.Generator | None = None,
        room_smear_px: ArrayLike = (0.0, 0.0),
        smear_px: ArrayLike = (0.0, 0.0),
    ) -> None:
        """Redraw the frame from a pose.

        A thing that reaches behind the camera, or a poster seen from its back or edge-on, is left
        out.

        Args:
            T_0_C: pose of the camera in frame 0 at mid-exposure, m, shape (4, 4); inside the room.
            thing: pose of the thing in frame 0, m, shape (4, 4): of the ball's centre, or of the
                poster's, which lies in the xy plane with z away from the viewer. With nan: none.
            rng: generator of the noise; None for an image without noise.
            room_smear_px: displacement (u, v) of the room's image during the exposure, shape (2,).
            smear_px: displacement of the thing's image.
        """
        camera = np.asarray(T_0_C, float)
        T_0_T = np.asarray(thing, float)
        light = self._draw_walls(camera, np.asarray(room_smear_px, float))
        if np.isfinite(T_0_T).all() and self.scene.thing != "nothing":
            R = camera[:3, :3]
            T_C_T = np.column_stack([R.T @ T_0_T[:3, :3], R.T @ (T_0_T[:3, 3] - camera[:3, 3])])
            smear = np.asarray(smear_px, float)
            if self.scene.thing == "ball":
                self._draw_ball(light, T_C_T[:, 3], R.T @ _TO_LAMP, smear)
            else:
                self._draw_poster(light, T_C_T, smear)
        self._expose(light, rng)

    def _draw_walls(self, T_0_C: FloatArray, smear: FloatArray) -> Colours:
        """Light of the room, (height, width, 3)."""
        smears = math.hypot(*smear.tolist()) > _LEAST_SMEAR_PX
        reach = self._radius + (math.ceil(0.5 * np.abs(smear).max()) + 1 if smears else 0)
        reach = min(reach, _MARGIN_PX)
        height, width = self.camera.height, self.camera.width
        rows, columns = height + 2 * reach, width + 2 * reach
        where, parts, image, other = (
            each[: rows * columns].reshape(rows, columns, *each.shape[1:]) for each in self._buffers
        )
        room = (np.stack([LOW_M, HIGH_M]) - T_0_C[:3, 3]).astype(np.float32)
        R = T_0_C[:3, :3].astype(np.float32, order="C")
        _, density, first_rows = self._room
        start = _MARGIN_PX - reach
        _find_on_walls(self._rays, R, room, np.float32(density), first_rows, start, where, parts)
        remap: Any = cv2.remap
        remap(self._room.image, where, parts, cv2.INTER_LINEAR, image, cv2.BORDER_REPLICATE)
        if self._radius:
            side = 2 * self._radius + 1
            cv2.GaussianBlur(image, (side, side), self._sigma, other)
            image, other = other, image
        if smears:
            cv2.filter2D(image, -1, motion_blur_kernel(smear), other)
            image = other
        return image[reach : reach + height, reach : reach + width]

    def _region(
        self, outline_C: FloatArray, radius: int, smear: FloatArray
    ) -> tuple[int, int, int, int] | None:
        """Region x0, y0, x1, y1 of pixels around points in front of the camera, with blur.

        One pixel of it lies beyond the frame's margin, and shows nothing.
        """
        size, pixels = np.array(self.camera.size), self.camera.project(outline_C)
        if np.isnan(pixels).any():  # beyond the lens model: may be anywhere in the frame
            pixels = np.array([[0.0, 0.0], size - 1.0])
        reach = min(radius + math.ceil(0.5 * np.abs(smear).max()) + 2, _MARGIN_PX)
        low = np.maximum(np.floor(pixels.min(axis=0)) - reach, -reach)
        high = np.minimum(np.ceil(pixels.max(axis=0)) + reach + 1, size + reach)
        x0, y0, x1, y1 = np.concatenate([low, high]).astype(int).tolist()
        return (x0, y0, x1, y1) if x0 + 1 < x1 and y0 + 1 < y1 else None

    def _rays_of(self, region: tuple[int, int, int, int]) -> NDArray[np.float32]:
        x0, y0, x1, y1 = (side + _MARGIN_PX for side in region)
        return self._rays[y0:y1, x0:x1]

    def _draw_poster(self, light: Colours, T_C_T: FloatArray, smear: FloatArray) -> None:
        """Lay the poster over the light."""
        width, height = poster_size_m(self.scene)
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (0.5 * width, 0.5 * height)
        steps = np.arange(_EDGE_PARTS)[:, None, None] / _EDGE_PARTS
        outline = (corners + steps * (np.roll(corners, -1, axis=0) - corners)).reshape(-1, 2)
        plane = T_C_T[:, [0, 1, 3]]
        outline_C = np.insert(outline, 2, 1.0, axis=1) @ plane.T
        centre = T_C_T[:, 3]
        cosine = float(T_C_T[:, 2] @ centre / np.linalg.norm(centre))
        if outline_C[:, 2].min() < _LEAST_DEPTH_M or cosine < _LEAST_INCIDENCE_COSINE:
            return
        region = self._region(outline_C, self._radius, smear)
        if region is None:
            return
        scale = float(self.camera.focal.min()) * cosine / float(np.linalg.norm(centre))
        step = 1e-3 * width
        offsets = step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
        right, left, below, above = self.camera.project(centre + offsets @ T_C_T[:, :2].T)
        jacobian = np.column_stack([right - left, below - above]) / (2.0 * step)
        if np.isfinite(jacobian).all():
            scale = float(np.linalg.svd(jacobian, compute_uv=False)[1])
        finest = math.log2(_POSTER_TEXELS * _TEXEL_PX / max(scale * max(width, height), 1.0))
        level = max(math.floor(_LEVELS_PER_OCTAVE * finest), 0)
        image, texture_from_board = _poster(self.scene, level, self._black)
        where = cv2.perspectiveTransform(
            self._rays_of(region), texture_from_board @ np.linalg.inv(plane)
        )
        remap: Any = cv2.remap
        layer = np.asarray(remap(image, where, None, cv2.INTER_LINEAR), np.uint8)
        self._lay(layer, light, region, (self._radius, self._sigma), smear)

    def _draw_ball(
        self, light: Colours, centre: FloatArray, to_lamp: FloatArray, smear: FloatArray
    ) -> None:
        """Lay the ball over the light; its outline is that of the exact cone of rays."""
        radius = 0.5 * self.scene.size_m
        squared = float(centre @ centre)
        if centre[2] < radius + _LEAST_DEPTH_M:
            return
        sine_squared = radius**2 / squared
        across = np.linalg.svd(centre[None])[2][1:]  # two unit vectors across the line of sight
        turn = np.linspace(0.0, 2.0 * math.pi, _OUTLINE_POINTS, endpoint=False)
        circle = np.column_stack([np.cos(turn), np.sin(turn)]) @ across
        outline = (1.0 - sine_squared) * centre + radius * math.sqrt(1.0 - sine_squared) * circle
        region = self._region(outline, self._ball_radius, smear)
        if region is None:
            return
        rays = self._rays_of(region)
        x, y = rays[..., 0], rays[..., 1]
        norm = np.sqrt(x * x + y * y + 1.0)
        a, b, c = (np.float32(value) for value in centre.tolist())
        along = (a * x + b * y + c) / norm  # of the centre, m
        inside = along - np.float32(math.sqrt(squared - radius**2))  # 0 at the outline
        down, right = np.gradient(inside)
        cover = (inside / (np.hypot(down, right) + 1e-12) + 0.5).clip(0.0, 1.0)
        depth = along - np.sqrt(np.maximum(along * along - (squared - radius**2), 0.0))
        p, q, r = (np.float32(value) for value in (to_lamp / radius).tolist())
        cosine = depth / norm * (p * x + q * y + r) - (p * a + q * b + r * c)
        shade = _AMBIENT + (1.0 - _AMBIENT) * np.maximum(cosine, 0.0)
        colour = np.append(light_table(SRGB)[list(self.scene.colour[::-1])], 255.0)
        levels = np.dstack([shade * cover] * 3 + [cover]) * colour.astype(np.float32)
        layer = np.rint(np.nan_to_num(levels)).clip(0, 255).astype(np.uint8)
        self._lay(layer, light, region, (self._ball_radius, self._ball_sigma), smear)

    def _lay(
        self, layer: NDArray[np.uint8], light: Colours, region: tuple[int, int, int, int],
        blur: tuple[int, float], smear: FloatArray,
    ) -> None:  # fmt: skip
        """Lay a layer of light and coverage, (rows, columns, 4), over the room's light."""
        radius, sigma = blur
        if radius:
            layer = np.asarray(cv2.GaussianBlur(layer, (2 * radius + 1, 2 * radius + 1), sigma))
        if math.hypot(*smear.tolist()) > _LEAST_SMEAR_PX:
            layer = np.asarray(cv2.filter2D(layer, -1, motion_blur_kernel(smear)))
        x0, y0, x1, y1 = region
        left, top = max(x0, 0), max(y0, 0)
        right, bottom = min(x1, self.camera.width), min(y1, self.camera.height)
        if left >= right or top >= bottom:
            return
        layer = layer[top - y0 : bottom - y0, left - x0 : right - x0]
        part = light[top:bottom, left:right]
        exposed = np.asarray(cv2.cvtColor(layer, cv2.COLOR_BGRA2BGR))
        open_ = cv2.cvtColor(cv2.bitwise_not(cv2.extractChannel(layer, 3)), cv2.COLOR_GRAY2BGR)
        cv2.multiply(part, open_, part, 1.0 / 255.0)
        cv2.add(part, exposed, part)

    def _expose(self, light: Colours, rng: np.random.Generator | None) -> None:
        """Write light into the frame by the camera's response, with noise and rounding."""
        if rng is None or self.rendering.noise_grey == 0:
            cv2.LUT(light, self._encoded, self.frame)
            return
        encoded = np.asarray(cv2.LUT(light, self._encoded))
        height, width, channels = self.frame.shape
        values = channels * width  # of a row; there are places for it along a quarter of a side
        bank = noise_bank(max(_LEAST_NOISE_SIDE, 1 << (values + values // 4).bit_length()))
        columns = len(bank) - values
        y, x = divmod(int(rng.integers((len(bank) - height) * columns)), columns)
        noise = bank[y : y + height, x : x + values]
        gain = self.rendering.noise_grey / NOISE_UNIT
        frame = self.frame.reshape(height, -1)
        cv2.addWeighted(encoded.reshape(height, -1), 1.0, noise, gain, -NOISE_MEAN * gain, frame)


@lru_cache(maxsize=2)
def print_poster(scene: Scene) -> Colours:
    """Colours of a scene's poster with its border, in its finest texture, sRGB levels."""
    size_m = np.array(poster_size_m(scene))
    density = _POSTER_TEXELS / size_m.max()
    border = round(BORDER * size_m[0] * density)
    columns, rows = (np.rint(size_m * density).astype(int) - 2 * border).tolist()
    if scene.picture:
        picture = fitted(read_colours(scene.picture), (columns, rows))
    else:
        picture = painted((columns, rows), np.random.default_rng(_POSTER_TEXELS))
    white, sides = (255, 255, 255), (border,) * 4
    return np.asarray(
        cv2.copyMakeBorder(picture, *sides, cv2.BORDER_CONSTANT, value=white), np.uint8
    )


@lru_cache(maxsize=64)
def _poster(scene: Scene, level: int, black: float) -> tuple[NDArray[np.uint8], FloatArray]:
    """Light and coverage of a poster at a level, and the transform from its plane to texels.

    Black is a share of white's light.
    """
    light = to_light(print_poster(scene))
    shrink = 2.0 ** (-level / _LEVELS_PER_OCTAVE)
    rows, columns = (max(round(shrink * count), 1) for count in light.shape[:2])
    image = cv2.cvtColor(fitted(light, (columns, rows)), cv2.COLOR_BGR2BGRA).astype(np.float32)
    image[..., :3] = 255.0 * black + (1.0 - black) * image[..., :3]
    image = np.pad(image, ((_RIM, _RIM), (_RIM, _RIM), (0, 0)))
    image = np.asarray(cv2.GaussianBlur(image, (0, 0), _POSTER_BLUR), np.float32)
    texels = np.rint(image).astype(np.uint8)
    texels.setflags(write=False)
    width, height = poster_size_m(scene)
    to_texels = [
        [columns / width, 0.0, 0.5 * columns - 0.5 + _RIM],
        [0.0, rows / height, 0.5 * rows - 0.5 + _RIM],
        [0.0, 0.0, 1.0],
    ]
    return texels, np.array(to_texels)
