r"""Observation, reward and termination of the gaze task, from readings alone.

Per step, with e the norm of an eye's measured pixel error:

    tracking  = -1/2 sum over eyes of e / (e + 20 px), and -1/2 for an eye that does not see
    precision = +1/2 for each eye with e < 1 px
    effort    = -0.01 times the mean square of the action
    lost      = -25, once, when the episode ends for a lost target

The sum is the reward. Before the first image in which an eye sees the target, tracking is 0.
A target counts as lost once it has been seen and then some eye has not seen it for half a second.
Success is both eyes' error below 1 px for a tenth of a second.

Where actuators tie the joints of the eyes, precision and success take the part of the errors that
the actuators can still take away, see `vergence.envs.reducible`: no head can do better than its
best.
"""

from math import sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence._jit import bare, compiled
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
SUCCESS_AFTER_S: Final = 0.1
SETTLED_PX: Final = 1.0
_HALF_TRACKING_PX: Final = 20.0
_EFFORT: Final = 0.01
_LOST: Final = 25.0


class Rules(NamedTuple):
    """When a target counts as lost and a gaze as a success."""

    lost_after: int
    """Steps without seeing after which a target is lost."""
    success_after: int
    """Steps within the band after which the gaze is a success."""

    @classmethod
    def of(cls, head: HeadModel) -> "Rules":
        """Those of a head's control rate."""
        rate = head.timing.control_rate_hz
        return cls(max(1, round(LOST_AFTER_S * rate)), max(1, round(SUCCESS_AFTER_S * rate)))


class Progress(NamedTuple):
    """What trials have come to so far."""

    seen: BoolArray
    """(n,) whether the target has been seen."""
    unseen_steps: IntArray
    """(n,) for how many steps an eye has not seen it."""
    settled_steps: IntArray
    """(n,) for how many steps both errors have been in the band."""

    @classmethod
    def empty(cls, num: int) -> "Progress":
        """That of trials that begin."""
        return cls(
            seen=np.zeros(num, dtype=np.bool_),
            unseen_steps=np.zeros(num, dtype=np.int64),
            settled_steps=np.zeros(num, dtype=np.int64),
        )


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
        progress.seen[n] = progress.seen[n] or left or right
        tracking = precision = 0.0
        for eye in range(2):
            if not reading.visible[n, eye]:
                tracking -= 0.5 if progress.seen[n] else 0.0
                error[n, eye, 0] = error[n, eye, 1] = np.nan
                continue
            u, v = reading.pixels[n, eye, 0], reading.pixels[n, eye, 1]
            du, dv = pixel_error(head, eye, u, v)
            error[n, eye, 0], error[n, eye, 1] = du, dv
            size = sqrt(du * du + dv * dv)
            tracking -= 0.5 * size / (size + _HALF_TRACKING_PX)
            if tied is None and size < SETTLED_PX:
                precision += 0.5
        if tied is not None and (left or right):
            q, reducible = reading.positions_at_exposure[n], np.empty((2, 2))
            reducible_error(tied, q, error[n], left, right, reducible)
            for eye in range(2):
                du, dv = reducible[eye, 0], reducible[eye, 1]
                if sqrt(du * du + dv * dv) < SETTLED_PX:
                    precision += 0.5
        encode(outcome.observation[n], scaling, error[n], reading, n, action[n], tied)
        square = 0.0
        for j in range(m):
            square += action[n, j] * action[n, j]
        both = left and right
        unseen = progress.unseen_steps[n] + 1 if progress.seen[n] and not both else 0
        settled = progress.settled_steps[n] + 1 if precision == 1.0 else 0
        progress.unseen_steps[n], progress.settled_steps[n] = unseen, settled
        outcome.lost[n] = unseen >= rules.lost_after
        outcome.success[n] = settled >= rules.success_after
        terms[n, 0], terms[n, 1], terms[n, 2] = tracking, precision, -_EFFORT * square / m
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
