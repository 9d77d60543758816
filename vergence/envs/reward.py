r"""Observation, reward and termination of the gaze task, from readings alone.

Per step, with e the norm of an eye's measured pixel error:

    tracking  = mean over eyes of (10 px / (10 px + e) + 100 px / (100 px + e)) / 3
    precision = mean over eyes of (1 px / (1 px + e)) / 3
    effort    = -(tracking + precision) / 100 times the mean square of the action
    lost      = -25, once, when the episode ends for a lost target

The sum is the reward: at most 1. A step in which some eye does not see the target earns 0.

A target counts as lost once it has been seen and then some eye has not seen it for half a second,
and where no eye has seen it 1.5 s after the trial's start. Success is both eyes' error below 1 px
for a tenth of a second.

No step costs anything but the one that ends a lost trial. So whatever a trial has come to, going on
earns at least 0 and ending it costs 25, whatever the discount: losing the target cannot pay.

Where actuators tie the joints of the eyes, precision and success take the part of the errors that
the actuators can still take away, see `vergence.envs.reducible`: no head can do better than its
best.
"""

from math import sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence._jit import bare, compiled, device
from vergence.envs.encoding import encode
from vergence.envs.layout import ObservationLayout
from vergence.envs.reading import BoolArray, Reading
from vergence.envs.reducible import reducible_error
from vergence.envs.streams import IntArray
from vergence.models.camera import pixel_error
from vergence.models.files.head_file import load_head
from vergence.models.head import HeadModel
from vergence.models.packed import PackedHead
from vergence.models.parts import FloatArray

TERMS: Final = ("tracking", "precision", "effort", "lost")
"""The reward's terms, in the order of their array."""
LOST_AFTER_S: Final = 0.5
"""How long some eye may not see a target that has been seen."""
FIRST_SEEN_WITHIN_S: Final = 1.5
"""How long after a trial's start no eye may have seen the target: twice the 0.75 s that a target
which appears after 0.6 s needs to be seen, with an image delay of 0.13 s and a few lost frames."""
SUCCESS_AFTER_S: Final = 0.1
SETTLED_PX: Final = 1.0
# errors at which a part of the reward has fallen to half: while turning, braking, holding still
_FAR_PX: Final = 100.0
_NEAR_PX: Final = 10.0
_PRECISE_PX: Final = 1.0
_EFFORT: Final = 0.01
_LOST: Final = 25.0


class Rules(NamedTuple):
    """When a target counts as lost and a gaze as a success, in whole control periods."""

    lost_after_s: float
    """Time without seeing after which a target that has been seen is lost."""
    first_seen_within_s: float
    """Time after which a target that has never been seen is lost."""
    success_after_s: float
    """Time within the band after which the gaze is a success."""
    period_s: float
    """The control period."""

    @classmethod
    def of(cls, head: HeadModel) -> "Rules":
        """Those of a head's control rate."""
        rate, period_s = head.timing.control_rate_hz, head.timing.period_s
        limits = (LOST_AFTER_S, FIRST_SEEN_WITHIN_S, SUCCESS_AFTER_S)
        lost, first, success = (period_s * max(1, round(limit * rate)) for limit in limits)
        return cls(lost, first, success, period_s)


class Progress(NamedTuple):
    """What trials have come to so far."""

    seen: BoolArray
    """(n,) whether the target has been seen."""
    seen_s: FloatArray
    """(n,) when both eyes have seen it last; the period before one eye was the first to see it."""
    unsettled_s: FloatArray
    """(n,) when both errors have not been in the band last; the period before the trial's start."""

    @classmethod
    def empty(cls, num: int) -> "Progress":
        """Room for that of some trials, which `begin` fills."""
        return cls(np.zeros(num, dtype=np.bool_), np.zeros(num), np.zeros(num))

    def begin(self, ids: IntArray, period_s: float) -> None:
        """Begin the trials of some places, (m,)."""
        self.seen[ids] = False
        self.seen_s[ids] = self.unsettled_s[ids] = -period_s


