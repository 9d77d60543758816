"""When an image is new: its exposure time has moved on since the last observation."""

from typing import Final

from vergence._jit import device
from vergence.envs.layout import AGE_S

_TOLERANCE: Final = 0.3
"""Share of a period below which two exposure times are one: float32 rounds the age, and a period
that lasts longer or shorter than it should moves the age of an old image by as much."""


@device
def is_fresh(age_s: float, last_age_s: float, period_s: float) -> bool:
    """Whether an observation has an image that the one a period before had not.

    An image that has not been replaced grows older by a period in a period. One that was exposed
    later is new, whatever its age: images may come late, or be dated between two periods. Where a
    late step skips a period, a new image may be taken for the old one, if it was exposed less than
    1.3 periods later; an old one never seems new.

    Args:
        age_s: age of the newest image. From `AGE_S` on the observation does not tell it, and the
            image is not fresh.
        last_age_s: the age a period ago; `AGE_S` at a trial's start.
        period_s: the control period.
    """
    later = period_s - (age_s - last_age_s)
    return age_s < AGE_S and later > _TOLERANCE * period_s
