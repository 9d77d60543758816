"""Walls of the room as textures: what is on them, and how fine they are seen from its middle.

A wall of n texels per metre has its edges half a texel outside of its outermost texels. All walls
lie below each other in one image, the atlas, so that one sampling reaches every wall.
"""

import colorsys
import math
from functools import lru_cache
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.models.camera import SRGB, light_table
from vergence.vision.image import read_pixels

Colours = NDArray[np.uint8]
"""Image in colours, BGR, shape (height, width, 3)."""
Box = tuple[float, float, float, float]
"""Rectangle on a wall: left, top, right, bottom, m."""

LOW_M: Final = np.array([-2.5, -1.6, -2.0])
"""Left, top and back of the room in frame 0, m (chosen: a small room, the head in its middle)."""
HIGH_M: Final = np.array([2.5, 1.3, 3.0])
"""Right, bottom and front of the room in frame 0, m (chosen: as above)."""
PLAIN_M: Final = (0.85, -1.15, 2.05, -0.3)
"""Part of the front wall without texture, in x and y of frame 0, m (chosen: upper right)."""
PERIODIC_M: Final = (-2.1, 0.2, -1.0, 1.0)
"""Part of the front wall that repeats itself, in x and y of frame 0, m (chosen: lower left)."""
TILE_M: Final = 0.1
"""Period of that part, m (chosen: bathroom tiles)."""

_SEED: Final = 7
"""Seed of everything on the walls (chosen: every room is the same)."""
_COARSEST_M: Final = 1.28
"""Cell of the coarsest noise, m (chosen: halved seven times down to 1 cm)."""
_OCTAVES: Final = 8
"""Scales of the noise, each half of the last (chosen: 1.28 m to 1 cm)."""
_TRIM_M: Final = 0.025
"""Width of the plain trim along the edges of walls, where two meet, m (chosen: hides the seam)."""
_TRIM: Final = (88, 100, 110)
_SHADE_DEPTH: Final = 0.45
"""Share of light that is missing in the corners of the room (chosen: looks)."""
_SHADE_M: Final = 0.35
"""Distance from an edge over which this shade fades, m (chosen: looks)."""
_TEXELS_PER_FOCAL: Final = 0.5
"""Texels per metre by focal length in px: 0.67 px each on the front wall (chosen: sharpness and
exact places against memory)."""
_PAINTED_PER_M: Final = 300.0
"""Texels per metre of what is on the walls, and at most of an atlas: so things are in the same
places for eyes of different focal lengths (chosen: detail of 1 cm against memory and time)."""
_LEAVES_PER_M2: Final = 260.0
"""Leaves of the wallpaper per square metre, and berries (chosen: edges of every direction within
7 cm)."""
_LEAF_M: Final = (0.05, 0.13)
"""Least and greatest length of a leaf, m (chosen: seen sharply from the middle of the room)."""
_LEAF_SHADES: Final = (0.45, 0.6, 0.75, 1.4)
"""Brightness of leaves by that of the wall (chosen: contrast against noise)."""
_BERRY_M: Final = (0.004, 0.009)
"""Least and greatest radius of a berry, m (chosen: as leaves)."""
_PANEL_M: Final = 0.6
"""Side of the ceiling's panels, m (chosen: as usual)."""
_BOARD_M: Final = 0.07
"""Width of a board of the floor, m (chosen: as usual in parquet)."""
_FIGURES: Final = 200
"""Figures of a painting, from large to small ones (chosen: some in each of its parts)."""
BLUR_PX: Final = 0.5
"""Standard deviation of the blur of all textures, in px along the direction in which they are
foreshortened most (chosen: aliasing against sharpness)."""
_BLUR_STEP: Final = 1.25
"""Ratio of successive blurs of a wall (chosen: too small to be seen)."""
_TINTS: Final = {  # BGR
    "left": (112, 140, 152), "right": (150, 148, 128), "top": (188, 194, 196),
    "bottom": (96, 106, 118), "back": (120, 150, 128), "front": (140, 158, 172),
}  # fmt: skip
"""Colours of the walls, sRGB levels, in the order of the atlas (chosen: looks)."""
_AXES: Final = {"left": (2, 1), "right": (2, 1), "top": (0, 2), "bottom": (0, 2),
                "back": (0, 1), "front": (0, 1)}  # fmt: skip
