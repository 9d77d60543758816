"""Detection of a new image: its exposure is later than in the last observation."""

from typing import Final

from vergence.envs.observation import AGE_S
from vergence.kernels import inlined

_PERIOD_TOLERANCE: Final = 0.3
"""Fraction of a period up to which two exposure times count as equal (chosen: float32 rounds the
age, and jitter of the period shifts the age of an old image by as much)."""


@inlined
def is_fresh(age_s: float, last_age_s: float, period_s: float) -> bool:
    """True if an observation has an image that the observation one period before did not have.

    An image that has not been replaced ages by one period per period. An image exposed later is
    new, whatever its age: images may arrive late, or be exposed between two periods. If a late step
    skips a period, a new image exposed less than 1.3 periods later may be taken for the old one; an
    old one never counts as new.

    Args:
        age_s: age of the newest image, s. From `AGE_S` on the observation gives no age, and the
            image is not fresh.
        last_age_s: its age a period ago, s; `AGE_S` at a trial's start.
        period_s: the control period, s.
    """
    later = period_s - (age_s - last_age_s)
    return age_s < AGE_S and later > _PERIOD_TOLERANCE * period_s
