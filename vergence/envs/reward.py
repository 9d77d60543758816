r"""Observation, reward and termination of the gaze task, computed from readings alone.

Per step, with e the norm of an eye's measured pixel error:

    tracking  = mean over eyes of (10 px / (10 px + e) + 100 px / (100 px + e)) / 3
    precision = mean over eyes of (1 px / (1 px + e)) / 3
    effort    = -(tracking + precision) / 100 times the mean square of the action
    lost      = -25, once, when the episode ends for a lost target

The reward is their sum, at most 1. A step in which an eye does not see the target earns 0.

A target is lost if it has been seen, but not by both eyes at once for half a second, or if no eye
has seen it 1.5 s after the trial's start. The gaze is a success if both eyes' errors have been
below 1 px for a tenth of a second.

Only the step that ends a lost trial has a negative reward. In any state, continuing earns at least
0 and losing the target costs 25, whatever the discount, so losing the target never pays.

If the eye joints are coupled, precision and success use the reducible part of the errors, see
`vergence.envs.reducible`: a head is not judged by errors that its actuators cannot remove.
"""

from math import sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.envs.encoding import encode_observation
from vergence.envs.reading import BoolArray, Reading
from vergence.envs.reducible import reducible_error
from vergence.envs.streams import IntArray
from vergence.kernels import compiled, inlined
from vergence.models.head import HeadModel
from vergence.models.kinematics import PackedHead, pixel_error
from vergence.models.parts import FloatArray

TERMS: Final = ("tracking", "precision", "effort", "lost")
"""Names of the reward's terms, in the order of their array."""
LOST_AFTER_S: Final = 0.5
"""Time without both eyes seeing a target that has been seen, after which it is lost, s (chosen:
tolerance of dropped frames and turns against steps without a target)."""
FIRST_SEEN_WITHIN_S: Final = 1.5
"""Time after a trial's start at which a target that no eye has seen is lost, s (chosen: twice the
0.75 s until a target that appears after 0.6 s is seen, with an image delay of 0.13 s and a few
dropped frames)."""
SUCCESS_AFTER_S: Final = 0.1
"""Time with both errors below `SETTLED_PX` that makes a success, s (chosen: a settled gaze against
one that passes the target)."""
SETTLED_PX: Final = 1.0
"""Bound of the band of settled pixel errors, px (chosen: precision against detection noise)."""

# pixel errors that halve a part of the reward: while turning, while braking, at rest (chosen: a
# gradient at every distance)
_TURNING_ERROR_PX: Final = 100.0
_BRAKING_ERROR_PX: Final = 10.0
_RESTING_ERROR_PX: Final = 1.0

_EFFORT_WEIGHT: Final = 0.01
"""Weight of the effort term (chosen: calm actions against fast turns)."""
_LOST_COST: Final = 25.0
"""Cost of a lost target (chosen: weight of a loss against the reward of a trial)."""


class TimeLimits(NamedTuple):
    """Time limits for a lost target and for a success, rounded to whole control periods."""

    lost_after_s: float
    """Time without both eyes seeing a target that has been seen, after which it is lost, s."""
    first_seen_within_s: float
    """Time after which a target that no eye has seen is lost, s."""
    success_after_s: float
    """Time with both errors in the band after which the gaze is a success, s."""
    period_s: float
    """Control period, s."""

    @classmethod
    def of(cls, head: HeadModel) -> "TimeLimits":
        """The rules at a head's control rate."""
        rate, period_s = head.timing.control_rate_hz, head.timing.period_s
        limits = (LOST_AFTER_S, FIRST_SEEN_WITHIN_S, SUCCESS_AFTER_S)
        lost, first, success = (period_s * max(1, round(limit * rate)) for limit in limits)
        return cls(lost, first, success, period_s)


class TrialProgress(NamedTuple):
    """Progress of the running trials: visibility and settling of the target so far."""

    seen: BoolArray
    """(n,) True once an eye has seen the target."""
    seen_s: FloatArray
    """(n,) last time at which both eyes saw the target, s; at first one period before the first eye
    saw it."""
    unsettled_s: FloatArray
    """(n,) last time at which not both errors were in the band, s; at first one period before the
    trial's start."""

    @classmethod
    def empty(cls, num: int) -> "TrialProgress":
        """Arrays for `num` trials, to be initialised by `begin`."""
        return cls(np.zeros(num, dtype=np.bool_), np.zeros(num), np.zeros(num))

    def begin(self, ids: IntArray, period_s: float) -> None:
        """Begin trials in the environments with indices `ids`, (m,)."""
        self.seen[ids] = False
        self.seen_s[ids] = self.unsettled_s[ids] = -period_s


