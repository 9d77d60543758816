"""Log lines on what may happen in every control period: one a second at most, with a count."""

import logging
from collections.abc import Callable
from typing import Final

import numpy as np

_EVERY_S: Final = 1.0
"""Time between two lines, s."""


class CountLog:
    """Counts events of one kind, and logs how many there were since its last line.

    Args:
        log: takes the lines.
        level: of the lines.
        text: of a line, with a %d for the count and places for what else `add` is given.
        clock: a steady clock, s.
    """

    def __init__(
        self, log: logging.Logger, level: int, text: str, clock: Callable[[], float]
    ) -> None:
        self._log, self._level, self._text = log, level, text
        self._clock = clock
        self._count, self._told_s = 0, -np.inf

    def add(self, count: int, *values: object) -> None:
        """Count events, and say so if the last line is a second old."""
        self._count += count
        now = self._clock()
        if now - self._told_s >= _EVERY_S:
            self._log.log(self._level, self._text, self._count, *values)
            self._count, self._told_s = 0, now
