r"""The present error from an old image: a Smith predictor on the head's kinematics.

An image that was exposed d ago tells which joint angles fixate the target, `g = q(t - d) + a`: a is
what the eyes still had to turn at the exposure, from both pixels, their triangulated point and
the eyes' kinematics. The goal g belongs to the target, not to the eyes: while the target rests it
stays, and what is left to turn is g less the angles, whatever the eyes did since the exposure.
A command that is given now acts when the head's latencies have passed. So what counts are the
angles that the eyes will have then: those that are read now, carried on through the commands that
are still under way. Where actuators tie the eyes' joints, what is left for each of them to turn
follows from the goals of all joints, see `vergence.controllers.prediction.aim`.

All times are those in which the joints are read, so that of two latencies only what they are
together has to be known: that of a command and of the reading that shows it, and that of an image
less that of the joints. Both are found on line, with lag, acceleration and speed gains, see
`vergence.controllers.prediction.dating` and `vergence.controllers.prediction.response`. Goals are
filtered from image to image, see `vergence.controllers.prediction.goals`.
"""

from math import exp, isfinite, sqrt
from typing import Annotated, Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence._jit import compiled, device
from vergence.controllers.freshness import is_fresh
from vergence.controllers.prediction.aim import aim
from vergence.controllers.prediction.aiming import aim_ahead, present_error
from vergence.controllers.prediction.goals import take_image
from vergence.controllers.prediction.joints import RIG, Rig, joint_rig
from vergence.controllers.prediction.memory import MEMORY, SIZE, Memory, initial_row, track
from vergence.controllers.prediction.play import cross_play
from vergence.controllers.prediction.response import answer_of, longest_latency, when_next_acts
from vergence.controllers.prediction.swinging import forget, watch
from vergence.controllers.prediction.virtual_joints import two_joints_an_eye
from vergence.controllers.rows import named, row_layout, row_size
from vergence.envs.layout import Observation, ObservationLayout
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.packed import PackedHead, is_direct, joint_at
from vergence.models.parts import FloatArray

LONGEST_S: Final = 0.25
"""The longest nominal delay of an image."""
_AHEAD_S: Final = 0.01
_LATER: Final = 0.5
"""By how many standard deviations the response is taken to be later than it is likely to be."""
HOLD_S: Final = 1.0
"""How long the goal of an eye that does not see is held."""


class Prediction(NamedTuple):
    """Where the eyes are to turn, when the command that is given now begins to act.

    What is to be turned is by actuator of the eyes, which is by joint where each of the four eye
    joints has a motor of its own.
    """

    to_go: FloatArray
    """(..., 4) angles that each actuator then still has to turn, rad; 0 for one that moves no eye
    whose target is known."""
    pixel_error: FloatArray
    """(..., 2, 2) what the pixel errors are then, undistorted, px; nan where not known."""
    delay_s: FloatArray
    """(...) the delay from exposure to reading less that of the joints, s."""
    known: NDArray[np.bool_]
    """(..., 2) whether each eye's target is known: seen now or a short while ago."""
    positions: FloatArray
    """(..., 4) angles of the eyes' joints then, rad."""
    velocities: FloatArray
    """(..., 4) velocities of the actuators then, rad/s."""
    accelerations: FloatArray
    """(..., 4) their accelerations then, rad/s^2."""
    lag_s: FloatArray
    """(...) the lag with which velocities follow their commands, s: that of the head's timing,
    of which an actuator may have a multiple of its own."""
    build_up: FloatArray
    """(...) its build-up, see `vergence.controllers.prediction.response`; 0 for a lag of first
    order."""
    actuators: FloatArray
    """(..., 4) angles of the actuators then, rad."""
    latency_s: FloatArray
    """(...) the latency of command and reading together, s."""
    latency_sd_s: FloatArray
    """(...) its standard deviation, s."""
    acceleration_ratio: FloatArray
    """(...) the greatest accelerations by those of the head's model."""
    acceleration_sd: FloatArray
    """(...) the standard deviation of its logarithm."""
    speed_gain: FloatArray
    """(..., 4) speeds at rest by command."""
    rates: FloatArray
    """(..., 4) how fast what is to be turned grows while the actuators rest, rad/s; 0 for targets
    at rest."""
    later_rates: FloatArray
    """(..., 4) the same when a command that is given now shows, a lag and half a period later."""
    noise_rad: FloatArray
    """(...) the detections' noise by the focal length, standard deviation, rad."""
    misfit: FloatArray
    """(...) mean square of what the response leaves of a motion, by its variance; 0 before the
    first window has ended in which it is found."""
    swings: FloatArray
    """(...) half swings about the goals that have been too many, see
    `vergence.controllers.prediction.swinging`."""


class _Present:
    """The row of one head's `Prediction`."""

    to_go: Annotated[FloatArray, 4]
    pixel_error: Annotated[FloatArray, 2, 2]
    known: Annotated[FloatArray, 2]
    positions: Annotated[FloatArray, 4]
    velocities: Annotated[FloatArray, 4]
    accelerations: Annotated[FloatArray, 4]
    actuators: Annotated[FloatArray, 4]
    speed_gain: Annotated[FloatArray, 4]
    rates: Annotated[FloatArray, 4]
    later_rates: Annotated[FloatArray, 4]
    delay_s: float
    lag_s: float
    build_up: float
    latency_s: float
    latency_sd_s: float
    acceleration_ratio: float
    acceleration_sd: float
    noise_rad: float
    misfit: float
    swings: float


