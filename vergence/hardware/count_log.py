"""Log lines for events of any control period: at most one line a second, with their count."""

import logging
from collections.abc import Callable
from typing import Final

import numpy as np

_MIN_INTERVAL_S: Final = 1.0
"""Least time between two lines, s (chosen)."""


class CountLog:
    """Counts events of one kind, and logs the number since its last line.

    Args:
        log: the logger of the lines.
        level: the logging level of the lines.
        text: the format of a line: a %d for the count, then the values given to `add`.
        clock: a monotonic clock, s.
    """

    def __init__(
        self, log: logging.Logger, level: int, text: str, clock: Callable[[], float]
    ) -> None:
        self._log, self._level, self._text = log, level, text
        self._clock = clock
        self._count, self._told_s = 0, -np.inf

    def add(self, count: int, *values: object) -> None:
        """Count events, and log them if the last line is a second old."""
        self._count += count
        now = self._clock()
        if now - self._told_s >= _MIN_INTERVAL_S:
            self._log.log(self._level, self._text, self._count, *values)
            self._count, self._told_s = 0, now