"""Axes of frame 0 along the columns and rows of each wall."""


class Atlas(NamedTuple):
    """All walls in one image of light."""

    image: Colours
    """Light, 255 for that of a white surface."""
    texels_per_m: float
    first_rows: NDArray[np.float32]
    """(6,) first row of each wall: left, right, top, bottom, back, front."""


def atlas(wall: str | None, focal_px: float, black: float = 0.0) -> Atlas:
    """All walls, blurred for a camera of about this focal length.

    Args:
        wall: image file on the front wall; None for a procedural texture.
        focal_px: focal length, px.
        black: light of a black surface as a share of that of a white one.
    """
    return _exposed(wall, 2.0 ** (round(4.0 * math.log2(focal_px)) / 4.0), black)


@lru_cache(maxsize=2)
def _exposed(wall: str | None, focal_px: float, black: float) -> Atlas:
    """All walls by light, with that of black surfaces."""
    image, density, first_rows = _atlas(wall, focal_px)
    exposed = np.asarray(cv2.convertScaleAbs(image, None, 1.0 - black, 255.0 * black), np.uint8)
    exposed.setflags(write=False)
    return Atlas(exposed, density, first_rows)


@lru_cache(maxsize=2)
def _atlas(wall: str | None, focal_px: float) -> Atlas:
    """All walls, with black surfaces without light."""
    # walls of whole texels
    density = 10.0 * max(round(min(_TEXELS_PER_FOCAL * focal_px, _PAINTED_PER_M) / 10.0), 1)
    walls = [
        _seen(name, _lit(name, wall if name == "front" else None), density, focal_px)
        for name in _TINTS
    ]
    first = np.cumsum([0, *(len(each) for each in walls)])
    image = np.concatenate(walls)  # all are as wide as each other
    return Atlas(image, density, first[:-1].astype(np.float32))


def mottled(
    size_m: tuple[float, float], density: float, tint: Any, rng: np.random.Generator,
    contrast: float = 8.0, grain: tuple[float, float] = (1.0, 1.0),
) -> Colours:  # fmt: skip
    """Surface with noise of every scale from 1 m to 1 cm, like plaster.

    Args:
        size_m: width and height, m.
        density: texels per metre.
        tint: mean colour, BGR, sRGB levels.
        rng: generator of the noise.
        contrast: standard deviation of each scale, sRGB levels.
        grain: factors on the sizes of all scales along columns and rows.
    """
    width, height = (
        max(math.ceil(size / (_COARSEST_M * k)), 1) + 1
        for size, k in zip(size_m, grain, strict=True)
    )
    field = np.zeros((height, width, 3), np.float32)
    for octave in range(_OCTAVES):
        if octave:
            field = np.asarray(cv2.resize(field, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC))
        # mostly of brightness; the rest of colour, which is coarse
        field += contrast * rng.standard_normal((*field.shape[:2], 1), np.float32)
        if octave < _OCTAVES - 3:
            field += 0.25 * contrast * rng.standard_normal(field.shape, np.float32)
    levels = (field + np.asarray(tint, np.float32)).clip(0, 255).astype(np.uint8)
    cell_texels = density * _COARSEST_M / 2 ** (_OCTAVES - 1)
    to_cells = np.array(
        [[1 / (cell_texels * grain[0]), 0, 1], [0, 1 / (cell_texels * grain[1]), 1]]
    )
    size = (round(size_m[0] * density), round(size_m[1] * density))
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(levels, to_cells, size, flags=flags, borderMode=cv2.BORDER_REPLICATE),
        np.uint8,
    )


def fitted(image: Colours, size: tuple[int, int]) -> Colours:
    """Image scaled to a size, (width, height); itself if it has that."""
    shrinks = size[0] < image.shape[1]
    flag = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, size, interpolation=flag), np.uint8)


