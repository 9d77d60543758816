"""Lines of text in pictures."""

import functools
from typing import Final, Literal

import numpy as np
from PIL import ImageFont

from vergence.envs.reading import Image
from vergence.models.parts import FloatArray

TEXT_COLOUR: Final = (40, 40, 40)
"""RGB of text, 0 to 255 (chosen: contrast)."""
TEXT_PX: Final = 14
"""Size of text, px (chosen: legible at 800 px width)."""


def write_text(
    image: Image,
    text: str,
    at: tuple[int, int],
    *,
    colour: tuple[int, int, int] = TEXT_COLOUR,
    size: int = TEXT_PX,
    align: Literal["left", "middle", "right"] = "left",
    plain: int | None = None,
) -> None:
    """Write a line of text into a picture; what lies outside the picture is cut off.

    Args:
        image: (height, width, 3) RGB, changed in place.
        text: the line.
        at: left end, middle or right end of the text's base line, px.
        colour: RGB of the text, 0 to 255.
        size: px.
        align: part of the text that is at `at`.
        plain: grey level of a rectangle behind the text, 0 to 255; None for none.
    """
    ink, rise = _ink(text, size)
    height, width = ink.shape
    left = at[0] - {"left": 0, "middle": width // 2, "right": width}[align]
    top = at[1] - rise
    if plain is not None:
        image[max(top - 4, 0) : max(top + height + 3, 0), max(left - 5, 0) : left + width + 5] = (
            plain
        )
    cut_top, cut_left = max(-top, 0), max(-left, 0)
    under = image[top + cut_top : top + height, left + cut_left : left + width]
    ink = ink[cut_top:, cut_left:][: under.shape[0], : under.shape[1], None]
    under[:] = np.round(under + ink * (np.array(colour) - under))


@functools.lru_cache(maxsize=256)
def _ink(text: str, size: int) -> tuple[FloatArray, int]:
    """Opacity of a text's pixels, 0 to 1, and the height of its top above the base line, px."""
    font = _font(size)
    rise, drop = font.getmetrics()
    width = round(font.getlength(text)) + 1
    mask, (x, y) = font.getmask2(text, mode="L", anchor="ls")
    ink = np.zeros((rise + drop, width))
    drawn = np.array(mask, dtype=float).reshape(mask.size[::-1]) / 255.0
    top, left = max(rise + y, 0), max(x, 0)
    part = drawn[: len(ink) - top, : width - left]
    ink[top : top + part.shape[0], left : left + part.shape[1]] = part
    return ink, rise


@functools.cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size)
    assert isinstance(font, ImageFont.FreeTypeFont)  # Pillow's wheels have FreeType
    return font
