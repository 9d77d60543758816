"""Reward and termination of the gaze task, computed from readings alone.

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
`reducible_error`: a head is not judged by errors that its actuators cannot remove.

With e the errors of both images, J the eyes' image Jacobian and A the joint angles per actuator
angle, the reducible part is `J A (J A)^+ e`. No motion can reduce the rest of e. For coupled
joints, the best gaze (`HeadModel.fixate`) has this rest as its residual, and a reducible part of
zero.
"""

from math import isfinite, nan, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.envs.observation import ObservationLayout, encode_observation, view_scaling
from vergence.envs.reading import BoolArray, Reading
from vergence.envs.streams import IntArray
from vergence.kernels import compiled, inlined, subroutine
from vergence.models.fixation import actuator_least_squares, image_rate
from vergence.models.head import HeadModel
from vergence.models.kinematics import PackedHead, camera_of, eye_frames, eye_jacobian, pixel_error
from vergence.models.parts import SLOTS, FloatArray
from vergence.triangulation.rays import depths_on_rays, rays_from_pixel_errors


@subroutine
def image_jacobians(
    p: PackedHead, q: FloatArray, error: FloatArray, depth_m: float, left_visible: bool,
    right_visible: bool, jacobian: FloatArray,
) -> None:  # fmt: skip
    """Compute the image Jacobians of the eyes that see the target, at its pixels."""
    eyes = (eye_frames(p, 0, q[3], q[4]), eye_frames(p, 1, q[5], q[6]))
    depth_l = depth_r = depth_m
    if not isfinite(depth_m):
        ray_l, ray_r = rays_from_pixel_errors(p, eyes[0].camera, eyes[1].camera, error)
        depth_l, depth_r, _found = depths_on_rays(ray_l, ray_r)
    for eye in range(2):
        if right_visible if eye else left_visible:
            camera = camera_of(p, eye)
            u, v = camera.centre_u + error[eye, 0], camera.centre_v + error[eye, 1]
            depth = depth_r if eye else depth_l
            u1, u2, v1, v2 = eye_jacobian(p, eye, eyes[eye], u, v, depth)
            jacobian[eye, 0, 0], jacobian[eye, 0, 1] = u1, u2
            jacobian[eye, 1, 0], jacobian[eye, 1, 1] = v1, v2


@subroutine
def reducible_error_by_jacobian(
    p: PackedHead, jacobian: FloatArray, error: FloatArray, left_visible: bool, right_visible: bool,
    out: FloatArray,
) -> None:  # fmt: skip
    """Compute the reducible part of pixel errors from given image Jacobians."""
    share = np.zeros(SLOTS)
    actuator_least_squares(p, jacobian, error, left_visible, right_visible, share)
    for eye in range(2):
        seen = right_visible if eye else left_visible
        for axis in range(2):
            out[eye, axis] = image_rate(p, jacobian, eye, axis, share) if seen else nan


@inlined
def reducible_error(
    p: PackedHead, q: FloatArray, error: FloatArray, left_visible: bool, right_visible: bool,
    out: FloatArray,
) -> None:  # fmt: skip
    """Compute the reducible part of pixel errors at the triangulated depth."""
    jacobian = np.zeros((2, 2, 2))
    image_jacobians(p, q, error, nan, left_visible, right_visible, jacobian)
    reducible_error_by_jacobian(p, jacobian, error, left_visible, right_visible, out)


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


class TrialProgress(NamedTuple):
    """Progress of the running trials: visibility and settling of the target so far."""

    seen: BoolArray  # (n,) True once an eye has seen the target
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

    observation: NDArray[np.float32]  # (n, size) see `vergence.envs.observation.ObservationLayout`
    error: FloatArray
    """(n, 2, 2) measured pixel errors of the newest images, px; nan if not visible."""
    terms: FloatArray  # (n, 4) terms of the reward, in the order of `TERMS`
    reward: FloatArray  # (n,) sum of the terms
    success: BoolArray  # (n,) True if both errors have been in the band for long enough
    lost: BoolArray  # (n,) True if the target is lost

    @classmethod
    def empty(cls, num: int, size: int) -> "StepResult":
        """Arrays for `num` heads with observations of this size."""
        return cls(
            observation=np.zeros((num, size), dtype=np.float32), error=np.full((num, 2, 2), np.nan),
            terms=np.zeros((num, len(TERMS))), reward=np.zeros(num),
            success=np.zeros(num, dtype=np.bool_), lost=np.zeros(num, dtype=np.bool_),
        )  # fmt: skip


@inlined
def _norm(u: float, v: float) -> float:
    return sqrt(u * u + v * v)


