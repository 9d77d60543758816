"""How a rig's cameras turn light into grey levels."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """The grey-level model of one rig's images.

    An image is the supersampled target, blurred by the lens, brought to the rig's
    contrast, with white grey-level noise added, rounded to 8 bits.
    """

    blur_px: float
    """Standard deviation of the lens's Gaussian blur, in pixels."""
    noise_grey: float
    """Standard deviation of the white noise of one pixel, in grey levels of 255."""
    supersampling: int
    """Samples per pixel along each axis before blur."""
    black_grey: float
    """Grey level of the target's black, 0 to 255."""
    white_grey: float
    """Grey level of the target's white, 0 to 255."""
    background_grey: float
    """Grey level of what surrounds the target, 0 to 255."""
