"""Metrics of gazes on a robot, one row per gaze; each gaze may have ended early."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from vergence.envs.task import GazeTask
from vergence.eval.gaze_trajectory import MM, gaze_and_view_fixes
from vergence.eval.trials.recorded import trials_from_record
from vergence.eval.trials.results import Trials
from vergence.operands import null_nonfinite_rows
from vergence.recording import Recorder

BAND_PX: Final = 2.0
"""Main settling band, px (chosen: one pixel is about the resolution of encoders and commands)."""
MOST_PERIODS: Final = 100_000
"""Largest number of judged control periods of a gaze (chosen: bounds memory for untrusted logs)."""


@dataclass(kw_only=True)
class RobotGazes:
    """Gazes that one policy has run on a robot, with their settling and timing metrics."""

    steps: int | None
    """Control periods of a whole gaze, without those at its end that wait for the last images; None
    if every gaze counts as whole."""
    dry_run: bool = False
    """True if nothing has moved; then nothing settles."""
    stopped: bool = False
    """True if a fault has ended the last gaze; it then counts as not settled. A gaze that ended
    early for another reason, such as Ctrl-C or a kill, does not count."""
    trials: list[Trials] = field(default_factory=list)
    point_errors_m: list[float] = field(default_factory=list)
    """Distance of each gaze's last fix from the target: by gaze, or by ITPC if the axes of the eyes
    do not cross; nan if not known."""
    missed_periods: int = 0
    """Number of missed control periods."""
    periods: int = 0
    """Number of all control periods."""

    def add(self, task: GazeTask, record: Recorder) -> None:
        """Add a gaze, complete or not; one that has not begun is ignored."""
        made = len(record.reading.time_s) - 1
        if made < 0:
            return
        rate_hz = task.head.timing.control_rate_hz
        passed = round(float(record.reading.time_s[-1, 0]) * rate_hz)
        self.missed_periods += passed - made
        self.periods += passed
        steps = min(passed if self.steps is None else self.steps, MOST_PERIODS)
        trial = trials_from_record(
            task, record, steps, scenario="robot", plant="hardware", band_px=BAND_PX
        )
        self.trials.append(trial)
        error_m = trial.fix_error_m[-1, 0]
        if task.head.has_fixed_pair:
            _gaze, itpc = gaze_and_view_fixes(task.head, record)
            error_m = np.linalg.norm(itpc.point[-1] - trial.target[-1, 0])
        self.point_errors_m.append(float(error_m))

    def add_complete(self, earlier: "RobotGazes") -> None:
        """Add the complete gazes of an earlier deployment, and all of its periods."""
        for trial, error_m in zip(earlier.trials, earlier.point_errors_m, strict=True):
            if self._whole(trial):
                self.trials.append(trial)
                self.point_errors_m.append(error_m)
        self.missed_periods += earlier.missed_periods
        self.periods += earlier.periods

    def rows(self) -> list[dict[str, Any]]:
        """A row per gaze; None for undefined metrics."""
        return [
            {
                "gaze": place + 1,
                "duration_s": trial.duration_s,
                "settle_2px_s": self._settle_s(trial, BAND_PX),
                "settle_1px_s": self._settle_s(trial, 1.0),
                "left_again": bool(trial.left_again[0]),
                "swings": bool(trial.swings[0]),
                "fixation_speed_pp": self._speed(trial),
                "point_error_mm": self._answer(trial, MM * error_m),
            }
            for place, (trial, error_m) in enumerate(
                zip(self.trials, self.point_errors_m, strict=True)
            )
        ]

    def summary(self) -> dict[str, Any]:
        """Statistics over all gazes as plain values; None for undefined metrics."""
        judged = [trial for trial in self.trials if self._whole(trial)]
        count = len(judged) + (self.stopped and len(judged) < len(self.trials))
        settled = [s for s in (self._settle_s(one, BAND_PX) for one in judged) if s is not None]
        return {
            "gazes": count,
            "settled_fraction": len(settled) / count if count and not self.dry_run else None,
            "settle_2px_median_s": _median(settled),
            "fixation_speed_pp": _median([self._speed(one) for one in judged]),
            "point_error_median_mm": _median([row["point_error_mm"] for row in self.rows()]),
            "overrun_fraction": self.missed_periods / self.periods if self.periods else None,
        }

    def _whole(self, trial: Trials) -> bool:
        """True if a gaze was completed."""
        return self.steps is None or len(trial.time_s) > self.steps

    def _answer(self, trial: Trials, value: float) -> float | None:
        """A metric of a gaze; None if it is not judged."""
        judged = self._whole(trial) and not self.dry_run
        found: float | None = null_nonfinite_rows(value) if judged else None
        return found

    def _settle_s(self, trial: Trials, band_px: float) -> float | None:
        return self._answer(trial, trial.settle_s(band_px)[0])

    def _speed(self, trial: Trials) -> float | None:
        """Peak-to-peak joint speed while fixating, rad/s."""
        return self._answer(trial, trial.fixation_peak_to_peak_rad_s[0])


def _median(values: list[float | None] | list[float]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None
