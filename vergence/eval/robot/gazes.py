"""Metrics of gazes on a robot, one row a gaze: they may have ended early, each by itself."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from vergence.envs.task import GazeTask
from vergence.eval.gaze_trajectory import MM
from vergence.eval.trials.recorded import as_trials
from vergence.eval.trials.results import Trials
from vergence.plain import plain
from vergence.recording import Recorder

BAND_PX: Final = 2.0
"""The band of settling that leads, px: a pixel is about what encoders and commands resolve."""
MOST_PERIODS: Final = 100_000
"""Control periods of a gaze beyond which it is judged no further: a log may claim any."""


@dataclass(kw_only=True)
class Gazes:
    """Gazes of one policy."""

    steps: int | None
    """Control periods of a whole gaze, without those at its end that wait for images; None where
    each is whole as it is."""
    dry_run: bool = False
    """True if nothing has moved, so that there is nothing to judge."""
    stopped: bool = False
    """True if a fault has ended the last one, which then counts as one that has not settled; one
    that was ended otherwise, such as by Ctrl-C or a kill, does not count."""
    trials: list[Trials] = field(default_factory=list)
    late: int = 0
    """Control periods that were missed."""
    periods: int = 0
    """All control periods."""

    def add(self, task: GazeTask, record: Recorder) -> None:
        """Take a gaze, as far as it went; one that has not begun is none."""
        made = len(record.reading.time_s) - 1
        if made < 0:
            return
        rate_hz = task.head.timing.control_rate_hz
        passed = round(float(record.reading.time_s[-1, 0]) * rate_hz)
        self.late += passed - made
        self.periods += passed
        steps = min(passed if self.steps is None else self.steps, MOST_PERIODS)
        self.trials.append(
            as_trials(task, record, steps, scenario="robot", plant="hardware", band_px=BAND_PX)
        )

    def rows(self) -> list[dict[str, Any]]:
        """A row a gaze, None for what has no answer."""
        return [
            {
                "gaze": place + 1,
                "duration_s": trial.duration_s,
                "settle_2px_s": self._settle_s(trial, BAND_PX),
                "settle_1px_s": self._settle_s(trial, 1.0),
                "left_again": bool(trial.left_again[0]),
                "swings": bool(trial.swings[0]),
                "fixation_speed_pp": self._speed(trial),
                "point_error_mm": self._error_mm(trial),
            }
            for place, trial in enumerate(self.trials)
        ]

    def summary(self) -> dict[str, Any]:
        """All of them as plain values, None for what has no answer."""
        judged = [trial for trial in self.trials if self._whole(trial)]
        count = len(judged) + (self.stopped and len(judged) < len(self.trials))
        settled = [s for s in (self._settle_s(one, BAND_PX) for one in judged) if s is not None]
        return {
            "gazes": count,
            "settled_fraction": len(settled) / count if count and not self.dry_run else None,
            "settle_2px_median_s": _median(settled),
            "fixation_speed_pp": _median([self._speed(one) for one in judged]),
            "point_error_median_mm": _median([self._error_mm(one) for one in judged]),
            "overrun_fraction": self.late / self.periods if self.periods else None,
        }

    def _whole(self, trial: Trials) -> bool:
        """True if a gaze went to its end."""
        return self.steps is None or len(trial.time_s) > self.steps

    def _answer(self, trial: Trials, value: float) -> float | None:
        """A metric of a gaze, None where there is none to judge."""
        judged = self._whole(trial) and not self.dry_run
        found: float | None = plain(value) if judged else None
        return found

    def _settle_s(self, trial: Trials, band_px: float) -> float | None:
        return self._answer(trial, trial.settle_s(band_px)[0])

    def _speed(self, trial: Trials) -> float | None:
        """Peak to peak of the joints' speed while fixating, rad/s."""
        return self._answer(trial, trial.fixation_peak_to_peak_rad_s[0])

    def _error_mm(self, trial: Trials) -> float | None:
        """Distance of the last fix by gaze from the target, mm."""
        return self._answer(trial, MM * trial.fix_error_m[-1, 0])


def _median(values: list[float | None] | list[float]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None
