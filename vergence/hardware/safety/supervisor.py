"""The supervisor of a robot head: from its state and a wish to a command and a verdict.

It reads no clock and touches no hardware. In each period the plant tells it what is known of the
robot, asks it for the command in place of a policy's wish, and tells it what was sent. A stop
latches: from then on all commands brake, until the plant is opened anew.
"""

from collections import deque
from enum import Enum
from typing import Final, NamedTuple

import numpy as np

from vergence.envs.reading import BoolArray
from vergence.hardware.safety.config import SafetyConfig
from vergence.hardware.safety.following import Following
from vergence.hardware.safety.motion import JointMotion, inside
from vergence.hardware.safety.searching import Search
from vergence.hardware.safety.swings import Swings
from vergence.models.head import HeadModel
from vergence.models.joints import EYE_NAMES, EYES
from vergence.models.parts import FloatArray

SWINGING: Final = "policy: expected joints that come to rest at a target that rests"
"""How the reason of a stop begins where it is the policy that lets the head swing."""
JOINTS_AGE_S: Final = 0.15
"""Age of the joints' angles from which on the head stops, s."""
_FIRST: Final = 0.1
"""Share of its speed that a joint has until it is proved to follow."""
_FIRST_RAD_S: Final = 0.2
"""And what is slow enough for that, rad/s."""
_SEEN: Final = 2.0
"""Age of an angle by the control period up to which a limit is judged by it."""
_BEYOND_RAD: Final = 0.05
"""Distance beyond a limit at which something else than a command has moved a joint, rad."""
_OVERRUN_WINDOW_S: Final = 2.0
"""Time over which missed periods are counted, s."""


class Verdict(Enum):
    """Answer to a wish."""

    GO = "go"
    """The wish, as far as the bounds allow."""
    HOLD = "hold"
    """Rest until the target is seen again."""
    SEARCH = "search"
    """Look around for the target."""
    STOP = "stop"
    """Rest until released."""


class State(NamedTuple):
    """The robot at present, all that the supervisor is told."""

    now_s: float
    """The present, s of a steady clock."""
    angles: FloatArray
    """(7,) of the neck's joints and the actuators of the eyes, rad."""
    speeds: FloatArray
    """(7,) measured speeds of these, rad/s."""
    joints: FloatArray
    """(7,) joint angles, rad."""
    age_s: FloatArray
    """(7,) for how long the angles have been carried on since each joint's last answer, s."""
    images_s: FloatArray | None
    """(2,) when the newest image of each eye came, s; None while no images count, as on the way to
    where a trial begins."""
    seen: bool = False
    """Whether an eye sees the target in its newest image."""
    goals: FloatArray | None = None
    """(4,) angles at which the eyes' joints look at the target, rad; nan where unknown."""
    missed: int = 0
    """Periods that have been missed since the last call."""


