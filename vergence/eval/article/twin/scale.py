"""Scale of the true heads' errors that gives the article's largest depth error."""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from vergence.errors import ConfigurationError
from vergence.eval.article.reported import static_points
from vergence.eval.article.twin.fixation_errors import settled_fix_errors_m
from vergence.eval.article.twin.heads import TwinConfig, draw_heads
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_GREATEST_SCALE: Final = 64.0
"""Upper end of the bracket beyond which the search gives up (numerical)."""
_SCALES: Final = 81
"""Grid points of the final search around the bisection's result (numerical)."""


def largest_depth_error_percent(errors: FloatArray, points: FloatArray) -> FloatArray:
    """(heads,) largest |dz| / z over the points, percent, from (heads, points, 3) errors."""
    return np.asarray(100.0 * np.nanmax(np.abs(errors[..., 2]) / points[:, 2], axis=-1))


def find_error_scale(
    nominal: HeadModel, config: TwinConfig, seed: int, noise_px: ArrayLike | None = None
) -> float:
    """Find the error scale at which the median head's largest depth error is the article's.

    Args:
        nominal: the nominal head.
        config: the standard deviations and the article's figure.
        seed: the run's seed.
        noise_px: (21,) standard deviation of the detections at Table 5's points, px; None for
            the preset's.

    Returns:
        The scale, or the config's if it is not 0.

    Raises:
        ConfigurationError: the encoders alone give a larger error, or no scale reaches the error.
    """
    if config.scale > 0.0:
        return config.scale
    points = static_points("physical")

    def median(scale: float) -> float:
        heads = draw_heads(nominal, config.errors.scaled(scale), config.heads, seed)
        errors = settled_fix_errors_m(nominal, heads, points, noise_px=noise_px)
        return float(np.median(largest_depth_error_percent(errors, points)))

    low, high = 0.0, 1.0
    if median(low) >= config.largest_error_percent:
        raise ConfigurationError(
            f"largest_error_percent: expected more than the encoders alone give, "
            f"got {config.largest_error_percent}"
        )
    while median(high) < config.largest_error_percent:
        low, high = high, 2.0 * high
        if high > _GREATEST_SCALE:
            raise ConfigurationError(
                f"largest_error_percent: expected what the spreads can give, "
                f"got {config.largest_error_percent}"
            )
    while high - low > 0.01 * high:
        middle = 0.5 * (low + high)
        if median(middle) < config.largest_error_percent:
            low = middle
        else:
            high = middle
    # encoder quantisation makes the median jump: take the best scale of a fine grid
    scales = np.linspace(0.8 * low, 1.2 * high, _SCALES)
    misses = [abs(median(float(scale)) - config.largest_error_percent) for scale in scales]
    return float(scales[int(np.argmin(misses))])