_PRESENT: Final = row_layout(_Present)
_NUMBERS: Final = row_size(_PRESENT)


class Predictor:
    """Turns old images into present errors, for any number of heads.

    Args:
        head: the model of the head.
        layout: the layout of observations.
        delay: `nominal` dates images by the head's own latency, `estimated` begins there and
            finds the delay on line, see `vergence.controllers.prediction.dating`.
        lag: the same of the actuators' response to their commands, see
            `vergence.controllers.prediction.response`.
        moving: whether targets may move; where they only jump it knows more of them otherwise.

    Raises:
        ConfigurationError: an option has a value that cannot be, or the head's latency is
            longer than 0.25 s.
    """

    def __init__(
        self,
        *,
        head: HeadModel,
        layout: ObservationLayout,
        delay: Literal["estimated", "nominal"] = "estimated",
        lag: Literal["estimated", "nominal"] = "estimated",
        moving: bool = True,
    ) -> None:
        for name, value in (("delay", delay), ("lag", lag)):
            if value not in ("estimated", "nominal"):
                raise ConfigurationError(
                    f"{name}: expected 'estimated' or 'nominal', got {value!r}"
                )
        if head.timing.latency_s > LONGEST_S + 1e-9:
            raise ConfigurationError(
                f"head: expected a latency of at most {LONGEST_S:g} s, "
                f"got {head.timing.latency_s:g} s"
            )
        self.head = head
        self.layout = layout
        self._packed = two_joints_an_eye(head)
        self.rig = joint_rig(head, moving)
        self._learn_delay = delay == "estimated"
        self._learn_response = lag == "estimated"
        self._initial = initial_row(
            self.rig, head.timing.exposure_stamps, self._learn_delay, self._learn_response
        )

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        # an array that was pickled can be written: the kernels would be compiled anew for it
        self._packed = two_joints_an_eye(self.head)

    @property
    def size(self) -> int:
        """Length of a head's state."""
        return SIZE

    def initial(self) -> FloatArray:
        """(size,) the state before the first observation."""
        return self._initial.copy()

    def update(self, seen: Observation, state: FloatArray) -> Prediction:
        """Take one control period's observation.

        Args:
            seen: the observation of some heads.
            state: (..., size or more) their states, changed in place; C-contiguous float64.
                What follows a state in its row is the caller's, and stays as it is.

        Returns:
            What is left to turn at present.
        """
        leading = state.shape[:-1]
        rows = state.reshape(-1, state.shape[-1])
        present = np.empty((*leading, _NUMBERS))
        _update(
            rows,
            np.ascontiguousarray(seen.positions).reshape(-1, 7),
            np.ascontiguousarray(seen.velocities).reshape(-1, 7),
            np.ascontiguousarray(seen.last_command).reshape(-1, 4),
            np.ascontiguousarray(seen.image_age_s).reshape(-1),
            np.ascontiguousarray(seen.pixel_error).reshape(-1, 2, 2),
            self.rig,
            self._packed,
            self._learn_delay,
            self._learn_response,
            present.reshape(-1, _NUMBERS),
        )
        if not self.head.actuation.direct:
            _aim(rows, self.rig, self._packed, present.reshape(-1, _NUMBERS))
        fields: Any = present.view(_PRESENT)[..., 0]
        told: dict[str, Any] = {name: fields[name] for name in Prediction._fields}
        return Prediction(**{**told, "known": told["known"] > 0.5})


@device
def _see(
    memory: Memory, rig: Rig, age_s: float, error: FloatArray, p: PackedHead, learn_delay: bool
) -> None:
    """Take in the newest image if it is new, and forget goals that none has shown for long."""
    fresh = is_fresh(age_s, memory.image_age_s, rig.period_s)
    memory.image_age_s = age_s
    for eye in range(2):
        memory.unseen[eye] += 1.0
        if fresh and isfinite(error[eye, 0]) and isfinite(error[eye, 1]):
            memory.unseen[eye] = 0.0
    if memory.unseen[0] == 0.0 or memory.unseen[1] == 0.0:
        take_image(memory, rig, error, p, learn_delay)
    for eye in range(2):
        unseen = memory.unseen[eye]
        if rig.follows > 0.5 and memory.ways[0] < 0.5:  # the other eye tells
            unseen = min(unseen, memory.unseen[1 - eye])
        if unseen > round(HOLD_S / rig.period_s):
            memory.known[eye] = 0.0


