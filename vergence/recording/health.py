"""Health of a robot's loop as its readings tell: the gap of the eyes' rays, and late periods."""

import warnings
from collections import deque
from typing import Final

import numpy as np

from vergence.envs.reading import Reading
from vergence.errors import VergenceWarning
from vergence.models.head import HeadModel
from vergence.models.parts import EYES
from vergence.triangulation import triangulate_views
from vergence.triangulation.fix import gap_sigma

MAX_GAP_RATIO: Final = 3.0
"""Root mean square of gaps over their predicted standard deviation above which they are reported
(chosen: 3 sigma; one posture's images share its encoder errors, so their mean is no surer)."""
_WINDOW: Final = 30
"""Number of images over which gaps are judged (chosen: a second of a webcam)."""
_MIN_IMAGES: Final = 5
"""Least number of images for a judgement (chosen)."""
_SLOW_RAD_S: Final = 0.05
"""Speed of the eyes' joints below which a gap is judged, rad/s; a date that is wrong by 10 ms then
turns them by less than 0.5 mrad (chosen)."""


class LoopHealth:
    """Judges a robot's readings, one after the other.

    Args:
        head: the model that the controller uses.

    Attributes:
        missed_periods: number of missed control periods.
        periods: number of all control periods.
    """

    def __init__(self, head: HeadModel) -> None:
        self._head = head
        self._ratios: deque[float] = deque(maxlen=_WINDOW)
        self._gaps_m: deque[float] = deque(maxlen=_WINDOW)
        self._last_s, self._moved_s, self._exposure_s = float("inf"), 0.0, float("nan")
        self.missed_periods = self.periods = 0

    def add(self, reading: Reading) -> None:
        """Judge a reading.

        Args:
            reading: the reading; its arrays lack the axis over heads.
        """
        time_s, period_s = float(reading.time_s), self._head.timing.period_s
        if time_s < self._last_s:  # a gaze begins
            self._moved_s = time_s
        else:
            passed = round((time_s - self._last_s) / period_s)
            self.periods += passed
            self.missed_periods += passed - 1
        self._last_s = time_s
        if (np.abs(reading.velocities[EYES]) > _SLOW_RAD_S).any():
            self._moved_s = time_s
        exposed_s = float(reading.exposure_s)
        if exposed_s != self._exposure_s and exposed_s > self._moved_s and reading.visible.all():
            self._exposure_s = exposed_s
            fix = triangulate_views(self._head, reading.positions_at_exposure, reading.pixels)
            sigma = gap_sigma(self._head, reading.positions_at_exposure, reading.pixels)
            if fix.valid and sigma > 0.0:
                self._ratios.append(float(fix.gap / sigma))
                self._gaps_m.append(float(fix.gap))

    @property
    def gap_ratio(self) -> float:
        """Root mean square of the last gaps over their predicted spread; nan if there are few."""
        if len(self._ratios) < _MIN_IMAGES:
            return float("nan")
        return float(np.sqrt(np.mean(np.square(self._ratios))))

    def gap_text(self) -> str:
        """Description of the last gaps, if there are any."""
        gap_mm = 1e3 * float(np.sqrt(np.mean(np.square(self._gaps_m))))
        ratio = self.gap_ratio
        return f"gap of the eyes' rays {gap_mm:.2f} mm, {ratio:.1f} times its predicted spread"

    def words(self) -> list[str]:
        """Lines of text, in Markdown; warnings are bold."""
        ratio, lines = self.gap_ratio, []
        if np.isfinite(ratio):
            text = self.gap_text()
            if ratio > MAX_GAP_RATIO:
                text = f"**warning: {text}: has a camera moved?**"
            lines.append(text)
        if self.periods:
            late = f"{self.missed_periods} of the last {self.periods} periods late"
            lines.append(f"**{late}**" if self.missed_periods else late)
        return lines


def warn_of_gap(head: HeadModel, readings: Reading) -> None:
    """Warn if lines of sight miss each other by more than noise explains.

    Args:
        head: the model that the controller uses.
        readings: a gaze's readings, arrays of (rows, 1, ...).
    """
    health = LoopHealth(head)
    for row in range(len(readings.time_s)):
        health.add(Reading._make(part[row, 0] for part in readings))
    if health.gap_ratio > MAX_GAP_RATIO:
        warnings.warn(
            f"expected lines of sight that meet at the target, got a {health.gap_text()}: a zero "
            "(zero_ticks) or a camera is off; cure: `vergence jog`, or calibrate the head",
            VergenceWarning,
            stacklevel=2,
        )