@lru_cache(maxsize=8)
def read_colours(path: str) -> Colours:
    """Read an image file as 8-bit BGR, grey or not.

    Raises:
        UnreadableFileError: the file is missing, empty, or no image.
    """
    pixels = read_pixels(path)
    if pixels.dtype != np.uint8:
        pixels = np.rint(pixels * (255.0 / pixels.max(initial=1))).astype(np.uint8)
    colours = pixels if pixels.ndim == 3 else cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR)
    return np.ascontiguousarray(colours[..., :3])


def to_light(levels: Colours) -> Colours:
    """Light of sRGB levels, 0 to 255."""
    return np.asarray(cv2.LUT(levels, np.rint(light_table(SRGB)).astype(np.uint8)), np.uint8)


def front_wall(picture: str | None, density: float) -> Colours:
    """Colours of the front wall, sRGB levels, without the shade of the corners.

    Args:
        picture: as `wall` of `atlas`.
        density: texels per metre.
    """
    return _wall("front", picture, density)


def _corner(name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least coordinates of a wall along its columns and rows, and its size, m."""
    axes = list(_AXES[name])
    return LOW_M[axes], (HIGH_M - LOW_M)[axes]


def _wall(name: str, picture: str | None, density: float) -> Colours:
    """Colours of one wall, sRGB levels."""
    rng = np.random.default_rng([_SEED, list(_TINTS).index(name)])
    low, (width, height) = _corner(name)
    size, tint = (width, height), _TINTS[name]
    if name == "top":
        image = mottled(size, density, tint, rng, 4.0)
        _perforate(image, density, rng)
        return image
    if name == "bottom":
        image = mottled(size, density, tint, rng, 7.0, (0.25, 2.0))
        _lay_planks(image, density, rng)
        return image
    image = mottled(size, density, tint, rng)
    _paper(image, density, np.asarray(tint, float), rng)
    if name == "front" and picture is not None:
        _hang_photograph(image, read_colours(picture))
        return image
    if name == "front":
        _hang(image, (1.25, 0.25, 2.05, 0.85), density, rng)
        _hang(image, (3.0, 1.65, 3.6, 2.1), density, rng)
        _hang(image, (0.35, 0.4, 0.85, 1.1), density, rng)
        _fill_shelves(image, (3.8, 1.6, 4.8, 2.8), density, rng)
        _fill_shelves(image, (2.3, 0.45, 3.1, 1.05), density, rng)
        _fill(image, _shifted(PLAIN_M, low, 0.03), density, (96, 92, 90))
        _fill(image, _shifted(PLAIN_M, low), density, (214, 218, 220))
        _lay_tiles(image, _shifted(PERIODIC_M, low), density)
    elif name == "right":
        for left in (0.4, 1.5, 2.6, 3.7):
            top, wide, high = rng.uniform((0.3, 0.6, 0.5), (0.8, 0.9, 1.0))
            _hang(image, (left, top, left + wide, top + high), density, rng)
            _hang(image, (left, 2.0, left + 0.8 * wide, 2.5), density, rng)
    else:
        _fill_shelves(image, (0.3, 0.35, 0.55 * width, height - 0.1), density, rng)
        _hang(image, (0.62 * width, 0.4, 0.78 * width, 1.3), density, rng)
        _hang(image, (0.8 * width, 0.7, 0.95 * width, 1.2), density, rng)
        _fill_shelves(image, (0.6 * width, 1.7, 0.95 * width, height - 0.1), density, rng)
    return image


def _shifted(box: Box, low: NDArray[np.float64], grown: float = 0.0) -> Box:
    """Rectangle in frame 0 as one on the wall, grown to every side."""
    (left, top, right, bottom), (x, y) = box, low.tolist()
    return left - x - grown, top - y - grown, right - x + grown, bottom - y + grown


def _texels(box: Box, density: float) -> tuple[slice, slice]:
    """Rows and columns of a rectangle."""
    left, top, right, bottom = (max(round(side * density), 0) for side in box)
    return slice(top, bottom), slice(left, right)


def _fill(image: Colours, box: Box, density: float, colour: Any) -> None:
    image[_texels(box, density)] = colour


def _tint(image: Colours, box: Box, density: float, colour: NDArray[np.float64]) -> None:
    """Colour a rectangle; the noise that is there stays."""
    part = image[_texels(box, density)]
    if part.size:
        mean = part.reshape(-1, 3).mean(axis=0)
        part[:] = (0.6 * (part - mean) + colour).clip(0, 255)


def _random_colour(rng: np.random.Generator, value: tuple[float, float]) -> NDArray[np.float64]:
    """A muted colour of a brightness in a range, BGR, sRGB levels."""
    hue, saturation, level = rng.uniform((0.0, 0.15, value[0]), (1.0, 0.5, value[1])).tolist()
    return np.array(colorsys.hsv_to_rgb(hue, saturation, level)[::-1])


def _scattered(
    image: Colours, density: float, per_m2: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Random places on a wall, evenly dense, (n, 2), m."""
    height, width = (side / density for side in image.shape[:2])
    pitch = 1.0 / math.sqrt(per_m2)
    grid = np.mgrid[0 : math.ceil(width / pitch), 0 : math.ceil(height / pitch)]
    places = (grid.reshape(2, -1).T + rng.uniform(-0.3, 1.3, (grid[0].size, 2))) * pitch
    return np.asarray(rng.permutation(places))


def _paper(
    image: Colours, density: float, tint: NDArray[np.float64], rng: np.random.Generator
) -> None:
    """Cover a wall with wallpaper of leaves and berries, no two alike."""
    turn = np.linspace(0.0, math.pi, 7)
    side = np.column_stack([-np.cos(turn), 0.5 * np.sin(turn) ** 1.5])
    leaf = np.concatenate([side, side[-2:0:-1] * (1.0, -1.0)])
    for place in _scattered(image, density, _LEAVES_PER_M2, rng):
        length, angle = rng.uniform(*_LEAF_M), rng.uniform(0.0, 2.0 * math.pi)
        wide, shade = rng.uniform(0.5, 1.1), rng.choice(_LEAF_SHADES) * rng.uniform(0.85, 1.15)
        c, s = math.cos(angle), math.sin(angle)
        outline = 0.5 * length * (leaf * (1.0, wide)) @ np.array([[c, s], [-s, c]]) + place
        colour = (shade * tint + rng.uniform(-15, 15, 3)).clip(0, 255).tolist()
        points = np.rint(16.0 * density * outline).astype(np.int32)
        cv2.fillPoly(image, [points], colour, cv2.LINE_AA, 4)
        rib = (np.array(colour) * (0.6 if shade > 1.0 else 1.6)).clip(0, 255).tolist()
        cv2.line(image, points[0].tolist(), points[6].tolist(), rib, 1, cv2.LINE_AA, 4)
    _dot(image, density, _LEAVES_PER_M2, _BERRY_M, _random_colour(rng, (60, 110)), rng)


def _dot(
    image: Colours, density: float, per_m2: float, radii_m: tuple[float, float], colour: Any,
    rng: np.random.Generator,
) -> None:  # fmt: skip
    """Scatter dots of random sizes."""
    for place in _scattered(image, density, per_m2, rng):
        centre = np.rint(16.0 * density * place).astype(int).tolist()
        radius = round(16.0 * density * rng.uniform(*radii_m))
        paint = (np.asarray(colour) * rng.uniform(0.7, 1.3)).clip(0, 255).tolist()
        cv2.circle(image, centre, radius, paint, -1, cv2.LINE_AA, 4)


def _perforate(image: Colours, density: float, rng: np.random.Generator) -> None:
    """Acoustic panels of a ceiling: random holes and joints."""
    _dot(image, density, 900.0, (0.003, 0.011), (70, 74, 76), rng)
    height, width = (side / density for side in image.shape[:2])
    for at in np.arange(0.0, max(width, height), _PANEL_M):
        _fill(image, (at, 0.0, at + 0.008, height), density, (110, 116, 120))
        _fill(image, (0.0, at, width, at + 0.008), density, (110, 116, 120))


def _hang(image: Colours, box: Box, density: float, rng: np.random.Generator) -> None:
    """Hang a framed picture."""
    frame = rng.uniform(30, 90)
    left, top, right, bottom = box
    for inset, colour in ((0.0, 0.6 * frame), (0.012, frame), (0.035, 205.0)):
        inner = (left + inset, top + inset, right - inset, bottom - inset)
        _fill(image, inner, density, colour)
    inner = (left + 0.09, top + 0.09, right - 0.09, bottom - 0.09)
    rows, columns = _texels(inner, density)
    size = (columns.stop - columns.start, rows.stop - rows.start)
    image[rows, columns] = painted(size, rng)


def painted(size: tuple[int, int], rng: np.random.Generator) -> Colours:
    """Abstract painting of a size in texels, with detail down to a hundredth of its width."""
    side = max(size)
    extent = (size[0] / side, size[1] / side)
    image = mottled(extent, side, _random_colour(rng, (120, 220)), rng, 10.0)
    for least in 0.1 / np.sqrt(np.linspace(1.0, 150.0, _FIGURES)):  # each size covers as much
        x, y, radius = rng.uniform((0, 0, least), (*extent, 1.5 * least))
        axes = (round(radius * side), round(radius * side * rng.uniform(0.3, 1.0)))
        colour = _random_colour(rng, (40, 255)).tolist()
        centre, turn = (round(x * side), round(y * side)), rng.uniform(0, 180)
        cv2.ellipse(image, centre, axes, turn, 0, 360, colour, -1, cv2.LINE_AA)
    return image


def _fill_shelves(image: Colours, box: Box, density: float, rng: np.random.Generator) -> None:
    """Put up shelves and fill them with books."""
    left, top, right, bottom = box
    _fill(image, (left - 0.03, top - 0.03, right + 0.03, bottom + 0.03), density, (62, 84, 108))
    count = max(round((bottom - top) / 0.3), 1)
    pitch = (bottom - top) / count
    for row in range(count):
        shelf = top + (row + 1) * pitch - 0.02
        _fill(image, (left, shelf - pitch + 0.02, right, shelf), density, (26, 32, 38))
        x = left
        while x < right - 0.015:
            wide = min(rng.uniform(0.015, 0.05), right - x)
            upper = shelf - rng.uniform(0.65, 0.9) * pitch
            if rng.random() < 0.93:  # else a gap
                spine = _random_colour(rng, (40, 220))
                _fill(image, (x, upper, x + wide - 0.003, shelf), density, spine)
                for band in rng.uniform(upper + 0.01, shelf - 0.03, 4):
                    bright = (30, 90) if spine.max() > 130 else (170, 255)
                    paint = _random_colour(rng, bright)
                    inset, high = rng.uniform((0.0, 0.005), (0.4 * wide, 0.025))
                    right_m = x + wide - 0.003 - inset * rng.uniform(0.0, 1.0)
                    _fill(image, (x + inset, band, right_m, band + high), density, paint)
            x += wide


def _lay_planks(image: Colours, density: float, rng: np.random.Generator) -> None:
    """Parquet of short boards along the room, each of another tint, with knots."""
    depth, width = (side / density for side in image.shape[:2])
    base = np.asarray(_TINTS["bottom"], float)
    for left in np.arange(0.0, width, _BOARD_M):
        near = -rng.uniform(0.0, 0.3)
        while near < depth:
            far = near + rng.uniform(0.1, 0.35)
            tint = base * rng.uniform(0.5, 1.5) + rng.uniform(-8, 8, 3)
            _tint(image, (left, near, left + _BOARD_M, far), density, tint)
            _fill(image, (left, far - 0.004, left + _BOARD_M, far), density, (24, 34, 46))
            near = far
        _fill(image, (left, 0.0, left + 0.004, depth), density, (24, 34, 46))
    _dot(image, density, 150.0, (0.004, 0.012), (22, 34, 50), rng)


def _lay_tiles(image: Colours, box: Box, density: float) -> None:
    """Equal tiles, exact to a part of a texel: a joint's share of a texel mixes its colour."""
    rows, columns = _texels(box, density)
    shares = []
    for along in (rows, columns):
        texel = (np.arange(along.stop - along.start) + 0.5) / density
        off = np.abs((texel / TILE_M) % 1.0 - 0.5) * TILE_M
        shares.append(((off - 0.5 * TILE_M + 0.005) * density + 0.5).clip(0.0, 1.0))
    joint = np.maximum.outer(*shares)[..., None]
    tile, grout = np.array([176.0, 150.0, 118.0]), np.array([206.0, 212.0, 214.0])
    image[rows, columns] = np.rint(tile + joint * (grout - tile))


def _hang_photograph(image: Colours, photograph: Colours) -> None:
    """Cover a wall with a photograph of its width; what is higher is cut off equally."""
    height, width = image.shape[:2]
    high = max(round(photograph.shape[0] * width / photograph.shape[1]), 1)
    paper = fitted(photograph, (width, high))
    start, top = max((high - height) // 2, 0), max((height - high) // 2, 0)
    part = paper[start : start + height]
    image[top : top + len(part)] = part


@lru_cache(maxsize=len(_TINTS) + 1)
def _lit(name: str, picture: str | None) -> Colours:
    """Light of one wall in the shade of the room's corners, in the density of painting."""
    density = _PAINTED_PER_M
    colours = _wall(name, picture, density)
    height, width = colours.shape[:2]
    x, y = ((np.arange(count, dtype=np.float32) + 0.5) / density for count in (width, height))
    light = to_light(colours).astype(np.float32)
    edge_m = np.minimum.outer(np.minimum(y, y[::-1]), np.minimum(x, x[::-1]))
    light *= (1.0 - _SHADE_DEPTH * np.exp(-edge_m / np.float32(_SHADE_M)))[..., None]
    if name == "front" and picture is None:  # what is plain or repeats itself has no shade
        for box in (PLAIN_M, PERIODIC_M):
            part = _texels(_shifted(box, _corner(name)[0]), density)
            light[part] = to_light(colours[part])
    image = np.full_like(colours, to_light(np.array([[_TRIM]], np.uint8))[0, 0])
    trim = round(_TRIM_M * density)
    inside = slice(trim, -trim)
    image[inside, inside] = light[inside, inside].astype(np.uint8)
    return image


def _seen(name: str, light: Colours, density: float, focal_px: float) -> Colours:
    """Light of a wall in another density, blurred as much as pixels will be apart there.

    A pixel of the room's origin covers d^2 / (f D) on a wall at the distance D, d away, along the
    direction in which the wall is foreshortened.
    """
    low, extent = _corner(name)
    width, height = np.rint(density * extent).astype(int).tolist()
    image = fitted(light, (width, height))
    x, y = ((np.arange(count, dtype=np.float32) + 0.5) / density for count in (width, height))
    (third,) = {0, 1, 2} - set(_AXES[name])
    ahead = abs((HIGH_M if name in ("right", "bottom", "front") else LOW_M)[third])
    squared = np.add.outer((y + low[1]) ** 2, (x + low[0]) ** 2) + np.float32(ahead**2)
    wanted = BLUR_PX * density / (focal_px * ahead) * squared  # standard deviation, texels
    step = np.rint(np.log(wanted) / math.log(_BLUR_STEP)).astype(np.int8)
    out = np.empty_like(image)
    for each in np.unique(step).tolist():
        sigma = _BLUR_STEP**each
        ys, xs = (np.flatnonzero((step == each).any(axis=axis)) for axis in (1, 0))
        reach = math.ceil(3.0 * sigma)
        top, left = max(ys[0] - reach, 0), max(xs[0] - reach, 0)
        part = (slice(top, ys[-1] + 1 + reach), slice(left, xs[-1] + 1 + reach))
        border = cv2.BORDER_REPLICATE
        blurred = cv2.GaussianBlur(image[part], (0, 0), sigma, borderType=border)
        cv2.copyTo(blurred, (step[part] == each).astype(np.uint8), out[part])
    return out
