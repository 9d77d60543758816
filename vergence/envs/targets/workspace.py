"""A target that appears anywhere in a workspace, drawn for each trial."""

from dataclasses import dataclass
from math import hypot
from typing import Any, ClassVar, Final, Literal

import numpy as np

from vergence._jit import compiled, device
from vergence.envs.philox import Purpose, random_words
from vergence.envs.streams import IntArray, Streams
from vergence.envs.targets.motion import motion_rows
from vergence.envs.targets.placement import ATTEMPTS, between_eyes, can_fixate, place
from vergence.envs.targets.target import Target
from vergence.errors import ConfigurationError
from vergence.models.camera import point_to_pixel
from vergence.models.head import HeadModel
from vergence.models.kinematics import point_in_eye
from vergence.models.packed import camera_of
from vergence.models.parts import FloatArray

_TASK: Final = int(Purpose.TASK)
_STARTS: Final = 100
_AT_REST: Final = motion_rows(np.zeros(3))


@dataclass(frozen=True, kw_only=True)
class RandomTarget(Target):
    """A target that appears anywhere in a workspace, uniform in eccentricity and in 1 / depth.

    Both eyes can fixate it with some degrees to spare, both see it at time zero, and the
    eyes have to turn by a least angle. With `start="fixation"` the eyes begin on another
    point of the workspace.
    """

    kind: ClassVar[str] = "random"
    depth: tuple[float, float] = (0.3, 2.5)
    """Nearest and farthest z, m."""
    eccentricity: float = 0.7
    """Greatest angle from straight ahead, seen from between the eyes, rad."""
    margin: float = 0.03490658503988659
    """Least distance of the fixating angles from the joints' limits, rad."""
    shift: float = 0.03490658503988659
    """Least angle that the farther-turning eye has to turn, rad."""
    border: float = 0.0
    """Least distance of the target from the images' edges at time zero, px: for true heads that
    do not see quite what their model says."""
    start: Literal["rest", "fixation"] = "fixation"

    def __post_init__(self) -> None:
        super().__post_init__()
        near, far = self.depth
        if not 0.0 < near <= far:
            raise ConfigurationError(
                f"target.depth: expected 0 < nearest <= farthest, got {self.depth}"
            )
        if not 0.0 < self.eccentricity < 1.5:
            raise ConfigurationError(
                f"target.eccentricity: expected 0 to 1.5 rad, got {self.eccentricity}"
            )

    def draw(
        self, head: HeadModel, streams: Streams, ids: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`; candidates are drawn until one is fit."""
        rows = np.repeat(_AT_REST, len(ids), axis=0)
        q = np.empty((len(ids), 7))
        limits = head.limits
        found = choose_targets(
            streams.seeds[ids],
            streams.trials[ids],
            head.packed,
            limits.lower,
            limits.upper,
            *self.depth,
            self.eccentricity,
            self.margin,
            self.shift,
            self.border,
            self.start == "fixation",
            rows,
            q,
        )
        if not found:
            raise ConfigurationError(
                f"target: expected a workspace that this head can look at, got none of "
                f"{ATTEMPTS} points of {self} that both eyes can see and fixate"
            )
        return rows, q


@device
def _in_view(p: Any, angles: Any, x: float, y: float, z: float, border: float) -> bool:
    """Whether both eyes see a point at some distance from their images' edges."""
    for eye in range(2):
        camera = camera_of(p, eye)
        right, bottom = camera.width - 1.0 - border, camera.height - 1.0 - border
        dx, dy, dz = point_in_eye(p, eye, angles[2 * eye], angles[2 * eye + 1], x, y, z)
        u, v = point_to_pixel(p, eye, dx, dy, dz, True)
        if not (border <= u <= right and border <= v <= bottom):
            return False
    return True


@device
def _turn(begin: Any, goal: Any) -> Any:
    """The angle that the farther-turning eye turns."""
    left = hypot(goal[0] - begin[0], goal[1] - begin[1])
    return max(left, hypot(goal[2] - begin[2], goal[3] - begin[3]))


@compiled
def choose_targets(
    seeds: Any, trials: Any, p: Any, lower: Any, upper: Any, near: float, far: float,
    eccentricity: float, margin: float, shift: float, border: float, fixating: bool, rows: Any,
    q: Any,
) -> bool:  # fmt: skip
    """Draw candidates for each trial until one is fit.

    Args:
        seeds: (n,) keys of the trials' random numbers.
        trials: (n,) keys of the trials' random numbers.
        p: (PACKED,) the head.
        lower: (7,) its joints' limits, rad.
        upper: (7,) their limits, rad.
        near: see `RandomTarget`, as are the following five.
        far: m.
        eccentricity: rad.
        margin: rad.
        shift: rad.
        border: px.
        fixating: whether the eyes begin on a point of the workspace, or at rest.
        rows: (n, MOTION) result: where the target is, in rows of targets at rest.
        q: (n, 7) result: joint angles at the start, rad.

    Returns:
        False if some trial has no fit candidate.
    """
    rest = np.minimum(np.maximum(lower, 0.0), upper)
    eye = between_eyes(p, rest)
    goal, begin = np.empty(4), np.empty(4)
    for n in range(seeds.shape[0]):
        q[n] = rest
        found = False
        for attempt in range(ATTEMPTS):
            words = random_words(seeds[n], trials[n], _TASK, attempt, 1)
            x, y, z = place(words, eye, near, far, eccentricity)
            if not can_fixate(p, lower, upper, margin, x, y, z, goal):
                continue
            # one target, many starts: were both drawn anew, few targets aside would be left,
            # as few of the workspace's points have them in view
            for again in range(_STARTS if fixating else 1):
                words = random_words(seeds[n], trials[n], _TASK, attempt + again, 2)
                bx, by, bz = place(words, eye, near, far, eccentricity)
                if not fixating:
                    begin[:] = rest[3:]
                elif not can_fixate(p, lower, upper, margin, bx, by, bz, begin):
                    continue
                if _turn(begin, goal) >= shift and _in_view(p, begin, x, y, z, border):
                    found = True
                    break
            if found:
                break
        if not found:
            return False
        rows[n, 0], rows[n, 1], rows[n, 2] = x, y, z
        rows[n, 3], rows[n, 4], rows[n, 5] = x, y, z
        q[n, 3:] = begin
    return True
