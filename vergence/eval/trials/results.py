"""What trials of one controller were, and what follows from it: one value a trial and metric."""

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
"""The band that settling means unless another is named."""
_ROUNDING_S: Final = 1e-9
_ROUNDING_PX: Final = 1e-6
"""What numerics leave of the least error where it is zero."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Trials:
    """What n trials of a controller were: step k of a trial is k control periods from its start."""

    scenario: str
    plant: str
    moving: bool
    """Whether the target moves all along, so that tracking counts and settling does not."""
    band_px: float
    """The band of settling that leads, px."""
    catch_up_s: float
    """Time at the start that the tracking of a moving target does not count."""
    head: HeadModel
    """The head that the controller knows."""
    time_s: FloatArray
    """(steps + 1,) since the trial's start."""
    onset_s: FloatArray
    """(n,) when the target appeared where it stays, or began to move, since the trial's start."""
    error: FloatArray
    """(steps + 1, n, 2, 2) px by eye and image axis: the true undistorted error at the present
    time in simulation, the measured error at exposure time on a plant without truth; nan where
    there is none."""
    residual: FloatArray
    """(n, 2, 2) the least error that the true head's actuators can reach at the target, px; zero
    where both eyes can fixate exactly, and for moving targets. On a plant without truth, what the
    model says for where its last images have the target."""
    command: FloatArray
    """(steps, n, 4) the velocities of the eyes' actuators as commanded, rad/s, within their limits;
    0 for those that a head does not have."""
    visible: NDArray[np.bool_]
    """(steps + 1, n, 2) whether each eye saw the target in the newest image."""
    lost: NDArray[np.bool_]
    """(n,) whether the target was ever lost, by the task's rule."""
    stopped: NDArray[np.bool_]
    """(n,) whether a robot was stopped before the end because it swung."""
    positions: FloatArray
    """(steps + 1, n, 7) joint angles as the sensors report them, rad."""
    speed: FloatArray
    """(steps, n, 4) mean speed of the eyes' joints over each control period, rad/s: in simulation
    the true one, as the motors turn them, so that motion within their play counts; on a plant
    without truth that of the measured angles."""
    target: FloatArray
    """(steps + 1, n, 3) the target in N, m; nan without truth."""
    bounds_s: dict[float, FloatArray]
    """(n,) each: the time-optimal bound of settling since the onset, by band, px; nan where it has
    no meaning."""
    conditions: dict[str, FloatArray]
    """(n,) each: what the trials ran with, hidden from the controller, by name; empty on a plant
    that cannot tell."""
    observation: NDArray[np.float32]
    """(steps, m, size) what the controller saw in the first m trials, as many as were asked for."""
    predict_us: float
    """Microseconds a head that `predict` took in the batch: the median over steps."""

    @property
    def num(self) -> int:
        """How many trials."""
        return int(self.error.shape[1])

    @property
    def duration_s(self) -> float:
        """How long each trial lasted."""
        return float(self.time_s[-1])

    @property
    def missing_px(self) -> float:
        """What an error without a value counts as in averages: the larger image's diagonal."""
        return float(np.hypot(*self.head.cameras.size.T).max())

    @cached_property
    def reducible(self) -> FloatArray:
        """(steps + 1, n, 2, 2) the error beyond the residual, px: what a controller can do about.

        For moving targets it is the error as it is.
        """
        return np.asarray(self.error - self.residual)

    @cached_property
    def residual_px(self) -> FloatArray:
        """(n,) that of the worse eye; nan where tracking counts or each joint has a motor."""
        if self.moving or self.head.actuation.direct:
            return np.full(self.num, np.nan)
        worse = np.linalg.norm(self.residual, axis=-1).max(axis=-1)
        return np.where(worse < _ROUNDING_PX, 0.0, worse)

    def settle_s(self, band_px: float = BAND_PX) -> FloatArray:
        """(n,) when both eyes come within a band about the least error that they can reach to stay.

        It counts from the onset, and is nan for trials that never settle. A trial that `swings`
        has not settled, whatever the pixels say.
        """
        settled = metrics.settle_time(self.time_s, self.reducible, band_px)
        return np.where(self.swings, np.nan, np.maximum(settled - self.onset_s, 0.0))

    def settle_or_trial_s(self, band_px: float = BAND_PX) -> FloatArray:
        """(n,) the same, a trial that never settles counting as the whole trial."""
        settle = self.settle_s(band_px)
        return np.where(np.isnan(settle), self.duration_s, settle)

    @property
    def bound_s(self) -> FloatArray:
        """(n,) the time-optimal bound of settling to 1 px."""
        return self.bounds_s[BAND_PX]

    def ratio_to_bound(self, band_px: float = BAND_PX) -> FloatArray:
        """(n,) settle time by the bound; inf for failures, of which there is no ratio.

        Args:
            band_px: one of the bands of `bounds_s`.
        """
        return _ratio(self.settle_s(band_px), self.bounds_s[band_px])

    @cached_property
    def swings(self) -> NDArray[np.bool_]:
        """(n,) see `fixation.swings`, or `stopped`; False for targets that never rest."""
        if self.moving:
            return np.zeros(self.num, dtype=np.bool_)
        return self.stopped | fixation.swings(self.time_s, self.speed, self.onset_s)

    @cached_property
    def left_again(self) -> NDArray[np.bool_]:
        """(n,) see `fixation.left_again`, of the leading band; else as `swings`."""
        if self.moving:
            return np.zeros(self.num, dtype=np.bool_)
        return fixation.left_again(self.time_s, self.reducible, self.band_px, self.onset_s)

    @cached_property
    def fixation_rms_rad_s(self) -> FloatArray:
        """(n,) see `fixation.speed_rms`, while fixating; nan for targets that never rest."""
        if self.moving:
            return np.full(self.num, np.nan)
        return fixation.speed_rms(self.time_s, self.speed, self._fixation_start)

    @cached_property
    def fixation_peak_to_peak_rad_s(self) -> FloatArray:
        """(n,) see `fixation.speed_peak_to_peak`, else as `fixation_rms_rad_s`."""
        if self.moving:
            return np.full(self.num, np.nan)
        return fixation.speed_peak_to_peak(self.time_s, self.speed, self._fixation_start)

    @property
    def _fixation_start(self) -> FloatArray:
        return fixation.fixation_start(self.onset_s, self.duration_s)

    @cached_property
    def overshoot(self) -> FloatArray:
        """(n,) see `metrics.overshoot`: beyond the least error that the eyes can reach."""
        return metrics.overshoot(
            self.reducible, np.searchsorted(self.time_s, self.onset_s - _ROUNDING_S)
        )

    @cached_property
    def steady_px(self) -> FloatArray:
        """(n,) see `metrics.steady_state_error`: what is left beyond the least error."""
        return metrics.steady_state_error(self.time_s, self.reducible, self.missing_px)

    @cached_property
    def tracking_px(self) -> FloatArray:
        """(n,) see `metrics.tracking_rms`."""
        return metrics.tracking_rms(
            self.time_s, self.error, self.missing_px, self.onset_s + self.catch_up_s
        )

    @cached_property
    def tracking_lag_s(self) -> FloatArray:
        """(n,) see `metrics.tracking_lag`; nan where the target stands still, or without truth."""
        before, after = np.roll(self.target, 1, axis=0), np.roll(self.target, -1, axis=0)
        before[0], after[-1] = self.target[0], self.target[-1]
        span = np.full(len(self.time_s), 2.0)
        span[[0, -1]] = 1.0
        span *= self.head.timing.period_s
        # eyes as they are, held still while the target passes
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
        """(steps + 1, n) distance of the gaze fix from the target; nan for neither."""
        fix = triangulate_gaze(self.head, self.positions)
        return np.asarray(np.linalg.norm(fix.point - self.target, axis=-1))

    def fix_error_at_settling_m(self) -> FloatArray:
        """(n,) that distance at the moment of settling to 1 px; nan for trials that never do."""
        return metrics.at_time(self.time_s, self.fix_error_m, self.onset_s + self.settle_s())


def _ratio(settle_s: FloatArray, bound_s: FloatArray) -> FloatArray:
    return np.where(np.isnan(settle_s) & ~np.isnan(bound_s), np.inf, settle_s / bound_s)


def headline(trials: Trials) -> float:
    """The one number a controller is judged by in a scenario; smaller is better.

    Args:
        trials: the trials.

    Returns:
        For a scenario that settles, the median settle time to its leading band, s, a trial that
        never settles counting as the whole trial; for a moving one the median of the trials'
        tracking RMS, px.
    """
    settle_s = trials.settle_or_trial_s(trials.band_px)
    return float(np.median(trials.tracking_px if trials.moving else settle_s))


def join(parts: Sequence[Trials]) -> Trials:
    """Trials of several batches as one.

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
        moving=first.moving,
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
        stopped=np.concatenate([part.stopped for part in parts]),
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
    )
