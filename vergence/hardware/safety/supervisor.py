"""The supervisor of a robot head: turns a policy's requested velocities into safe commands.

It reads no clock and touches no hardware. In each period the plant passes it the robot's state and
the requested velocities, sends the command that it returns, and reports what was sent. A stop
latches: from then on all commands brake, until the plant is released.
"""

from collections import deque
from enum import Enum
from math import cos, pi, sin, sqrt, tan
from typing import Final, NamedTuple

import numpy as np

from vergence.envs.reading import BoolArray
from vergence.hardware.safety.following import FollowingMonitor
from vergence.hardware.safety.limits import (
    JointMotionLimiter,
    SafetyConfig,
    find_containing_posture,
)
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, EYES, NECK, FloatArray

_MIN_HALF_SWING_RAD: Final = 0.02
"""Least half swing, rad: a target that jitters by 10 px moves a webcam's eye less (chosen)."""
_MIN_PEAK_SPEED_RAD_S: Final = 0.3
"""Least peak speed of a half swing, taken as a sinusoid, rad/s (chosen)."""
_OSCILLATION_HALF_SWINGS: Final = 8
"""Half swings of one joint in the window that count as an oscillation: four cycles (chosen)."""
_WINDOW_S: Final = 4.0
"""Length of the window, s (chosen)."""


class _Swings:
    """Detector of an eye joint that swings to and fro although its goal rests."""

    def __init__(self) -> None:
        self._side = self._turned_s = 0.0
        self._turned = self._farthest = np.nan
        self._goals = np.nan, np.nan  # least and greatest since it turned round last
        self._counted: deque[float] = deque()

    def update(self, now_s: float, angle: float, goal: float) -> bool:
        """True if the joint oscillates; `goal`, nan if unknown, looks straight at the target."""
        self._goals = np.fmin(self._goals[0], goal), np.fmax(self._goals[1], goal)
        if self._turns(now_s, angle):
            swing_rad = abs(self._farthest - self._turned)
            time_s = now_s - self._turned_s
            fast = 0.5 * pi * swing_rad > _MIN_PEAK_SPEED_RAD_S * time_s
            # a nan, without any goal, counts as a goal that rests
            if fast and max(0.0, self._goals[1] - self._goals[0]) < 0.5 * swing_rad:
                self._counted.append(now_s)
            self._side, self._goals = -self._side, (goal, goal)
            self._turned, self._turned_s, self._farthest = self._farthest, now_s, angle
        while self._counted and now_s - self._counted[0] > _WINDOW_S:
            self._counted.popleft()
        return len(self._counted) >= _OSCILLATION_HALF_SWINGS

    def _turns(self, now_s: float, angle: float) -> bool:
        """True if the joint has turned round since its farthest angle."""
        if np.isnan(self._farthest):
            self._turned = self._farthest = angle
        back = self._side * (self._farthest - angle)
        if self._side == 0.0 and abs(angle - self._farthest) > _MIN_HALF_SWING_RAD:
            self._side = np.sign(angle - self._farthest)
            self._farthest, self._turned_s = angle, now_s
        elif self._side and back <= 0.0:
            self._farthest = angle
        return back >= _MIN_HALF_SWING_RAD


_FIXATION_DISTANCE_M: Final = 1.0
"""Distance of the fixation point along z, m (chosen)."""
_SPIRAL_PITCH_RAD: Final = 0.15
"""Distance between two turns of the spiral, rad: a quarter of a webcam's height (chosen)."""
_MAX_RADIUS_RAD: Final = 0.7
"""Radius at which the spiral restarts at its centre, rad (chosen)."""
_SPIRAL_SPEED_RAD_S: Final = 0.4
"""Speed along the spiral, rad/s: a short exposure still shows the target (chosen)."""
_GAIN: Final = 4.0
"""Gain of the joints towards the point of the spiral, 1/s (chosen)."""


class _SpiralSearch:
    """A slow spiral of the gaze."""

    def __init__(self, head: HeadModel) -> None:
        self._head = head
        self._goal = head.actuation.actuators_of(head.rest())

    def velocities(self, time_s: float, angles: FloatArray, joints: FloatArray) -> FloatArray:
        """(7,) velocities, rad/s, a time after its begin, at angles of actuators and joints."""
        # an Archimedean spiral r = c phi: its arc is about c phi^2 / 2
        pitch = _SPIRAL_PITCH_RAD / (2.0 * pi)
        phi = sqrt(2.0 * _SPIRAL_SPEED_RAD_S * time_s / pitch) % (_MAX_RADIUS_RAD / pitch)
        across, along = pitch * phi * cos(phi), pitch * phi * sin(phi)
        point = _FIXATION_DISTANCE_M * np.array([tan(across), tan(along), 1.0])
        goal = self._head.fixate(point, joints[NECK], warn=False)
        if np.isfinite(goal).all():
            self._goal = self._head.actuation.actuators_of(goal)
        most = 2.0 * _SPIRAL_SPEED_RAD_S
        requested = np.clip(_GAIN * (self._goal - angles), -most, most)
        requested[NECK] = 0.0
        return np.asarray(requested)