class StepResult(NamedTuple):
    """Result of a step."""

    observation: NDArray[np.float32]
    """(n, size) see `vergence.envs.layout.ObservationLayout`."""
    error: FloatArray
    """(n, 2, 2) measured pixel errors of the newest images, px; nan if not visible."""
    terms: FloatArray
    """(n, 4) terms of the reward, in the order of `TERMS`."""
    reward: FloatArray
    """(n,) sum of the terms."""
    success: BoolArray
    """(n,) True if both errors have been in the band for long enough."""
    lost: BoolArray
    """(n,) True if the target is lost."""

    @classmethod
    def empty(cls, num: int, size: int) -> "StepResult":
        """Arrays for `num` heads with observations of this size."""
        return cls(
            observation=np.zeros((num, size), dtype=np.float32),
            error=np.full((num, 2, 2), np.nan),
            terms=np.zeros((num, len(TERMS))),
            reward=np.zeros(num),
            success=np.zeros(num, dtype=np.bool_),
            lost=np.zeros(num, dtype=np.bool_),
        )


@inlined
def _norm(u: float, v: float) -> float:
    return sqrt(u * u + v * v)


@compiled
def compute_step_result(
    ids: IntArray,
    head: PackedHead,
    scaling: FloatArray,
    time_limits: TimeLimits,
    reading: Reading,
    action: FloatArray,
    progress: TrialProgress,
    result: StepResult,
    coupled_head: PackedHead | None,
) -> None:
    """Compute observations, rewards and terminations of some environments of a batch.

    Args:
        ids: (m,) environment indices.
        head: (PACKED,) the head that the controller knows.
        scaling: (SCALING,) see `vergence.envs.encoding`.
        time_limits: time limits; `untyped_tuple`, as are all named tuples here.
        reading: sensor readings.
        action: (n, m) the actions applied.
        progress: updated in place.
        result: the result.
        coupled_head: the packed head again if its eye joints are coupled, else None; code for
            coupled joints is then not compiled.
    """
    time_limits, reading = TimeLimits(*time_limits), Reading(*reading)
    progress, result = TrialProgress(*progress), StepResult(*result)
    error, terms = result.error, result.terms
    m = action.shape[1]
    for n in ids:
        left, right = reading.visible[n, 0], reading.visible[n, 1]
        both = left and right
        tracking = precision = 0.0
        settled = both
        for eye in range(2):
            if not reading.visible[n, eye]:
                error[n, eye, 0] = error[n, eye, 1] = np.nan
                continue
            u, v = reading.pixels[n, eye, 0], reading.pixels[n, eye, 1]
            error[n, eye, 0], error[n, eye, 1] = pixel_error(head, eye, u, v)
        if both:
            goal = error[n]
            if coupled_head is not None:
                q, goal = reading.positions_at_exposure[n], np.empty((2, 2))
                reducible_error(coupled_head, q, error[n], left, right, goal)
            for eye in range(2):
                size = _norm(error[n, eye, 0], error[n, eye, 1])
                tracking += (
                    _BRAKING_ERROR_PX / (_BRAKING_ERROR_PX + size)
                    + _TURNING_ERROR_PX / (_TURNING_ERROR_PX + size)
                ) / 6.0
                size = _norm(goal[eye, 0], goal[eye, 1])
                precision += _RESTING_ERROR_PX / (_RESTING_ERROR_PX + size) / 6.0
                settled = settled and size < SETTLED_PX
        encode_observation(
            result.observation[n], scaling, error[n], reading, n, action[n], coupled_head
        )
        square = 0.0
        for j in range(m):
            square += action[n, j] * action[n, j]
        first = (left or right) and not progress.seen[n]
        progress.seen[n] = progress.seen[n] or first
        # half a period of tolerance, so that rounding of the times does not matter
        now_s, later_s = reading.time_s[n], reading.time_s[n] + 0.5 * time_limits.period_s
        if both:
            progress.seen_s[n] = now_s
        elif first:
            progress.seen_s[n] = now_s - time_limits.period_s
        if not settled:
            progress.unsettled_s[n] = now_s
        if progress.seen[n]:
            result.lost[n] = later_s - progress.seen_s[n] >= time_limits.lost_after_s
        else:
            result.lost[n] = later_s >= time_limits.first_seen_within_s
        result.success[n] = later_s - progress.unsettled_s[n] >= time_limits.success_after_s
        terms[n, 0], terms[n, 1] = tracking, precision
        terms[n, 2] = -_EFFORT_WEIGHT * (tracking + precision) * square / m
        terms[n, 3] = -_LOST_COST if result.lost[n] else 0.0
        result.reward[n] = terms[n, 0] + terms[n, 1] + terms[n, 2] + terms[n, 3]