class Supervisor:
    """Keeps a robot inside its bounds.

    Args:
        config: the bounds.
        head: the model of the head.
        lower: (7,) least angles of the joints of the neck and the actuators of the eyes, rad.
        upper: (7,) greatest angles, rad.
        names: places in a command of seven by name, of what has a servo.
        last_s: time for which the last command may act before the servos stop by themselves, s.

    Attributes:
        verdict: that on the last wish.
        fault: the reason of a stop in words; empty while there is none.
    """

    def __init__(
        self,
        config: SafetyConfig,
        head: HeadModel,
        lower: FloatArray,
        upper: FloatArray,
        names: dict[str, int],
        last_s: float = 0.0,
    ) -> None:
        self._config = config
        self._head = head
        self._lower, self._upper = lower, upper
        self._names = names
        self._motion = JointMotion(head, lower, upper, config, last_s)
        self._following = Following(head, self._motion.most)
        self._swings = Swings()
        self._search = Search(head)
        self._told = np.zeros(7)
        self._missed: deque[tuple[float, int]] = deque()
        self._seen_s = self._begun_s = np.nan
        self.verdict = Verdict.GO
        self.fault = ""

    def begin(self, now_s: float) -> None:
        """Begin a trial: its images, target and overruns are watched from here, s."""
        self._begun_s = self._seen_s = now_s
        self._swings.begin()
        self._missed.clear()

    def stop(self, reason: str) -> None:
        """Stop for a reason in words; the first one stays."""
        self.fault = self.fault or reason
        self.verdict = Verdict.STOP

    def command(self, state: State, wish: FloatArray) -> FloatArray:
        """The command for the next period.

        Args:
            state: the robot at present.
            wish: (7,) velocities of the neck's joints and of the actuators of the eyes, rad/s.

        Returns:
            (7,) rad/s; `verdict` and `fault` say why they are others.
        """
        if np.isnan(wish).any():
            self.stop("policy: expected numbers for a command, got nan")
        self._judge(state)
        if self.fault:
            wish, self.verdict = np.zeros(7), Verdict.STOP
        else:
            wish = self._while_lost(state, wish)
        first = np.minimum(np.maximum(_FIRST * self.most, _FIRST_RAD_S), self.most)
        most = np.where(self._following.proved, self.most, first)
        return self._motion.allowed(state.angles, state.speeds, wish, most)

    def took(self, sent: FloatArray) -> None:
        """Let a period pass in which a command was sent, (7,) rad/s."""
        self._motion.took(sent)
        self._told = sent.copy()

    @property
    def proved(self) -> BoolArray:
        """(7,) whether each joint has been seen to follow its commands."""
        return self._following.proved

    @property
    def most(self) -> FloatArray:
        """(7,) greatest speeds of joints that are proved, rad/s."""
        return self._motion.most

    @property
    def in_the_way(self) -> str:
        """The forbidden posture that has limited the last command; empty for none."""
        return self._motion.in_the_way

    @property
    def at_rest(self) -> bool:
        """Whether the last command was to rest."""
        return not self._told.any()

    def _judge(self, state: State) -> None:
        """Stop where something is wrong."""
        age_s = float(state.age_s.max())
        if age_s > JOINTS_AGE_S:
            self.stop(
                f"servos: expected the joints' angles within {JOINTS_AGE_S:g} s, got none for "
                f"{age_s:.2f} s; cure: check the servos' cables and power"
            )
        for name, slot in self._names.items():
            angle = state.angles[slot]
            beyond = max(self._lower[slot] - angle, angle - self._upper[slot])
            seen = state.age_s[slot] <= _SEEN * self._head.timing.period_s
            if beyond > _BEYOND_RAD and seen:
                self.stop(
                    f"servos: {name}: expected {self._lower[slot]:.3f} to {self._upper[slot]:.3f} "
                    f"rad, got {angle:.3f} rad: it was pushed, or commands came late; cure: turn "
                    "it back by hand with torque off (`vergence jog`: off)"
                )
        hurt = inside(self._config.forbidden, state.angles)
        if hurt is not None:
            self.stop(
                f"safety: {hurt.refusal(state.angles, self._names)}; cure: turn it out of there by "
                "hand with torque off (`vergence jog`: off)"
            )
        off = self._following.take(state.now_s, state.angles, self._told)
        for name, slot in self._names.items():
            if off[slot] > 0.0:
                self.stop(
                    f"servos: {name}: expected the joint to follow its commands, got one that is "
                    "stuck, turns the wrong way, or is misread; cure: see with `vergence jog` "
                    "whether it turns freely and as far as it is told to"
                )
        if state.images_s is not None:
            self._judge_loop(state, state.images_s)

    def _judge_loop(self, state: State, images_s: FloatArray) -> None:
        """Stop where images, periods or motions of a running trial are wrong."""
        config = self._config
        for eye, name in enumerate(EYE_NAMES):
            age_s = state.now_s - max(float(images_s[eye]), self._begun_s)
            if age_s > config.image_age_s:
                self.stop(
                    f"cameras.{name}: expected a new image within {config.image_age_s:g} s, got "
                    f"none for {age_s:.2f} s; cure: another cable or port, or a longer "
                    "safety.image_age_s"
                )
        self._missed.append((state.now_s, state.missed))
        while state.now_s - self._missed[0][0] > _OVERRUN_WINDOW_S:
            self._missed.popleft()
        missed = sum(count for _, count in self._missed)
        periods = round(_OVERRUN_WINDOW_S / self._head.timing.period_s)
        if missed > config.overruns * periods:
            self.stop(
                f"loop: expected at most {config.overruns:.0%} of the {periods} periods of "
                f"{_OVERRUN_WINDOW_S:g} s to be missed, got {missed}: this machine or the policy "
                "is too slow; cure: end other programs, or take a quicker policy or a lower "
                "control_rate_hz in the head file"
            )
        goals = np.full(4, np.nan) if state.goals is None else state.goals
        joint = self._swings.take(state.now_s, state.joints[EYES], goals)
        if joint is not None:
            self.stop(
                f"{SWINGING}, got {self._head.joints[EYES][joint]} swinging at speed; cure: a "
                "policy with lower gains, or one that counts on the loop's delay, such as "
                "state-feedback"
            )

    def _while_lost(self, state: State, wish: FloatArray) -> FloatArray:
        """The wish, or what is done while the target is lost."""
        self.verdict = Verdict.GO
        if state.images_s is None:
            return wish
        if state.seen:
            self._seen_s = state.now_s
        lost_s = state.now_s - self._seen_s - self._config.lost_s
        if lost_s <= 0.0:
            return wish
        if not self._config.search:
            self.verdict = Verdict.HOLD
            return np.zeros(7)
        self.verdict = Verdict.SEARCH
        return self._search.wish(lost_s, state.angles, state.joints)
