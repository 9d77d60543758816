"""The last value, away from the expected one, at which something still holds.

It is found on a grid, whose steps are smallest next to the expected value, where fragile
controllers fail, and then by halving between the last value at which it holds and the first at
which it does not. What is returned has been measured, and so has every value of the grid before
it; what fails between two of them and holds at both is not seen.
"""

from collections.abc import Callable
from typing import Final

GRID: Final = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 3 / 8, 1 / 2, 5 / 8, 3 / 4, 7 / 8, 1.0)
"""Shares of the way from the expected value to the end of the search."""
HALVINGS: Final = 4


def last_value(holds: Callable[[float], bool], begin: float, end: float) -> float | None:
    """Search from one value towards another.

    Args:
        holds: whether it holds at a value.
        begin: where the search begins.
        end: where it ends.

    Returns:
        The last value at which it holds, which may be either end; None where it does not hold at
        the beginning.
    """
    if not holds(begin):
        return None
    if begin == end:
        return begin
    good = begin
    for share in GRID:
        value = end if share == 1.0 else _plain(begin + share * (end - begin))
        if not holds(value):
            return _between(holds, good, value)
        good = value
    return good


def _between(holds: Callable[[float], bool], good: float, bad: float) -> float:
    """Halve the way from a value at which it holds to one at which it does not."""
    for _ in range(HALVINGS):
        middle = _plain(0.5 * (good + bad))
        if holds(middle):
            good = middle
        else:
            bad = middle
    return good


def _plain(value: float) -> float:
    """A value of so few digits that it can be written down, and is measured as it is written."""
    return float(f"{value:.6g}")