LIMIT: Final = 1
"""Phase of a step, one bit: limit the requested actions, and convert them to commands
(numerical)."""
JUDGE: Final = 2
"""Phase, one bit: compute observations, rewards and ends from the reading (numerical)."""


class TaskArrays(NamedTuple):
    """Actions, commands and results of a batch of gaze tasks, and the rules that they follow."""

    requested: FloatArray  # (n, m) actions as requested, for the m actuators
    action: FloatArray  # (n, m) actions as applied, limited to [-1, 1]
    command: FloatArray
    """(n, 7) velocities commanded by them, rad/s; see `vergence.envs.plant.Plant.step`."""
    action_limits: FloatArray  # (4,) velocities of full actions, rad/s; 0 beyond the first m
    head: PackedHead  # (PACKED,) the head that the controller knows
    scaling: FloatArray  # (SCALING,) see `vergence.envs.observation`
    period_s: float
    limits_s: tuple[float, float, float]
    """`LOST_AFTER_S`, `FIRST_SEEN_WITHIN_S`, `SUCCESS_AFTER_S` in whole control periods, s."""
    progress: TrialProgress
    result: StepResult
    coupled_head: PackedHead | None
    """The packed head again if its eye joints are coupled, else None; code for coupled joints is
    then not compiled."""

    @classmethod
    def empty(cls, head: HeadModel, num: int) -> "TaskArrays":
        """Arrays for `num` heads, before their trials begin."""
        layout, period_s = ObservationLayout.of(head), head.timing.period_s
        lost, first, success = (
            period_s * max(1, round(limit_s * head.timing.control_rate_hz))
            for limit_s in (LOST_AFTER_S, FIRST_SEEN_WITHIN_S, SUCCESS_AFTER_S)
        )
        return cls(
            requested=np.zeros((num, layout.count)), action=np.zeros((num, layout.count)),
            command=np.zeros((num, 7)), action_limits=layout.action_limits, head=head.packed,
            scaling=layout.scaling, period_s=period_s, limits_s=(lost, first, success),
            progress=TrialProgress.empty(num), result=StepResult.empty(num, layout.size),
            coupled_head=None if head.actuation.direct else head.packed,
        )  # fmt: skip


@subroutine
def limit_actions(ids: IntArray, task: TaskArrays) -> bool:
    """Limit requested actions and convert them to commands; False, and no change, if any is nan."""
    requested, action, command, limits = (
        task.requested, task.action, task.command, task.action_limits,
    )  # fmt: skip
    for n in range(requested.shape[0]):
        for j in range(requested.shape[1]):
            if requested[n, j] != requested[n, j]:
                return False
    for n in ids:
        for j in range(requested.shape[1]):
            action[n, j] = a = min(max(requested[n, j], -1.0), 1.0)
            command[n, 3 + j] = a * limits[j]
    return True


@inlined
def judge_steps(
    ids: IntArray, task: TaskArrays, coupled_head: PackedHead | None, reading: Reading
) -> None:
    """Compute observations, rewards and ends; an argument of None has no code compiled."""
    progress, result, period_s = task.progress, task.result, task.period_s
    lost_after_s, first_seen_within_s, success_after_s = task.limits_s
    # unpacked once, as numba would count references at each access in the loop
    head, scaling, action = task.head, view_scaling(task.scaling), task.action
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
                braking = _BRAKING_ERROR_PX / (_BRAKING_ERROR_PX + size)
                tracking += (braking + _TURNING_ERROR_PX / (_TURNING_ERROR_PX + size)) / 6.0
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
        now_s, later_s = reading.time_s[n], reading.time_s[n] + 0.5 * period_s
        if both:
            progress.seen_s[n] = now_s
        elif first:
            progress.seen_s[n] = now_s - period_s
        if not settled:
            progress.unsettled_s[n] = now_s
        if progress.seen[n]:
            result.lost[n] = later_s - progress.seen_s[n] >= lost_after_s
        else:
            result.lost[n] = later_s >= first_seen_within_s
        result.success[n] = later_s - progress.unsettled_s[n] >= success_after_s
        terms[n, 0], terms[n, 1] = tracking, precision
        terms[n, 2] = -_EFFORT_WEIGHT * (tracking + precision) * square / m
        terms[n, 3] = -_LOST_COST if result.lost[n] else 0.0
        result.reward[n] = terms[n, 0] + terms[n, 1] + terms[n, 2] + terms[n, 3]


@compiled
def advance_task(ids: IntArray, task: TaskArrays, reading: Reading, phases: int) -> bool:
    """Run the phases `LIMIT` and `JUDGE` of a step; False if an action is nan."""
    if phases & LIMIT and not limit_actions(ids, task):
        return False
    if phases & JUDGE:
        judge_steps(ids, task, task.coupled_head, reading)
    return True