@device
def _tell(memory: Memory, rig: Rig, p: PackedHead, present: _Present) -> None:
    """What is left to turn when the next command acts."""
    response, direct = memory.response, is_direct(p)
    answer = answer_of(response)
    sd = sqrt(max(answer.variance[0], 0.0))
    latency = min(answer.found[0] + _LATER * sd, longest_latency(rig))
    for j in range(4):
        q, v = memory.actuators[j], memory.velocity[j]
        q, v, w = when_next_acts(response, rig, int(memory.count), j, q, v, latency)
        present.actuators[j] = min(max(q, rig.lower[j]), rig.upper[j])
        present.velocities[j], present.accelerations[j] = v, w
        present.speed_gain[j] = exp(answer.gain[j])
    aim_ahead(memory, rig, memory.count + latency / rig.period_s)
    for j in range(4):
        present.positions[j] = present.actuators[j]
        if not direct:
            present.positions[j] = joint_at(p, j, present.actuators)
    for eye in range(2):
        present.known[eye] = memory.known[eye]
        first, second = present.positions[2 * eye], present.positions[2 * eye + 1]
        u, v = present_error(memory, p, eye, first, second)
        present.pixel_error[eye, 0], present.pixel_error[eye, 1] = u, v
    for j in range(4):
        present.to_go[j] = present.rates[j] = present.later_rates[j] = 0.0
        # where actuators tie joints, `_aim` tells it
        if direct and present.known[j // 2] > 0.5:
            aim, rate = memory.aims[j // 2, j % 2], memory.rates[j // 2, j % 2]
            goal = min(max(aim, rig.lower[j]), rig.upper[j])
            present.to_go[j] = goal - present.actuators[j]
            if goal == aim:
                present.rates[j] = rate
                present.later_rates[j] = memory.later_rates[j // 2, j % 2]
    present.delay_s, present.lag_s = memory.delay_s, exp(answer.found[2])
    present.build_up = answer.found[3]
    present.latency_s, present.latency_sd_s = answer.found[0], sd
    present.acceleration_ratio = exp(answer.found[1])
    present.acceleration_sd = sqrt(max(answer.variance[1], 0.0))
    present.noise_rad = sqrt(memory.noise)
    present.misfit = answer.misfit if response.windows > 0.5 else 0.0
    present.swings = memory.swinging.count


@compiled
def _update(
    rows: FloatArray,
    positions: FloatArray,
    velocities: FloatArray,
    command: FloatArray,
    age_s: FloatArray,
    error: FloatArray,
    rig_row: FloatArray,
    p: PackedHead,
    learn_delay: bool,
    learn_response: bool,
    present_rows: FloatArray,
) -> None:
    rig: Rig = named(rig_row, RIG)
    for n in range(rows.shape[0]):
        memory: Memory = named(rows[n][:SIZE], MEMORY)
        track(memory, rig, p, positions[n], velocities[n], command[n], learn_response)
        _see(memory, rig, age_s[n], error[n], p, learn_delay)
        cross_play(memory, p, command[n])
        forget(memory.swinging, rig.period_s)
        for eye in range(2):
            for joint in range(2 if memory.known[eye] > 0.5 else 0):
                q = joint_at(p, 2 * eye + joint, memory.actuators)
                aim = memory.aims[eye, joint]
                watch(memory.swinging, rig, eye, joint, q, aim, memory.noise)
        _tell(memory, rig, p, named(present_rows[n], _PRESENT))


@compiled
def _aim(rows: FloatArray, rig_row: FloatArray, p: PackedHead, present_rows: FloatArray) -> None:
    """What is left to turn where actuators tie the eyes' joints."""
    rig: Rig = named(rig_row, RIG)
    goals, then, jacobian = np.zeros(4), np.zeros(4), np.zeros((2, 2, 2))
    later, shown = np.zeros((2, 2)), np.zeros(4)
    for n in range(rows.shape[0]):
        memory: Memory = named(rows[n][:SIZE], MEMORY)
        present: _Present = named(present_rows[n], _PRESENT)
        left, right = present.known[0] > 0.5, present.known[1] > 0.5
        if not (left or right):
            continue
        depth_l, depth_r = memory.fixated_depth[0], memory.fixated_depth[1]
        aim(p, memory.aims, depth_l, depth_r, left, right, present.actuators, jacobian, goals)
        moves = False
        for eye in range(2):
            for joint in range(2):
                moves = moves or memory.rates[eye, joint] != 0.0
        if moves:
            for eye in range(2):
                for joint in range(2):
                    way = _AHEAD_S * memory.rates[eye, joint]
                    later[eye, joint] = memory.aims[eye, joint] + way
            aim(p, later, depth_l, depth_r, left, right, present.actuators, jacobian, then)
            for eye in range(2):
                for joint in range(2):
                    way = _AHEAD_S * memory.later_rates[eye, joint]
                    later[eye, joint] = memory.aims[eye, joint] + way
            aim(p, later, depth_l, depth_r, left, right, present.actuators, jacobian, shown)
        for j in range(4):
            if rig.moves[j, 0] * present.known[0] + rig.moves[j, 1] * present.known[1] > 0.0:
                goal = min(max(goals[j], rig.lower[j]), rig.upper[j])
                present.to_go[j] = goal - present.actuators[j]
                if moves and goal == goals[j]:
                    present.rates[j] = (then[j] - goals[j]) / _AHEAD_S
                    present.later_rates[j] = (shown[j] - goals[j]) / _AHEAD_S
