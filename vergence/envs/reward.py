r"""Observation, reward and termination of the gaze task, from readings alone.

Per step, with e the norm of an eye's measured pixel error:

    tracking  = -1/2 sum over eyes of e / (e + 20 px), and -1/2 for an eye that does not see
    precision = +1/2 for each eye with e < 1 px
    effort    = -0.01 times the mean square of the action
    lost      = -25, once, when the episode ends for a lost target

The sum is the reward. Before the first image in which an eye sees the target, tracking is 0.
A target counts as lost once it has been seen and then some eye has not seen it for half a second.
Success is both eyes' error below 1 px for a tenth of a second.
"""

from math import sqrt
from typing import Any, Final

import numpy as np

from vergence._jit import compiled
from vergence.envs.layout import encode
from vergence.models.camera import pixel_error

TERMS: Final = ("tracking", "precision", "effort", "lost")
"""The reward's terms, in the order of their array."""
LOST_AFTER_S: Final = 0.5
SUCCESS_AFTER_S: Final = 0.1
SETTLED_PX: Final = 1.0
_HALF_TRACKING_PX: Final = 20.0
_EFFORT: Final = 0.01
_LOST: Final = 25.0


@compiled
def assess(
    ids: Any, head: Any, scaling: Any, latency_s: float, lost_after: int, success_after: int,
    action: Any, time_s: Any, pixels: Any, visible: Any, received_s: Any, at_exposure: Any,
    positions: Any, velocities: Any, seen: Any, unseen_steps: Any, settled_steps: Any,
    observation: Any, error: Any, terms: Any, reward: Any, success: Any, lost: Any,
) -> None:  # fmt: skip
    """Make observations, rewards and terminations of some places of a batch.

    Args:
        ids: (m,) the places.
        head: (PACKED,) the head that the controller knows.
        scaling: the layout's constants.
        latency_s: nominal latency of an image, s.
        lost_after: steps without seeing after which a target is lost.
        success_after: steps within the band after which the gaze is a success.
        action: (n, 4) the actions taken.
        time_s: (n,) see `Reading`, as are the following six.
        pixels: (n, 2, 2).
        visible: (n, 2).
        received_s: (n,).
        at_exposure: (n, 7).
        positions: (n, 7).
        velocities: (n, 7).
        seen: (n,) state: whether the target has been seen.
        unseen_steps: (n,) state: for how many steps an eye has not seen it.
        settled_steps: (n,) state: for how many steps both errors have been in the band.
        observation: (n, SIZE) result.
        error: (n, 2, 2) result: measured pixel errors, px.
        terms: (n, 4) result.
        reward: (n,) result.
        success: (n,) result.
        lost: (n,) result.
    """
    for n in ids:
        both_seen = visible[n, 0] and visible[n, 1]
        seen[n] = seen[n] or visible[n, 0] or visible[n, 1]
        tracking = precision = 0.0
        for eye in range(2):
            if not visible[n, eye]:
                tracking -= 0.5 if seen[n] else 0.0
                error[n, eye, 0] = error[n, eye, 1] = np.nan
                continue
            du, dv = pixel_error(head, eye, pixels[n, eye, 0], pixels[n, eye, 1])
            error[n, eye, 0], error[n, eye, 1] = du, dv
            size = sqrt(du * du + dv * dv)
            tracking -= 0.5 * size / (size + _HALF_TRACKING_PX)
            if size < SETTLED_PX:
                precision += 0.5
        encode(
            observation[n], scaling, error[n], visible[n], time_s[n] - received_s[n] + latency_s,
            positions[n], at_exposure[n], velocities[n], action[n],
        )  # fmt: skip
        square = 0.0
        for j in range(4):
            square += action[n, j] * action[n, j]
        unseen_steps[n] = unseen_steps[n] + 1 if seen[n] and not both_seen else 0
        settled_steps[n] = settled_steps[n] + 1 if precision == 1.0 else 0
        lost[n] = unseen_steps[n] >= lost_after
        success[n] = settled_steps[n] >= success_after
        terms[n, 0], terms[n, 1], terms[n, 2] = tracking, precision, -_EFFORT * square / 4.0
        terms[n, 3] = -_LOST if lost[n] else 0.0
        reward[n] = terms[n, 0] + terms[n, 1] + terms[n, 2] + terms[n, 3]