OSCILLATION_REASON: Final = "policy: expected joints that come to rest at a target that rests"
"""Beginning of the stop's reason if the policy makes the head oscillate."""
MAX_READING_AGE_S: Final = 0.15
"""Age of the joint angles above which the head stops, s (chosen)."""
_UNPROVED_SPEED_RATIO: Final = 0.1
"""Greatest speed of a joint not yet proved to follow, as a fraction of its limit (chosen)."""
_MIN_UNPROVED_SPEED_RAD_S: Final = 0.2
"""Least value of that speed, rad/s: slow enough for any joint (chosen)."""
_MAX_AGE_PERIODS: Final = 2.0
"""Greatest age of an angle that is compared with the limits, control periods (chosen)."""
_LIMIT_VIOLATION_RAD: Final = 0.05
"""Distance beyond a limit that no command can cause, rad: the joint was pushed (chosen)."""
_OVERRUN_WINDOW_S: Final = 2.0
"""Time over which missed periods are counted, s (chosen)."""
_LATE_FRACTION: Final = 0.1
"""Fraction of missed periods above which a fault may be their consequence (chosen)."""


class Verdict(Enum):
    """Verdict on the requested velocities."""

    GO = "go"  # send them as far as the bounds allow
    HOLD = "hold"  # hold still until the target is visible again
    SEARCH = "search"  # search for the target
    STOP = "stop"  # rest until released


class RobotState(NamedTuple):
    """Present state of the robot, the input of the supervisor.

    Actuators are the neck's joints and the actuators of the eyes.
    """

    now_s: float
    """Present time, s of a monotonic clock."""
    actuator_angles: FloatArray
    """(7,) rad."""
    actuator_speeds: FloatArray
    """(7,) measured, rad/s."""
    joint_angles: FloatArray
    """(7,) rad."""
    reading_age_s: FloatArray
    """(7,) time since each servo's last answer, during which its angle is extrapolated, s."""
    images_received_s: FloatArray | None
    """(2,) time of receipt of each eye's newest image, on the clock of `now_s`, s; None outside of
    trials, where late images are no fault."""
    target_visible: bool = False
    """True if the target is visible in the newest image of an eye."""
    target_eye_angles: FloatArray | None = None
    """(4,) angles at which the eye joints look at the target, rad; nan if unknown."""
    missed_periods: int = 0
    """Control periods missed since the last call."""


