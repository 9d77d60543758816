"""Recorded trials of one controller and their metrics, one value per trial and metric."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.eval.trials import fixation, metrics
from vergence.eval.trials.settling import ONE_PX
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.triangulation import triangulate_gaze

BAND_PX: Final = ONE_PX.px
"""Default band of settling, px."""
_TIME_TOLERANCE_S: Final = 1e-9
"""Tolerance within which two times count as equal, s (numerical)."""
_ZERO_RESIDUAL_PX: Final = 1e-6
"""Residual below which it counts as zero, px (numerical)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Trials:
    """Recorded trajectories of n trials of a controller, and their metrics.

    Index k along the time axis is k control periods after a trial's start.
    """

    scenario: str
    plant: str
    target_moves: bool
    """True if the target moves throughout: tracking is evaluated, not settling."""
    band_px: float
    """Leading band: the one to which the scenario judges settling, px."""
    catch_up_s: float
    """Time after the onset that does not count in the tracking of a moving target, s."""
    head: HeadModel
    """The head that the controller knows."""
    time_s: FloatArray
    """(steps + 1,) since the trial's start."""
    onset_s: FloatArray
    """(n,) time since the trial's start at which the target reached its last place or began to
    move, s."""
    error: FloatArray
    """(steps + 1, n, 2, 2) px by eye and image axis: in simulation the true undistorted error at
    the present time, on a plant without ground truth the measured error at exposure time; nan if
    there is none."""
    residual: FloatArray
    """(n, 2, 2) the least error that the true head's actuators can reach at the target, px; zero
    if both eyes can fixate exactly, and for moving targets. On a plant without ground truth, the
    model's least error at the place that the last images give for the target."""
    command: FloatArray
    """(steps, n, 4) commanded velocities of the eyes' actuators, within their limits, rad/s; 0 for
    actuators that the head does not have."""
    visible: NDArray[np.bool_]
    """(steps + 1, n, 2) True if the target is visible in an eye's newest image."""
    lost: NDArray[np.bool_]
    """(n,) True if the target was ever lost, by the task's rule."""
    stopped_for_swinging: NDArray[np.bool_]
    """(n,) True if a robot was stopped before the end because it swung (oscillated)."""
    positions: FloatArray
    """(steps + 1, n, 7) joint angles as the sensors report them, rad."""
    speed: FloatArray
    """(steps, n, 4) mean speed of the eyes' joints over each control period, rad/s: in simulation
    from the true motor angles, so that motion within the backlash counts; on a plant without ground
    truth from the measured angles."""
    target: FloatArray
    """(steps + 1, n, 3) the target in N, m; nan without ground truth."""
    bounds_s: dict[float, FloatArray]
    """(n,) each: the time-optimal bound of the settle time since the onset, s, by band in px; nan
    if there is none."""
    conditions: dict[str, FloatArray]
    """(n,) each: conditions of the trials by name, hidden from the controller; empty unless the
    plant is a simulation."""
    observation: NDArray[np.float32]
    """(steps, m, size) observations of the first m trials, m being the requested number."""
    predict_us: float
    """Duration of `predict` per head in the batch, microseconds: the median over steps."""
    linear_law_fraction: float = np.nan
    """Fraction of the periods in which a linear law acted in a network's place; nan for controllers
    without a network."""

    @property
    def num(self) -> int:
        """Number of trials."""
        return int(self.error.shape[1])

    @property
    def duration_s(self) -> float:
        """Duration of each trial, s."""
        return float(self.time_s[-1])

    @property
    def missing_px(self) -> float:
        """Value in place of a missing error in averages: the larger image's diagonal, px."""
        return float(np.hypot(*self.head.cameras.size.T).max())

    @cached_property
    def reducible_error(self) -> FloatArray:
        """(steps + 1, n, 2, 2) the error less the residual, px: the part a controller can remove.

        For moving targets it is the error itself.
        """
        return np.asarray(self.error - self.residual)

    @cached_property
    def residual_px(self) -> FloatArray:
        """(n,) residual of the worse eye, px; nan for moving targets and uncoupled joints."""
        if self.target_moves or self.head.actuation.direct:
            return np.full(self.num, np.nan)
        worse = np.linalg.norm(self.residual, axis=-1).max(axis=-1)
        return np.where(worse < _ZERO_RESIDUAL_PX, 0.0, worse)

    def settle_s(self, band_px: float = BAND_PX) -> FloatArray:
        """(n,) settle time: both eyes enter a band about their residuals and stay in it, s.

        It counts from the onset, and is nan for trials that never settle. A trial that `swings`
        has not settled, whatever its pixel errors are.
        """
        settled = metrics.settle_time(self.time_s, self.reducible_error, band_px)
        return np.where(self.swings, np.nan, np.maximum(settled - self.onset_s, 0.0))

    def settle_or_trial_s(self, band_px: float = BAND_PX) -> FloatArray:
        """(n,) settle time, s; the duration of the trial if it never settles."""
        settle = self.settle_s(band_px)
        return np.where(np.isnan(settle), self.duration_s, settle)

    @property
    def bound_s(self) -> FloatArray:
        """(n,) the time-optimal bound of settling to 1 px."""
        return self.bounds_s[BAND_PX]

    def ratio_to_bound(self, band_px: float = BAND_PX) -> FloatArray:
        """(n,) ratio of the settle time to the bound; inf for trials that never settle.

        Args:
            band_px: one of the bands of `bounds_s`.
        """
        return _ratio(self.settle_s(band_px), self.bounds_s[band_px])

    @cached_property
    def swings(self) -> NDArray[np.bool_]:
        """(n,) True if the eyes swing, see `detect_oscillation`, or the robot was `stopped` for it.

        False for targets that never rest.
        """
        if self.target_moves:
            return np.zeros(self.num, dtype=np.bool_)
        return self.stopped_for_swinging | fixation.detect_oscillation(
            self.time_s, self.speed, self.onset_s
        )

    @cached_property
    def left_again(self) -> NDArray[np.bool_]:
        """(n,) see `fixation.detect_band_exits`, for the leading band; otherwise as `swings`."""
        if self.target_moves:
            return np.zeros(self.num, dtype=np.bool_)
        return fixation.detect_band_exits(
            self.time_s, self.reducible_error, self.band_px, self.onset_s
        )

    @cached_property
    def fixation_rms_rad_s(self) -> FloatArray:
        """(n,) `fixation.worst_joint_speed_rms`; nan if the target never rests."""
        if self.target_moves:
            return np.full(self.num, np.nan)
        return fixation.worst_joint_speed_rms(self.time_s, self.speed, self._fixation_start)

    @cached_property
    def fixation_peak_to_peak_rad_s(self) -> FloatArray:
        """(n,) see `fixation.worst_joint_speed_range`; otherwise as `fixation_rms_rad_s`."""
        if self.target_moves:
            return np.full(self.num, np.nan)
        return fixation.worst_joint_speed_range(self.time_s, self.speed, self._fixation_start)

    @property
    def _fixation_start(self) -> FloatArray:
        return fixation.fixation_window_start(self.onset_s, self.duration_s)

    @cached_property
    def overshoot(self) -> FloatArray:
        """(n,) see `metrics.overshoot`: beyond the residual."""
        return metrics.overshoot_fraction(
            self.reducible_error, np.searchsorted(self.time_s, self.onset_s - _TIME_TOLERANCE_S)
        )

    @cached_property
    def steady_px(self) -> FloatArray:
        """(n,) see `metrics.steady_state_rms`: beyond the residual, px."""
        return metrics.steady_state_rms(self.time_s, self.reducible_error, self.missing_px)

    @cached_property
    def tracking_px(self) -> FloatArray:
        """(n,) see `metrics.tracking_rms`."""
        return metrics.tracking_rms(
            self.time_s, self.error, self.missing_px, self.onset_s + self.catch_up_s
        )

    @cached_property
    def tracking_lag_s(self) -> FloatArray:
        """(n,) see `metrics.tracking_lag`, s; nan if the target rests, or without ground truth."""
        before, after = np.roll(self.target, 1, axis=0), np.roll(self.target, -1, axis=0)
        before[0], after[-1] = self.target[0], self.target[-1]
        span = np.full(len(self.time_s), 2.0)
        span[[0, -1]] = 1.0
        span *= self.head.timing.period_s
        # image velocity of the target with the eyes held at their present angles
        seen = [self.head.project(self.positions, p, distorted=False) for p in (before, after)]
        velocity = (seen[1] - seen[0]) / span[:, None, None, None]
        return metrics.tracking_lag(
            self.time_s, self.error, velocity, self.onset_s + self.catch_up_s
        )

    @cached_property
    def energy(self) -> FloatArray:
        """(n,) see `metrics.command_energy`, rad^2/s."""
        return metrics.command_energy(self.command, self.head.timing.period_s)

    @cached_property
    def peak_rad_s(self) -> FloatArray:
        """(n,) see `metrics.command_peak`."""
        return metrics.command_peak(self.command)

    @cached_property
    def fix_error_m(self) -> FloatArray:
        """(steps + 1, n) distance of the gaze fix from the target, m; nan if either is missing."""
        fix = triangulate_gaze(self.head, self.positions)
        return np.asarray(np.linalg.norm(fix.point - self.target, axis=-1))

    def fix_error_at_settling_m(self) -> FloatArray:
        """(n,) `fix_error_m` at the time of settling to 1 px; nan for trials that never settle."""
        return metrics.value_at_time(self.time_s, self.fix_error_m, self.onset_s + self.settle_s())


