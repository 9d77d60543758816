"""A simulated head that a person plays with: its target, law and loop change while it runs."""

from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np

from vergence.controllers.controller import make_controller
from vergence.envs.plant import Simulation, plant_type, simulation_of
from vergence.envs.plants.rendered import RenderedPlant
from vergence.envs.streams import IntArray, RandomStreams
from vergence.envs.targets.motion import POINT, Board, Target, motion_rows, target_position
from vergence.envs.targets.prescribed import StepTarget
from vergence.envs.targets.pursuit import WanderTarget
from vergence.envs.targets.workspace import RandomTarget
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError, UnreachableTargetError, VergenceError
from vergence.eval.trials.bound import settle_bound
from vergence.eval.trials.fixation import HELD_S
from vergence.eval.trials.goal import least_reachable_error
from vergence.models.camera import Camera
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.viewer.moment import Moment, moment_of
from vergence.vision.objects.scenes import Scene
from vergence.vision.objects.sights import line_of_sight

TargetMode = Literal["step", "circle", "wander", "by hand"]
STEP_S: Final = 2.5
"""Time between two jumps of the target, s (chosen: the eyes settle, and rest for a while)."""
BAND_PX: Final = 1.0
"""Settling band on the true pixel error, px (chosen: that of `vergence gaze`)."""
# radius of the circle as a fraction of its distance, and time of a turn, s (chosen: every law
# follows, the late ones visibly)
_CIRCLE_RADIUS: Final = 0.15
_CIRCLE_PERIOD_S: Final = 5.0
_DISTANCE_M: Final = 1.0
"""Distance of the first target straight ahead, m (chosen: that of `vergence gaze`)."""
_MOST_DRAWS: Final = 100
"""Most points that are drawn for a jump until both eyes see one (numerical)."""
_VIEW_BORDER: Final = 0.12
"""Border of the images that a jump leaves free, as a fraction of their size (chosen: room for the
tag)."""
# least and greatest distance at which a target is put, m (chosen: beyond what anybody wants)
_MIN_DISTANCE_M: Final = 0.02
_MAX_DISTANCE_M: Final = 50.0
_MOVED_M: Final = 1e-4
"""Distance from which a target has moved, m (chosen: below what a hand does)."""
_FIRST = np.zeros(1, dtype=np.int64)
_FAR_FUTURE_S: Final = 1e9
"""Time at which a target that jumps has come to rest, s (numerical)."""
_FIRST_STEP_S: Final = 1.0
"""Time until the first jump, s (chosen: a person sees the head at rest first)."""


@dataclass(frozen=True, kw_only=True)
class Setup:
    """A simulated head with its law and loop."""

    head: HeadModel
    plant: str = "rendered"
    controller: str = "saccade"
    gain: float | None = None
    """Gain of the controller, 1/s; None for its own."""
    seen: dict[str, str] = field(default_factory=dict)
    """Options of the plant `rendered` on what is looked at: `look`, `scene` and `wall`."""
    loop: dict[str, float] = field(default_factory=dict)
    """Imperfections of the loop that differ from the head's, by the names of
    `vergence.envs.plants.conditions`."""

    @property
    def point_in_room(self) -> bool:
        """True if a point of the room's walls is followed, which nobody moves."""
        named = self.seen.get("look", "").startswith("point")
        return self.plant == "rendered" and named and self.seen.get("scene") == "room"

    def make_controller(self) -> Any:
        """Make the controller.

        Raises:
            VergenceError: the head or an extra does not permit it.
        """
        options: dict[str, Any] = {} if self.gain is None else {"gain": self.gain}
        return make_controller(self.controller, head=self.head, **options)


