r"""How angles and velocities become channels: numbers in [-1, 1] in several resolutions.

A linear channel saturates; a logarithmic one,

    sign(x) ln(1 + |x| / x0) / ln(1 + x_max / x0)

resolves every size of a quantity by the same share.
"""

from math import log1p
from typing import Final

from vergence._jit import device

COARSE_RAD: Final = 1.5
MIDDLE_RAD: Final = 0.1
FINE_RAD: Final = 0.01
LOG_RAD: Final = 0.001
"""x0 of the logarithmic channel of angles."""
LOG_SPEED: Final = 0.005
"""x0 of the logarithmic channel of velocities, by the actuator's greatest command."""


@device
def clip(value: float) -> float:
    """A linear channel."""
    return min(max(value, -1.0), 1.0)


@device
def log_scaled(value: float, least: float, most: float) -> float:
    """A logarithmic channel.

    Args:
        value: the quantity.
        least: x0, in its unit.
        most: the size that is 1, in its unit.
    """
    size = min(log1p(abs(value) / least) / log1p(most / least), 1.0)
    return size if value >= 0.0 else -size
