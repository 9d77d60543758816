r"""Scaling of angles and velocities to channels: numbers in [-1, 1] in several resolutions.

A linear channel saturates; a logarithmic one,

    sign(x) ln(1 + |x| / x0) / ln(1 + x_max / x0)

resolves every magnitude with the same relative resolution.
"""

from math import log1p
from typing import Final

from vergence._jit import inlined

COARSE_RAD: Final = 1.5
"""Angle of a coarse channel's value 1, rad (chosen: range of the joints)."""
MIDDLE_RAD: Final = 0.1
"""Angle of a middle channel's value 1, rad (chosen)."""
FINE_RAD: Final = 0.01
"""Angle of a fine channel's value 1, rad (chosen)."""
LOG_RAD: Final = 0.001
"""x0 of the logarithmic channel of angles, rad (chosen)."""
LOG_SPEED: Final = 0.005
"""x0 of the logarithmic channel of velocities, as a fraction of the largest command (chosen)."""


@inlined
def clip(value: float) -> float:
    """Compute a linear channel."""
    return min(max(value, -1.0), 1.0)


@inlined
def log_scaled(value: float, least: float, most: float) -> float:
    """Compute a logarithmic channel.

    Args:
        value: the quantity.
        least: x0, in its unit.
        most: magnitude whose channel is 1, in its unit.
    """
    size = min(log1p(abs(value) / least) / log1p(most / least), 1.0)
    return size if value >= 0.0 else -size