class Supervisor:
    """Keeps a robot inside its bounds.

    `lower` and `upper` are (7,) bounds of the actuators, rad, `names` the slots of those with a
    servo. The last command may act for `last_s` before the servos stop by themselves. An
    `emulated` head's servos may themselves come late.
    """

    def __init__(
        self,
        config: SafetyConfig,
        head: HeadModel,
        lower: FloatArray,
        upper: FloatArray,
        names: dict[str, int],
        last_s: float = 0.0,
        emulated: bool = False,
    ) -> None:
        self._config, self._head, self._names = config, head, names
        self._lower, self._upper = lower, upper
        self._emulated = emulated
        self._motion = JointMotionLimiter(head, lower, upper, config, last_s)
        self._following = FollowingMonitor(head, self._motion.max_speed)
        self._search = _SpiralSearch(head)
        self._last_sent = np.zeros(7)
        self._state: RobotState | None = None
        self._missed: deque[tuple[float, int]] = deque()
        self._fresh_s = _MAX_AGE_PERIODS * head.timing.period_s
        self._overrun_periods = round(_OVERRUN_WINDOW_S / head.timing.period_s)
        self.begin(np.nan)
        self.max_speed = self._motion.max_speed  # (7,) of joints seen to follow, rad/s
        self.verdict = Verdict.GO
        self.fault = ""  # reason of a stop
        # (7,) True for joints that do not follow: a command of zero may not stop them
        self.distrusted = np.zeros(7, dtype=np.bool_)

    def begin(self, now_s: float) -> None:
        """Begin a trial at a time, s, and watch its images, target and missed periods."""
        self._begun_s = self._seen_s = now_s
        self._swings = [_Swings() for _ in range(4)]
        self._missed.clear()
        self._paused = -np.inf, 0.0  # end and length of the last long pause, s

    def stop(self, reason: str) -> None:
        """Stop for a reason in words; later reasons do not replace it.

        If late periods or a pause of this process went before a fault of servos or cameras, the
        reason begins with these.
        """
        if not self.fault and reason.startswith(("servos:", "cameras.")):
            reason = self._lateness() + reason
            if self._emulated and "other programs" not in reason:
                reason += " (or end other programs: the emulated head shares this machine)"
        self.fault = self.fault or reason
        self.verdict = Verdict.STOP

    def note_pause(self, now_s: float, pause_s: float) -> None:
        """Note a time, s, for which nothing was sent, which has just ended."""
        self._paused = now_s, max(pause_s, self._paused[1] * self._recently(now_s))

    def note_released(self, names: str) -> None:
        """Add to the reason of a stop which joints have lost their torque."""
        if names and "without torque" not in self.fault:
            self.fault += f" ({names} without torque: hold what may sink; the others rest)"

    def _recently(self, now_s: float) -> bool:
        return now_s - self._paused[0] < _OVERRUN_WINDOW_S

    def _missed_periods(self) -> int:
        return sum(count for _, count in self._missed)

    def _lateness(self) -> str:
        """Beginning of a reason that may follow from late periods; empty if they were on time."""
        now_s = max(self._missed[-1][0] if self._missed else -np.inf, self._paused[0])
        missed, periods = self._missed_periods(), self._overrun_periods
        paused_s = self._paused[1] if self._recently(now_s) else 0.0
        if paused_s == 0.0 and missed <= _LATE_FRACTION * periods:
            return ""
        longest = f", and nothing was sent for {paused_s:.2f} s" if paused_s else ""
        return (
            f"loop: expected commands in time, but {missed} of the last {periods} periods were "
            f"missed{longest}: this process or machine had paused; cure: end other programs; after "
            "that: "
        )

    def command(self, state: RobotState, requested: FloatArray) -> FloatArray:
        """Command for the next period, (7,) rad/s, for requested velocities of the actuators.

        `verdict` and `fault` explain a difference.
        """
        if np.isnan(requested).any():
            self.stop("policy: expected numbers for a command, got nan")
        self._state = state
        self._judge(state)
        if self.fault:
            requested, self.verdict = np.zeros(7), Verdict.STOP
        else:
            requested = self._while_lost(state, requested)
        first = np.maximum(_UNPROVED_SPEED_RATIO * self.max_speed, _MIN_UNPROVED_SPEED_RAD_S)
        unproved = np.minimum(first, self.max_speed)
        max_speed = np.where(self.proved_joints, self.max_speed, unproved)
        return self._motion.limit_velocities(
            state.actuator_angles, state.actuator_speeds, requested, max_speed
        )

    def on_sent(self, sent: FloatArray) -> None:
        """Report the command, (7,) rad/s, that was sent for a period, and judge the joints' motion.

        That takes longer than all else, so it does not delay the command.
        """
        self._judge_following()
        self._motion.advance(sent)
        self._last_sent = sent.copy()

    def _judge_following(self) -> None:
        """Stop if a joint does not follow, by the state of the last command."""
        state = self._state
        if state is None:
            return
        fresh = state.reading_age_s <= self._fresh_s
        off = self._following.update(
            state.now_s, state.actuator_angles, self._last_sent, self._motion.speed, fresh
        )
        self.distrusted |= off > 0.0
        for name, slot in self._names.items():
            if off[slot] > 0.0:
                self.stop(
                    f"servos: {name}: expected the joint to follow its commands, got one that "
                    f"{self._following.describe(slot)}"
                )

    @property
    def proved_joints(self) -> BoolArray:
        """(7,) True for joints that have been seen to follow their commands."""
        return self._following.proved_joints

    @property
    def limiting_posture(self) -> str:
        """Name of the forbidden posture that limited the last command; empty for none."""
        return self._motion.limiting_posture

    @property
    def at_rest(self) -> bool:
        """True if the last command was zero."""
        return not self._last_sent.any()

    def _judge(self, state: RobotState) -> None:
        """Stop if joints, limits or forbidden postures are violated, or the trial's loop fails."""
        age_s = float(state.reading_age_s.max())
        if age_s > MAX_READING_AGE_S:
            self.stop(
                f"servos: expected the joints' angles within {MAX_READING_AGE_S:g} s, got none for "
                f"{age_s:.2f} s; cure: check the servos' cables and power"
            )
        angles, fresh = state.actuator_angles, state.reading_age_s <= self._fresh_s
        for name, slot in self._names.items():
            lower, angle, upper = self._lower[slot], angles[slot], self._upper[slot]
            if fresh[slot] and max(lower - angle, angle - upper) > _LIMIT_VIOLATION_RAD:
                self.stop(
                    f"servos: {name}: expected {lower:.3f} to {upper:.3f} rad, got {angle:.3f} "
                    "rad: it was pushed, or commands came late; cure: turn it back by hand with "
                    "torque off (`vergence jog`: off)"
                )
        entered = find_containing_posture(self._config.forbidden, angles)
        if entered is not None:
            self.stop(
                f"safety: {entered.refusal(angles, self._names)}; cure: turn it out of there by "
                "hand with torque off (`vergence jog`: off)"
            )
        if state.images_received_s is not None:
            self._judge_loop(state, state.images_received_s)

    def _judge_loop(self, state: RobotState, images_s: FloatArray) -> None:
        """Stop if a trial's images are late, many periods are missed, or the head oscillates."""
        config = self._config
        for eye, name in enumerate(EYE_NAMES):
            age_s = state.now_s - max(float(images_s[eye]), self._begun_s)
            if age_s > config.image_age_s:
                self.stop(
                    f"cameras.{name}: expected a new image within {config.image_age_s:g} s, got "
                    f"none for {age_s:.2f} s; cure: another cable or port, or a longer "
                    "safety.image_age_s"
                )
        self._missed.append((state.now_s, state.missed_periods))
        while state.now_s - self._missed[0][0] > _OVERRUN_WINDOW_S:
            self._missed.popleft()
        missed, periods = self._missed_periods(), self._overrun_periods
        if missed > config.overruns * periods:
            self.stop(
                f"loop: expected at most {config.overruns:.0%} of the {periods} periods of "
                f"{_OVERRUN_WINDOW_S:g} s to be missed, got {missed}: this machine or the policy "
                "is too slow; cure: end other programs, or take a quicker policy or a lower "
                "control_rate_hz in the head file"
            )
        goals = np.full(4, np.nan) if state.target_eye_angles is None else state.target_eye_angles
        pairs = zip(state.joint_angles[EYES].tolist(), goals.tolist(), strict=True)
        for joint, (swings, pair) in enumerate(zip(self._swings, pairs, strict=True)):
            if swings.update(state.now_s, *pair):
                self.stop(
                    f"{OSCILLATION_REASON}, got {self._head.joints[EYES][joint]} swinging at "
                    "speed; cure: a policy with lower gains, or one that counts on the loop's "
                    "delay, such as state-feedback"
                )
                break

    def _while_lost(self, state: RobotState, requested: FloatArray) -> FloatArray:
        """Replace the requested velocities while the target is lost: by rest, or by the search."""
        self.verdict = Verdict.GO
        if state.images_received_s is None:
            return requested
        if state.target_visible:
            self._seen_s = state.now_s
        lost_s = state.now_s - self._seen_s - self._config.lost_s
        if lost_s <= 0.0:
            return requested
        if not self._config.search:
            self.verdict = Verdict.HOLD
            return np.zeros(7)
        self.verdict = Verdict.SEARCH
        return self._search.velocities(lost_s, state.actuator_angles, state.joint_angles)


_ASSUMED_DISTANCE_M: Final = 1.0
"""Assumed distance of the target from each camera, m: a turning camera moves near and far targets
alike in the image (chosen: a usual working distance)."""


def target_eye_angles(head: HeadModel, q: FloatArray, pixels: FloatArray) -> FloatArray:
    """Goals of the four eye joints by one Newton step, which is exact at the goal itself.

    They are (4,) rad, nan for an eye to which the target is not visible, of the (7,) joint angles
    at the exposure, rad, and the target's (2, 2) raw pixels, nan for such an eye.
    """
    ideal = head.undistort(pixels)
    jacobian = head.image_jacobian(q, ideal, np.full(2, _ASSUMED_DISTANCE_M))
    goals = np.full(4, np.nan)
    for eye in range(2):
        own = slice(EYES.start + 2 * eye, EYES.start + 2 * eye + 2)
        if np.isfinite(pixels[eye]).all():
            missing = head.cameras.principal[eye] - ideal[eye]
            turn, *_ = np.linalg.lstsq(jacobian[eye][:, own], missing)
            goals[2 * eye : 2 * eye + 2] = q[own] + turn
    return goals
