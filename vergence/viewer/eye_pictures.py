"""Picture of one eye: its image with the detection and the principal point."""

from typing import Final

import cv2
import numpy as np

from vergence.envs.reading import Image
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.viewer.lettering import TEXT_COLOUR, write_text
from vergence.viewer.moment import Moment

EYE_WIDTH: Final = 480
"""Width of each eye's picture, px (chosen: detail against size)."""
EYE_COLOURS: Final = ((31, 119, 180), (214, 96, 30))
"""RGB of the left and the right eye (chosen: easy to tell apart)."""
TARGET_COLOUR: Final = (0, 150, 60)
"""RGB of the target and of its detections, 0 to 255 (chosen: contrast)."""
FIX_COLOUR: Final = (170, 40, 150)
"""RGB of the fix by gaze, 0 to 255 (chosen: unlike the eyes' colours)."""
BACKGROUND_GREY: Final = 245
"""Grey level of backgrounds, 0 to 255 (chosen: contrast)."""
_EARLIER_S: Final = 0.01
"""Time by which a detection's image is older than the picture from which it is stated, s
(chosen)."""
_OLD_S: Final = 0.5
"""Age above which an image's age is stated, s (chosen: beyond any latency)."""


def draw_eye(head: HeadModel, shown: Moment, eye: int, width: int = EYE_WIDTH) -> Image:
    """Draw an eye's image, with a cross at the principal point and one at the detection.

    An image that no camera has taken is labelled as drawn; without an image the crosses alone are
    drawn.

    Args:
        head: the model of the head.
        shown: the moment.
        eye: 0 for left, 1 for right.
        width: width of the picture, px; its height follows from the camera's.

    Returns:
        (height, width, 3) RGB.
    """
    origin = ", no image"
    image: Image = np.full(head.cameras.size[eye, ::-1], BACKGROUND_GREY, np.uint8)
    if shown.images is not None:
        image, origin = shown.images.of(eye), ", drawn" if shown.images.drawn else ""
        if shown.image_age_s > _OLD_S:
            origin += f", {shown.image_age_s:.1f} s old"
    scale = width / float(head.cameras.size[eye, 0])  # the image may have been made smaller
    size = (width, round(scale * float(head.cameras.size[eye, 1])))
    whole = max(1, image.shape[1] // width)  # averaging by whole numbers is several times faster
    smaller = (image.shape[1] // whole, image.shape[0] // whole)
    small = cv2.resize(cv2.resize(image, smaller, interpolation=cv2.INTER_AREA), size)
    colours = small if small.ndim == 3 else cv2.cvtColor(small, cv2.COLOR_GRAY2RGB)
    out = np.asarray(colours, dtype=np.uint8)
    draw_cross(out, scale * head.cameras.principal[eye], EYE_COLOURS[eye], 14)
    if shown.visible[eye]:
        earlier_s = shown.detection_age_s - shown.image_age_s
        if shown.images is not None and earlier_s > _EARLIER_S:
            text = f"detected {1e3 * earlier_s:.0f} ms before"
            write_label(out, text, (10, 48), TARGET_COLOUR)
        draw_cross(out, scale * shown.pixels[eye], TARGET_COLOUR, 9)
    error = float(shown.errors_px[eye])
    text = f"{EYE_NAMES[eye]} eye{origin}   error "
    write_label(out, text + (f"{error:.1f} px" if np.isfinite(error) else "-"), (10, 24))
    return out


def draw_cross(image: Image, at: FloatArray, colour: tuple[int, int, int], size: int) -> None:
    """Draw an upright cross into a picture.

    Args:
        image: (height, width, 3) RGB, changed in place.
        at: (2,) centre, px.
        colour: RGB, 0 to 255.
        size: length of its arms, px.
    """
    u, v = round(float(at[0])), round(float(at[1]))
    cv2.line(image, (u - size, v), (u + size, v), colour, 2, cv2.LINE_AA)
    cv2.line(image, (u, v - size), (u, v + size), colour, 2, cv2.LINE_AA)


def write_label(
    image: Image, text: str, at: tuple[int, int], colour: tuple[int, int, int] = TEXT_COLOUR
) -> None:
    """Write a line of text on a plain rectangle into a picture.

    Args:
        image: (height, width, 3) RGB, changed in place.
        text: the line.
        at: left end of the text's base line, px.
        colour: RGB of the text, 0 to 255.
    """
    write_text(image, text, at, colour=colour, plain=BACKGROUND_GREY)