@dataclass(frozen=True, kw_only=True)
class _Continued(Target):
    """A target that goes on from a given posture of the head."""

    kind = "continued"
    motions: FloatArray
    positions: FloatArray

    def __post_init__(self) -> None:
        """Check nothing: the values come from a running trial."""

    def draw(
        self, head: HeadModel, streams: RandomStreams, ids: IntArray, board: Board = POINT
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`."""
        return self.motions, self.positions


class SimulatedHead:
    """A simulated head before a target that jumps, circles, wanders or is moved by hand.

    Args:
        setup: the head, its law and its loop.
        mode: motion of the target.
        seed: seed of all noise and of the target's motion.

    Attributes:
        mode: motion of the target.
        time_s: time since the beginning, s.
        settled_s: time from the target's last jump until both true pixel errors stayed within
            `BAND_PX` of the least that the head can reach, s; None before, without a jump, and for
            a target that keeps moving.
        bound_s: time-optimal bound on that time, s; None if it is not known.

    Raises:
        VergenceError: the head, the plant or the law does not permit it.
    """

    def __init__(self, setup: Setup, mode: TargetMode = "step", seed: int = 0) -> None:
        self.mode, self._seed, self._trial, self.time_s = mode, seed, 0, 0.0
        self.settled_s: float | None = None
        self._state: Any = None
        self.bound_s: float | None = None
        self._setup = setup
        self._task, self._controller = _make_task(setup), setup.make_controller()
        self._begin(setup.head.rest(), _at_rest_ahead(setup.head))
        self.set_mode(mode)

    def look_at(self, eye: int, pixel: FloatArray) -> None:
        """Look at a point of the room, or put the target there, at its present distance.

        Args:
            eye: 0 for left, 1 for right.
            pixel: (2,) raw pixel (u, v) of its present image.

        Raises:
            VergenceError: the target cannot stand there.
        """
        plant = self._plant
        if self._setup.point_in_room and isinstance(plant, RenderedPlant):
            self.mode = "by hand"
            self._jump_to(plant.click(eye, pixel))
            return
        camera = Camera.of(self._setup.head, eye)
        T_N_C = self._setup.head.camera_poses(plant.truth().positions[0])[eye]
        ray = line_of_sight(camera, T_N_C, pixel)
        if not np.isfinite(ray).all():
            raise ConfigurationError(f"pixel: expected one in the lens's view, got {pixel}")
        distance_m = float(np.linalg.norm(self.target - T_N_C[:3, 3]))
        self.move_target(T_N_C[:3, 3] + distance_m * ray)

    @property
    def setup(self) -> Setup:
        """The head, its law and its loop."""
        return self._setup

    @property
    def period_s(self) -> float:
        """Control period, s."""
        return self._setup.head.timing.period_s

    @property
    def room(self) -> Scene | None:
        """The room around the head; None for none."""
        return self._plant.scene if isinstance(self._plant, RenderedPlant) else None

    @property
    def target(self) -> FloatArray:
        """(3,) present position of the target in N, m."""
        return np.array(self._plant.truth().target[0])

    @property
    def _plant(self) -> Simulation:
        return simulation_of(self._task.plant)

    def change(self, setup: Setup) -> None:
        """Go on with another law, loop or head; the same head goes on from its posture.

        Raises:
            VergenceError: the new setup is not possible; the old one then goes on.
        """
        same_head = setup.head is self._setup.head
        same = ("plant", "loop", "seen")
        controller = setup.make_controller()
        if same_head and all(getattr(setup, n) == getattr(self._setup, n) for n in same):
            self._controller, self._state, self._starts = controller, None, True
            self._setup = setup
        else:
            task, truth = _make_task(setup), self._plant.truth()
            self._task.close()
            self._task, self._controller = task, controller
            self._setup = setup
            if same_head:
                target = truth.target[0]
                self._begin(truth.positions[0], motion_rows(target, before=target[None]))
            else:
                self._begin(setup.head.rest(), _at_rest_ahead(setup.head))
            self.set_mode(self.mode)

    def set_mode(self, mode: TargetMode) -> None:
        """Let the target move in another way, from now on."""
        if self._setup.point_in_room:
            if mode not in ("step", "by hand"):
                raise ConfigurationError(f"motion: expected a wall to stand still, got {mode}")
            self.look_at(0, self._setup.head.cameras.principal[0])
        self.mode = mode
        self._next_jump_s = self.time_s + _FIRST_STEP_S
        if mode in ("step", "by hand"):
            self._jump_to(self.target)
            return
        head = self._setup.head
        motions = _circle(head) if mode == "circle" else self._drawn(WanderTarget())
        first = target_position(motions, [0.0])
        positions = head.fixate(first, head.rest()[:3])
        if not (np.isfinite(positions).all() and head.reaches(positions).all()):
            positions = self._plant.truth().positions
        self._begin(positions[0], motions)

    def look_ahead(self) -> None:
        """Put the target in front of the eyes as they stand now."""
        positions = self._plant.truth().positions[0]
        self.move_target(_ahead_of(self._setup.head, positions))

    def move_target(self, point: FloatArray) -> None:
        """Put the target somewhere; it then stays there.

        Args:
            point: (3,) in the present N, m.
        """
        self.mode = "by hand"
        self._jump_to(_placeable(point))

    def step(self) -> None:
        """Simulate one control period."""
        if self.mode == "step" and self.time_s >= self._next_jump_s:
            self._next_jump_s = self.time_s + STEP_S
            self._jump()
        action, self._state = self._controller.predict(
            self._task.observation.copy(),
            state=self._state,
            episode_start=np.array([self._starts]),
            deterministic=True,
        )
        self._starts = False
        self._task.step(self._task.as_action(action))
        self.time_s += self.period_s
        self._watch_settling()

    def moment(self) -> Moment:
        """The present moment, with the time since the beginning."""
        return moment_of(self._task)._replace(time_s=self.time_s)

    def _begin(self, positions: FloatArray, motions: FloatArray) -> None:
        """Begin a trial from a posture."""
        self._task.target = _Continued(motions=motions, positions=positions[None])
        keys = np.array([[self._seed], [self._trial]], dtype=np.uint64)
        self._trial += 1
        self._task.begin(_FIRST, *keys)
        self._state, self._starts = None, True
        self._forget_settling()
        self._onset_s = np.nan  # the target was there before

    def _jump(self) -> None:
        """Let the target jump somewhere in the workspace."""
        before, positions = self.target, self._plant.truth().positions[0]
        for _ in range(_MOST_DRAWS):
            try:
                (point,) = target_position(self._drawn(RandomTarget()), [_FAR_FUTURE_S])
            except UnreachableTargetError:  # a head that can look at hardly anything
                return
            if self._well_in_view(positions, point):
                break
        if self._setup.point_in_room:
            self.look_at(0, self._setup.head.project(positions, point)[0])
            self.mode = "step"
            return
        self._jump_to(point)
        self.bound_s = self._bound(before, point)

    def _well_in_view(self, positions: FloatArray, point: FloatArray) -> bool:
        """True if both eyes see a point with some room around it."""
        size = self._setup.head.cameras.size
        pixels = self._setup.head.project(positions, point)
        border = _VIEW_BORDER * size
        return bool(((pixels > border) & (pixels < size - border)).all())

    def _jump_to(self, point: FloatArray) -> None:
        moved_m = float(np.linalg.norm(point - self.target))
        self._plant.move_targets(_FIRST, motion_rows(point, before=point[None]))
        if moved_m > _MOVED_M:  # a hand that lets go moves nothing
            self._forget_settling()

    def _drawn(self, target: Target) -> FloatArray:
        """(1, MOTION or more) a motion from the next trial's random stream."""
        streams = RandomStreams(1)
        keys = np.array([[self._seed], [self._trial]], dtype=np.uint64)
        self._trial += 1
        streams.start(_FIRST, *keys)
        motions, _positions = target.draw(self._setup.head, streams, _FIRST, self._plant.board)
        return motions

    def _bound(self, before: FloatArray, after: FloatArray) -> float | None:
        """Time-optimal bound for eyes that rest on the target when it jumps, s."""
        try:
            jump = StepTarget(before=tuple(before.tolist()), after=tuple(after.tolist()))
            task = GazeTask(
                1,
                head=self._setup.head,
                plant="kinematic",
                target=jump,
                plant_options=dict(self._setup.loop),
            )
        except VergenceError:  # such as one outside the joints' limits
            return None
        keys = np.zeros((2, 1), dtype=np.uint64)
        task.begin(_FIRST, *keys)
        bound = float(settle_bound(task, BAND_PX)[0])
        return bound if np.isfinite(bound) else None

    def _forget_settling(self) -> None:
        self.settled_s = self.bound_s = None
        self._onset_s, self._inside_since_s, self._was_outside = self.time_s, np.nan, False

    def _watch_settling(self) -> None:
        truth = self._plant.truth()
        error = truth.pixel_error - least_reachable_error(self._task, truth.target)
        inside = bool((np.linalg.norm(error[0], axis=-1) < BAND_PX).all())
        if not inside:
            self._inside_since_s, self._was_outside = np.nan, True
            self.settled_s = None
        elif np.isnan(self._inside_since_s):
            self._inside_since_s = self.time_s
        timed = self.mode not in ("circle", "wander") and not np.isnan(self._onset_s)
        if timed and self._was_outside and self.time_s - self._inside_since_s >= HELD_S:
            self.settled_s = self._inside_since_s - self._onset_s


def _make_task(setup: Setup) -> GazeTask:
    options: dict[str, Any] = {**plant_type(setup.plant).workspace_options, **setup.loop}
    if setup.plant == "rendered":
        options |= setup.seen
    return GazeTask(1, head=setup.head, plant=setup.plant, plant_options=options)


def _placeable(point: FloatArray) -> FloatArray:
    """The point, or one near it at which a board has a place: off the head's middle and axis."""
    out = np.array(point, np.float64)
    if np.hypot(out[0], out[2]) < _MIN_DISTANCE_M:
        out[2] = _MIN_DISTANCE_M
    distance_m = float(np.linalg.norm(out))
    return out * min(1.0, _MAX_DISTANCE_M / distance_m)


def _ahead_of(head: HeadModel, positions: FloatArray) -> FloatArray:
    """(3,) point in N straight ahead of the eyes, m."""
    poses = head.camera_poses(positions)
    ahead = poses[:, :3, 2].sum(axis=0)
    return np.asarray(poses[:, :3, 3].mean(axis=0) + _DISTANCE_M * ahead / np.linalg.norm(ahead))


def _at_rest_ahead(head: HeadModel) -> FloatArray:
    """(1, MOTION) motion of a target that rests straight ahead of the eyes at rest."""
    point = _ahead_of(head, head.rest())
    return motion_rows(point, before=point[None])


def _circle(head: HeadModel) -> FloatArray:
    """(1, MOTION) motion on a circle before the eyes at rest."""
    centre = _ahead_of(head, head.rest())
    right = head.camera_poses(head.rest())[0, :3, 0]
    down = head.camera_poses(head.rest())[0, :3, 1]
    radius_m = _CIRCLE_RADIUS * _DISTANCE_M
    return motion_rows(
        centre,
        before=(centre + radius_m * down)[None],
        cosine=radius_m * down,
        sine=radius_m * right,
        omega=2.0 * np.pi / _CIRCLE_PERIOD_S,
    )
