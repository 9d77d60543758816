"""Search for the last value, going away from the expected one, at which a condition holds.

The search tests the values of a grid until the first at which the condition fails. The grid is
finest next to the expected value, where fragile controllers fail. Bisection then narrows the
bracket between the last value at which the condition holds and that first one. The condition was
tested at the returned value and at every grid value before it. A failure between two grid values
that both hold is not detected.
"""

from collections.abc import Callable
from typing import Final

GRID_FRACTIONS: Final = (
    1 / 64,
    1 / 32,
    1 / 16,
    1 / 8,
    1 / 4,
    3 / 8,
    1 / 2,
    5 / 8,
    3 / 4,
    7 / 8,
    1.0,
)
"""Grid values as fractions of the way from the expected value to the end of the search (chosen:
resolution against number of runs)."""
BISECTIONS: Final = 4
"""Bisections of the bracket (chosen: resolution against number of runs)."""


def last_holding_value(holds: Callable[[float], bool], begin: float, end: float) -> float | None:
    """Last value on the way to another at which a condition holds, by a grid and a bisection.

    Args:
        holds: the condition, tested at a value.
        begin: start of the search.
        end: end of the search.

    Returns:
        The last value at which the condition holds, which may be `begin` or `end`; None if it does
        not hold at `begin`.
    """
    if not holds(begin):
        return None
    if begin == end:
        return begin
    good = begin
    for share in GRID_FRACTIONS:
        value = end if share == 1.0 else _rounded(begin + share * (end - begin))
        if not holds(value):
            return _between(holds, good, value)
        good = value
    return good


def _between(holds: Callable[[float], bool], good: float, bad: float) -> float:
    """Bisect between a value at which the condition holds and one at which it fails."""
    for _ in range(BISECTIONS):
        middle = _rounded(0.5 * (good + bad))
        if holds(middle):
            good = middle
        else:
            bad = middle
    return good


def _rounded(value: float) -> float:
    """Round to six significant digits, so that the tested value is exactly the written one."""
    return float(f"{value:.6g}")
