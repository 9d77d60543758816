"""Metrics of gazes on a robot, one row a gaze: they may have ended early, each by itself."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from vergence.envs.task import GazeTask
from vergence.eval.trials.recorded import as_trials
from vergence.eval.trials.results import Trials
from vergence.recording.recorder import Recorder

BAND_PX: Final = 2.0
"""The band of settling that leads, px: a pixel is about what encoders and commands resolve."""
METRICS: Final = (
    "settled_fraction", "settle_2px_median_s", "fixation_speed_pp", "point_error_median_mm",
)  # fmt: skip
"""Fields of the summary that judge a policy."""
MM: Final = 1000.0


@dataclass
class Gazes:
    """Gazes of one policy.

    Args:
        steps: control periods of a whole gaze, without those at its end that wait for images.
    """

    steps: int
    trials: list[Trials] = field(default_factory=list)
    late: int = 0
    """Control periods that were missed."""
    periods: int = 0
    """All control periods."""

    def add(self, task: GazeTask, record: Recorder) -> None:
        """Take a gaze, as far as it went; one that has not begun is none."""
        if len(record.reading.time_s):
            made = len(record.reading.time_s) - 1
            last_s = float(record.reading.time_s[-1, 0])
            passed = round(last_s * task.head.timing.control_rate_hz)
            self.late += passed - made
            self.periods += passed
            self.trials.append(
                as_trials(
                    task, record, self.steps, scenario="robot", plant="hardware", band_px=BAND_PX
                )
            )

    def settle_s(self, place: int, band_px: float = BAND_PX) -> float:
        """When both eyes come within a band to stay, s; nan for never and for gazes cut short."""
        trial = self.trials[place]
        return float(trial.settle_s(band_px)[0]) if self.whole(place) else np.nan

    def whole(self, place: int) -> bool:
        """Whether a gaze went to its end."""
        return len(self.trials[place].time_s) > self.steps

    def rows(self) -> list[dict[str, Any]]:
        """A row a gaze, None for what has no answer."""
        return [
            {
                "gaze": place + 1,
                "duration_s": trial.duration_s,
                "settle_2px_s": _plain(self.settle_s(place)),
                "settle_1px_s": _plain(self.settle_s(place, 1.0)),
                "left_again": bool(trial.left_again[0]),
                "swings": bool(trial.swings[0]),
                "fixation_speed_pp": _plain(self._speed(place)),
                "point_error_mm": _plain(self._error_mm(place)),
            }
            for place, trial in enumerate(self.trials)
        ]

    def summary(self) -> dict[str, Any]:
        """All of them as plain values, None for what has no answer."""
        count = len(self.trials)
        settle = np.array([self.settle_s(place) for place in range(count)])
        settled = np.isfinite(settle)
        return {
            "gazes": count,
            "settled_fraction": float(settled.mean()) if count else None,
            "settle_2px_median_s": _median(settle),
            "fixation_speed_pp": _median([self._speed(place) for place in range(count)]),
            "point_error_median_mm": _median([self._error_mm(place) for place in range(count)]),
            "overrun_fraction": self.late / self.periods if self.periods else None,
        }

    def _speed(self, place: int) -> float:
        """Peak to peak of the joints' speed while fixating, rad/s; nan for gazes cut short."""
        trial = self.trials[place]
        return float(trial.fixation_peak_to_peak_rad_s[0]) if self.whole(place) else np.nan

    def _error_mm(self, place: int) -> float:
        """Distance of the last fix by gaze from the target, mm.

        It is nan without truth, and for gazes cut short.
        """
        return MM * float(self.trials[place].fix_error_m[-1, 0]) if self.whole(place) else np.nan


def _median(values: Any) -> float | None:
    known = np.asarray(values)[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None


def _plain(value: float) -> float | None:
    return value if np.isfinite(value) else None
