r"""Scaling of angles and velocities to channels: numbers in [-1, 1] in several resolutions.

A linear channel saturates; a logarithmic one,

    sign(x) ln(1 + |x| / x0) / ln(1 + x_max / x0)

resolves every magnitude with the same relative resolution.
"""

from math import log1p
from typing import Final

from vergence.kernels import inlined

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
def clip_to_unit(value: float) -> float:
    """Clip a scaled value to [-1, 1]: a linear channel, which saturates."""
    return min(max(value, -1.0), 1.0)


@inlined
def symlog_scaled(value: float, linear_threshold: float, full_scale: float) -> float:
    """Scale a value to [-1, 1] logarithmically, with its sign.

    The result is sign(x) ln(1 + |x| / x0) / ln(1 + x_max / x0).

    Args:
        value: the quantity.
        linear_threshold: x0, in its unit.
        full_scale: magnitude whose channel is 1, in its unit.
    """
    size = min(log1p(abs(value) / linear_threshold) / log1p(full_scale / linear_threshold), 1.0)
    return size if value >= 0.0 else -size