def _ratio(settle_s: FloatArray, bound_s: FloatArray) -> FloatArray:
    return np.where(np.isnan(settle_s) & ~np.isnan(bound_s), np.inf, settle_s / bound_s)


def headline_metric(trials: Trials) -> float:
    """The single number by which a controller is judged in a scenario; smaller is better.

    Args:
        trials: the trials.

    Returns:
        For targets that come to rest, the median settle time to the leading band, s; a trial that
        never settles counts with its duration. For moving targets, the median of the trials'
        tracking RMS, px.
    """
    settle_s = trials.settle_or_trial_s(trials.band_px)
    return float(np.median(trials.tracking_px if trials.target_moves else settle_s))


def join_trials(parts: Sequence[Trials]) -> Trials:
    """Join the trials of several batches.

    Args:
        parts: trials of the same controller, scenario and plant.

    Returns:
        All of them, in order.
    """
    if len(parts) == 1:
        return parts[0]
    first = parts[0]
    return Trials(
        scenario=first.scenario,
        plant=first.plant,
        target_moves=first.target_moves,
        band_px=first.band_px,
        catch_up_s=first.catch_up_s,
        head=first.head,
        time_s=first.time_s,
        onset_s=np.concatenate([part.onset_s for part in parts]),
        error=np.concatenate([part.error for part in parts], axis=1),
        residual=np.concatenate([part.residual for part in parts]),
        command=np.concatenate([part.command for part in parts], axis=1),
        visible=np.concatenate([part.visible for part in parts], axis=1),
        lost=np.concatenate([part.lost for part in parts]),
        stopped_for_swinging=np.concatenate([part.stopped_for_swinging for part in parts]),
        positions=np.concatenate([part.positions for part in parts], axis=1),
        speed=np.concatenate([part.speed for part in parts], axis=1),
        target=np.concatenate([part.target for part in parts], axis=1),
        bounds_s={
            band_px: np.concatenate([part.bounds_s[band_px] for part in parts])
            for band_px in first.bounds_s
        },
        conditions={
            name: np.concatenate([part.conditions[name] for part in parts])
            for name in first.conditions
        },
        observation=np.concatenate([part.observation for part in parts], axis=1),
        predict_us=float(np.median([part.predict_us for part in parts])),
        linear_law_fraction=float(
            np.average([part.linear_law_fraction for part in parts], weights=[p.num for p in parts])
        ),
    )
