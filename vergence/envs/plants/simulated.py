"""Common part of all simulated plants: true heads, targets, control loop, random streams."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from inspect import Parameter, signature
from typing import Any, ClassVar, Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.envs.judging import JUDGE, TaskArrays
from vergence.envs.plants import starting
from vergence.envs.plants.commands import CommandBuffers
from vergence.envs.plants.conditions import Conditions
from vergence.envs.plants.feedback import SAVED_FEEDBACK_FIELDS, JointFeedbackBuffers
from vergence.envs.plants.frames import TIME_TOLERANCE_S, Exposures, Frames
from vergence.envs.plants.imperfections import IMPERFECTIONS
from vergence.envs.plants.motors import SAVED_MOTOR_FIELDS, ActuatorCoupling, MotorStates
from vergence.envs.plants.scene import TrueHeadsAndTargets, update_truth
from vergence.envs.plants.sensing import SensorTiming
from vergence.envs.plants.simulation import Simulation, TrialStart
from vergence.envs.plants.stepping import (
    ALL_PHASES,
    EXPOSE,
    MOVE,
    REPORT,
    STORE,
    WARM_UP,
    StepArrays,
)
from vergence.envs.plants.true_heads import TrueHeadsAndConditions
from vergence.envs.plants.variation import RANGES, Variation, make_variation
from vergence.envs.reading import Reading, Truth
from vergence.envs.saved_state import Arrays, copy_arrays, join_parts, restore_arrays
from vergence.envs.streams import IntArray, RandomStreams
from vergence.envs.targets.motion import JUMP, last_jump_time, motion_rows
from vergence.envs.validation import check_count
from vergence.errors import ConfigurationError, refuse_unknown
from vergence.kernels import make_table, untyped_tuple
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_Init = TypeVar("_Init", bound=Callable[..., None])
_INITIAL_TARGET_POINT: Final = (0.0, 0.0, 1.0)
"""Position of the targets until trials are drawn, in N, m (chosen: straight ahead)."""


def _named(init: _Init) -> _Init:
    """Name the options `**loop` in the signature, which is used to check and show options."""
    own = signature(init)
    names = [
        Parameter(name, Parameter.KEYWORD_ONLY, default=None, annotation=ArrayLike | None)
        for name in IMPERFECTIONS
    ]
    init.__signature__ = own.replace(parameters=[*list(own.parameters.values())[:-1], *names])  # type: ignore[attr-defined]
    return init


class SimulatedPlant(Simulation):
    """A batch of simulated heads.

    Args:
        head: the model that a controller knows; it also sets the plant's timing and sensors unless
            they are overridden.
        num: number of heads.
        true_head: the true heads, with their own limits: one, or a population of shape (num,).
            None for the model itself.
        variation: conditions that each trial draws anew, in place of the following, see
            `vergence.envs.plants.variation`.
        **loop: imperfections of the loop by the names of `vergence.envs.plants.imperfections`, such
            as `latency_s`: numbers or (num,) arrays; also (num, m) over the eye actuators for
            imperfections of which each actuator has its own.

    Raises:
        ConfigurationError: an argument has an invalid shape or value.
    """

    _varies: ClassVar[frozenset[str]] = frozenset((*RANGES, "model_errors"))
    """Fields of a variation that this plant supports."""
    _kept_table: NDArray[np.void] | None = None

    @_named
    def __init__(
        self,
        head: HeadModel,
        num: int = 1,
        *,
        true_head: HeadModel | None = None,
        variation: Variation | Mapping[str, Any] | None = None,
        **loop: ArrayLike | None,
    ) -> None:
        refuse_unknown("plant_options", loop, IMPERFECTIONS)
        num = check_count("num", num)
        if head.batch_shape:
            raise ConfigurationError(
                f"head: expected one head, got a population of shape {head.batch_shape}"
            )
        if true_head is not None and not isinstance(true_head, HeadModel):
            raise ConfigurationError(f"true_head: expected a HeadModel, got {true_head!r:.80}")
        variation = self._checked_variation(make_variation(variation))
        self._true_heads = heads = TrueHeadsAndConditions(
            head, num, true_head=true_head, given=loop, variation=variation
        )
        self.head = head
        self.num = num
        self.reading = Reading.empty(num)
        self._all = np.arange(num)
        self._streams = RandomStreams(num)
        timing, period_s = head.timing, head.timing.period_s
        max_hz = heads.largest_value("frame_rate_hz") / (1.0 + IMPERFECTIONS["clock_drift"].least)
        skew_s = heads.largest_value("skew_s")
        late_s = heads.largest_value("latency_s") + heads.largest_value("jitter_s") + skew_s
        stalled_s = 0.0
        if heads.largest_value("stall_probability") > 0.0:
            stalled_s = max(heads.largest_value("stall_s"), period_s) + period_s
        self._frames = Frames.empty(num, late_s + stalled_s + 2.0 * period_s, max_hz)
        self._exposures = Exposures.empty(num, period_s, max_hz, 2 if skew_s > 0.0 else 1)
        self._motors = MotorStates.of(head, heads.given, num)
        self._coupling = ActuatorCoupling.of(head, heads.given, num)
        self._commands = CommandBuffers.empty(
            num,
            heads.given.actuation.velocity,
            head.sensor.command_resolution_rad_s,
            heads.largest_value("command_latency_s"),
            period_s,
        )
        # the reading of an image looks up joint angles as old as its date
        max_age_s = max(late_s, timing.latency_s) + 1.0 / max_hz + timing.feedback_latency_s
        max_age_s = max(max_age_s, heads.largest_value("speed_span_s"))
        feedback_s = heads.largest_value("feedback_latency_s") + heads.largest_value(
            "speed_latency_s"
        )
        self._feedback = JointFeedbackBuffers.of(
            head, num, feedback_s, max_age_s + stalled_s + period_s
        )
        self._timing = SensorTiming.of(head)
        self._scene = TrueHeadsAndTargets(
            heads=heads.packed.heads,
            motions=motion_rows(np.tile(_INITIAL_TARGET_POINT, (num, 1))),
            necks=np.zeros((num, 3)),
            step=np.zeros(num, dtype=np.int64),
            positions=np.zeros((num, 7)),
            velocities=np.zeros((num, 7)),
        )
        self._missing_joints = np.flatnonzero([not name for name in head.joints])
        self._task = TaskArrays.empty(head, num)

    def _checked_variation(self, variation: Variation | None) -> Variation | None:
        for name in (*RANGES, "model_errors") if variation is not None else ():
            if name not in self._varies and getattr(variation, name) is not None:
                raise ConfigurationError(
                    f"variation.{name}: expected a plant that can vary it, "
                    f"got {type(self).__name__}, which can vary {', '.join(sorted(self._varies))}"
                )
        return variation

    @property
    def true_head(self) -> HeadModel:
        """The true heads: one, or a population of shape (num,)."""
        return self._true_heads.model

    @property
    def conditions(self) -> Conditions:
        """Conditions of the running trials, in arrays that the next trials change."""
        return self._true_heads.conditions

    @abstractmethod
    def _put_at_rest(self, ids: IntArray) -> None:
        """Put the joints of some heads at rest, at the angles in scene and motors."""

    @abstractmethod
    def _advance(self, ids: IntArray, phases: int) -> bool:
        """Run phases of a control period, see `vergence.envs.plants.stepping`.

        Returns:
            False if an action or a command is nan.
        """

    def join(self, task: TaskArrays) -> None:
        """Apply the actions of a task from now on, and judge its steps; see `act`."""
        self._task, self._kept_table = task, None

    def act(self) -> bool:
        """Step by the requested actions of the task that has joined, and judge the step.

        Returns:
            False if an action is nan; nothing is changed then.
        """
        return self._advance(self._all, ALL_PHASES)

    def judge(self, ids: IntArray) -> None:
        """Judge the readings of some environments for the task that has joined."""
        self._advance(ids, JUDGE)

    def _motion_arrays(self) -> tuple[Any, ...]:
        """The plant's own arrays for the phase in which it moves the joints."""
        return ()

    @property
    def _table(self) -> NDArray[np.void]:
        """Table of the arrays of a step, made again once one of them has been replaced."""
        if self._kept_table is None:
            arrays = StepArrays(
                timing=self._timing,
                packed=self._true_heads.packed,
                keys=self._streams.keys,
                scene=self._scene,
                motors=self._motors,
                coupling=self._coupling,
                commands=self._commands,
                feedback=self._feedback,
                frames=self._frames,
                exposures=self._exposures,
                reading=self.reading,
                task=self._task,
                motion=self._motion_arrays(),
            )
            self._kept_table = make_table(arrays)
        return self._kept_table

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_kept_table": None}

    def reset(self, ids: IntArray, positions: FloatArray) -> Reading:
        """Put heads at rest and restart their last trials, see `Plant.reset`."""
        keys = self._streams.keys
        motions = self._scene.motions[ids]
        return self.begin(TrialStart(ids, keys.seeds[ids], keys.trials[ids], positions, motions))

    def begin(self, start: TrialStart) -> Reading:
        """Begin trials in some environments; the others continue.

        Args:
            start: environment indices, and the starts of their trials.

        Returns:
            The reading at time zero.
        """
        ids, positions = start.ids, start.positions
        if len(self._missing_joints):
            positions = positions.copy()
            positions[:, self._missing_joints] = 0.0
        self._resize_motions(start.motions.shape[1], all_heads=len(ids) == self.num)
        self._streams.start(ids, start.seeds, start.trials)
        self._true_heads.draw(self._streams, ids)
        starting.begin_trials(
            ids, positions, start.motions, untyped_tuple(self._true_heads.packed),
            untyped_tuple(self._streams.keys), untyped_tuple(self._scene),
            untyped_tuple(self._motors), self._coupling, untyped_tuple(self._commands),
            untyped_tuple(self._feedback), untyped_tuple(self._frames),
            untyped_tuple(self.reading),
        )  # fmt: skip
        self._put_at_rest(ids)
        self._advance(ids, WARM_UP | REPORT)
        self.reading.frame[ids] = 0
        return self.reading

    def step(self, command: FloatArray) -> Reading:
        """Hold a command for one control period, see `Plant.step`.

        Raises:
            ConfigurationError: a command is nan, or the shape is wrong.
        """
        if command.shape != (self.num, 7):
            raise ConfigurationError(
                f"command: expected shape ({self.num}, 7), got {command.shape}"
            )
        self._task.command[:] = command
        if not self._advance(self._all, STORE | MOVE | EXPOSE | REPORT):
            raise ConfigurationError("command: expected numbers, got nan")
        return self.reading

    def move_targets(self, ids: IntArray, motions: FloatArray) -> None:
        """See `Simulation.move_targets`."""
        self._resize_motions(motions.shape[1], all_heads=len(ids) == self.num)
        self._scene.motions[ids, : motions.shape[1]] = motions

    def truth(self) -> Truth:
        """Ground truth of the present, without delay or noise."""
        target_time_s = self._scene.step * self.head.timing.period_s - self.conditions.onset_s
        # a jump at the time of a control step counts as done
        target_time_s[np.abs(target_time_s) < TIME_TOLERANCE_S] = 0.0
        return self._truth_at(target_time_s)

    def truth_at_rest(self) -> Truth:
        """See `Simulation.truth_at_rest`."""
        return self._truth_at(last_jump_time(self._scene.motions))

    def _truth_at(self, target_time_s: FloatArray) -> Truth:
        """Ground truth of the present, with the targets at given own times."""
        truth = Truth.unknown(self.num)
        period_s = self.head.timing.period_s
        update_truth(
            self.head.packed,
            period_s,
            target_time_s,
            untyped_tuple(self._scene),
            untyped_tuple(truth),
        )
        truth.motors[:] = self._motors.angles
        return truth

    def onset_s(self) -> FloatArray:
        """See `Simulation.onset_s`."""
        return self.conditions.onset_s + last_jump_time(self._scene.motions)

    def first_detection_times(self) -> tuple[FloatArray, FloatArray]:
        """See `Simulation.first_detection_times`."""
        packed, keys = untyped_tuple(self._true_heads.packed), untyped_tuple(self._streams.keys)
        scene = untyped_tuple(self._scene)
        first, last = np.empty((2, self.num))
        jumps = self._scene.motions[:, JUMP].copy()
        starting.first_detection_times(packed, keys, scene, jumps, first)
        jumps = last_jump_time(self._scene.motions)
        starting.first_detection_times(packed, keys, scene, jumps, last)
        return first, last

    def state(self) -> Arrays:
        """See `Simulation.state`."""
        return copy_arrays(self._arrays())

    def _resize_motions(self, width: int, *, all_heads: bool) -> None:
        """Give the rows of the targets' motions a length of `width`, or more if some are kept."""
        rows = self._scene.motions
        if width > rows.shape[1] or (all_heads and width < rows.shape[1]):
            resized = np.zeros((self.num, width))
            kept = min(width, rows.shape[1])
            resized[:, :kept] = rows[:, :kept]
            self._scene = self._scene._replace(motions=resized)
            self._kept_table = None

    def restore(self, state: Arrays) -> Reading:
        """See `Simulation.restore`."""
        if "scene.motions" in state:
            self._resize_motions(state["scene.motions"].shape[1], all_heads=True)
        restore_arrays(self._arrays(), state)
        return self.reading

    def _arrays(self) -> Arrays:
        """State arrays, by name."""
        scene, feedback = self._scene._asdict(), self._feedback
        del scene["heads"]  # part of the conditions
        motors = self._motors
        return join_parts(
            conditions=self._true_heads.state_arrays(),
            keys=self._streams.keys._asdict(),
            motors={name: getattr(motors, field) for name, field in SAVED_MOTOR_FIELDS.items()},
            commands={"given": self._commands.velocities},
            feedback={
                name: getattr(feedback, field) for name, field in SAVED_FEEDBACK_FIELDS.items()
            },
            frames=self._frames._asdict(),
            scene=scene,
            reading=self.reading._asdict(),
        )

    def close(self) -> None:
        """Bring the joints to rest where they are."""
        self._scene.velocities[:] = 0.0
        self._motors.speeds[:] = 0.0
        self._motors.accelerations[:] = 0.0
        self._commands.velocities[:] = 0.0
        self.reading.command[:] = 0.0
        self._put_at_rest(self._all)