class Outcome(NamedTuple):
    """What a step gives."""

    observation: NDArray[np.float32]
    """(n, size) see `vergence.envs.layout.ObservationLayout`."""
    error: FloatArray
    """(n, 2, 2) measured pixel errors of the newest images, px; nan where not seen."""
    terms: FloatArray
    """(n, 4) the parts of the reward, see `TERMS`."""
    reward: FloatArray
    """(n,) their sum."""
    success: BoolArray
    """(n,) whether both errors have been in the band for long enough."""
    lost: BoolArray
    """(n,) whether the target is lost."""

    @classmethod
    def empty(cls, num: int, size: int) -> "Outcome":
        """Room for that of some heads, whose observations have this size."""
        return cls(
            observation=np.zeros((num, size), dtype=np.float32),
            error=np.full((num, 2, 2), np.nan),
            terms=np.zeros((num, len(TERMS))),
            reward=np.zeros(num),
            success=np.zeros(num, dtype=np.bool_),
            lost=np.zeros(num, dtype=np.bool_),
        )


@device
def _norm(u: float, v: float) -> float:
    return sqrt(u * u + v * v)


@compiled
def assess(
    ids: IntArray,
    head: PackedHead,
    scaling: FloatArray,
    rules: Rules,
    reading: Reading,
    action: FloatArray,
    progress: Progress,
    outcome: Outcome,
    tied: PackedHead | None,
) -> None:
    """Make observations, rewards and terminations of some places of a batch.

    Args:
        ids: (m,) the places.
        head: (PACKED,) the head that the controller knows.
        scaling: the layout's constants.
        rules: `bare`, as are all named tuples here.
        reading: what the sensors report.
        action: (n, m) the actions taken.
        progress: brought up to date.
        outcome: the result.
        tied: the head again where actuators tie its eye joints: what that needs is compiled where
            it is needed alone.
    """
    rules, reading = Rules(*rules), Reading(*reading)
    progress, outcome = Progress(*progress), Outcome(*outcome)
    error, terms = outcome.error, outcome.terms
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
            if tied is not None:
                q, goal = reading.positions_at_exposure[n], np.empty((2, 2))
                reducible_error(tied, q, error[n], left, right, goal)
            for eye in range(2):
                size = _norm(error[n, eye, 0], error[n, eye, 1])
                tracking += (_NEAR_PX / (_NEAR_PX + size) + _FAR_PX / (_FAR_PX + size)) / 6.0
                size = _norm(goal[eye, 0], goal[eye, 1])
                precision += _PRECISE_PX / (_PRECISE_PX + size) / 6.0
                settled = settled and size < SETTLED_PX
        encode(outcome.observation[n], scaling, error[n], reading, n, action[n], tied)
        square = 0.0
        for j in range(m):
            square += action[n, j] * action[n, j]
        first = (left or right) and not progress.seen[n]
        progress.seen[n] = progress.seen[n] or first
        # by half a period later, so that no rounding of a sum of periods counts
        now_s, later_s = reading.time_s[n], reading.time_s[n] + 0.5 * rules.period_s
        if both:
            progress.seen_s[n] = now_s
        elif first:
            progress.seen_s[n] = now_s - rules.period_s
        if not settled:
            progress.unsettled_s[n] = now_s
        if progress.seen[n]:
            outcome.lost[n] = later_s - progress.seen_s[n] >= rules.lost_after_s
        else:
            outcome.lost[n] = later_s >= rules.first_seen_within_s
        outcome.success[n] = later_s - progress.unsettled_s[n] >= rules.success_after_s
        terms[n, 0], terms[n, 1] = tracking, precision
        terms[n, 2] = -_EFFORT * (tracking + precision) * square / m
        terms[n, 3] = -_LOST if outcome.lost[n] else 0.0
        outcome.reward[n] = terms[n, 0] + terms[n, 1] + terms[n, 2] + terms[n, 3]


def compile_assess() -> None:
    """Compile `assess` for heads whose eye joints have a motor each, by a call for no place."""
    head = load_head("simulated")
    layout, reading = ObservationLayout.of(head), bare(Reading.empty(1))
    progress, outcome = bare(Progress.empty(1)), bare(Outcome.empty(1, layout.size))
    action = np.zeros((1, layout.count))
    judged = (head.packed, layout.scaling, bare(Rules.of(head)))
    assess(np.arange(0), *judged, reading, action, progress, outcome, None)
