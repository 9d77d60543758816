"""Common part of all simulated plants: true heads, targets, control loop, random streams."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from inspect import Parameter, signature
from typing import Any, ClassVar, Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.envs.plant import Plant, Simulation, TrialStart
from vergence.envs.plants.cameras import (
    TIME_TOLERANCE_S,
    Exposures,
    Frames,
    TrueHeadsAndTargets,
    update_truth,
)
from vergence.envs.plants.conditions import (
    IMPERFECTIONS,
    PER_ACTUATOR,
    PER_TRIAL,
    RANGES,
    TRIAL_CONDITIONS,
    Conditions,
    PackedConditions,
    Variation,
    draw_conditions,
    draw_head_deviates,
    is_valid_range,
    make_variation,
    valid_range_text,
)
from vergence.envs.plants.motors import (
    ActuatorCoupling,
    CommandBuffers,
    JointFeedbackBuffers,
    MotorStates,
)
from vergence.envs.plants.step import (
    ALL_PHASES,
    BEGIN,
    EXPOSE,
    MOVE,
    REPORT,
    STORE,
    WARM_UP,
    SensorTiming,
    StepArrays,
    first_detection_times,
)
from vergence.envs.reading import Reading, Truth, check_count, real_number_array
from vergence.envs.reward import JUDGE, TaskArrays
from vergence.envs.streams import (
    Arrays,
    IntArray,
    KeyArray,
    RandomStreams,
    copy_arrays,
    join_parts,
    restore_arrays,
)
from vergence.envs.targets.motion import last_jump_time, motion_fields, motion_rows
from vergence.errors import ConfigurationError, refuse_unknown
from vergence.kernels import make_table
from vergence.models.head import HeadModel
from vergence.models.kinematics import PACKED
from vergence.models.parts import FloatArray
from vergence.models.perturbation import DEVIATES

_HEADS_AHEAD: Final = 4
"""Heads kept per environment, of the running trial and the next (chosen: with 1,024 environments,
some hundred trials end before one of them needs more)."""


def _place(trials: KeyArray) -> IntArray:
    return (trials % np.uint64(_HEADS_AHEAD)).astype(np.int64)


class TrueHeadPrefetcher:
    """True heads of coming trials, made in advance: a few cost as much as a hundred.

    The environments of a batch usually go on to their next trials one by one. When one of them
    needs a head that is not made yet, the heads of all environments' next trials are made with it.
    """

    def __init__(self, variation: Variation, head: HeadModel, num: int) -> None:
        self._variation = variation
        self._head = head
        shape = (num, _HEADS_AHEAD)  # a trial's place is its number's remainder
        self._deviates = np.zeros((*shape, DEVIATES))
        self._packed = np.zeros((*shape, PACKED))
        self._seeds, self._trials = np.zeros((2, *shape), dtype=np.uint64)
        self._ready = np.zeros(shape, dtype=np.bool_)

    def take(self, streams: RandomStreams, ids: IntArray) -> tuple[FloatArray, FloatArray]:
        """Deviates (m, DEVIATES) and heads (m, PACKED) of the trials of some environments."""
        seeds, trials = streams.keys_of(ids)
        own = ids, _place(trials)
        if not self._holds(own, seeds, trials).all():
            self._keep(own, seeds, trials)
            if len(ids) < len(self._ready):  # if a whole batch begins, it may have no next trials
                self._fill(streams)
        return self._deviates[own], self._packed[own]

    def _holds(self, places: Any, seeds: KeyArray, trials: KeyArray) -> NDArray[np.bool_]:
        same = (self._seeds[places] == seeds) & (self._trials[places] == trials)
        return np.asarray(self._ready[places] & same)

    def _fill(self, streams: RandomStreams) -> None:
        """Make the heads of the next trials of all environments."""
        ahead = np.arange(_HEADS_AHEAD, dtype=np.uint64)
        trials: KeyArray = np.add.outer(streams.trials, ahead)
        rows = np.arange(len(trials))[:, None]
        seeds = np.broadcast_to(streams.seeds[:, None], trials.shape)
        missing = ~self._holds((rows, _place(trials)), seeds, trials)
        missing[:, 0] = False  # the running trials
        rows = np.broadcast_to(rows, trials.shape)[missing]
        self._keep((rows, _place(trials[missing])), seeds[missing], trials[missing])

    def _keep(self, places: Any, seeds: KeyArray, trials: KeyArray) -> None:
        deviates = draw_head_deviates(seeds, trials, DEVIATES)
        self._deviates[places] = deviates
        self._packed[places] = self._variation.make_true_heads(self._head, deviates).packed
        self._seeds[places], self._trials[places] = seeds, trials
        self._ready[places] = True


class TrueHeadsAndConditions:
    """True heads of a batch, and the conditions of their running trials; see `SimulatedPlant`."""

    def __init__(
        self, head: HeadModel, num: int, true_head: HeadModel | None,
        given: Mapping[str, ArrayLike | None], variation: Variation | None,
    ) -> None:  # fmt: skip
        self.variation = variation
        self._heads_vary = variation is not None and variation.model_errors is not None
        if self._heads_vary and true_head is not None:
            raise ConfigurationError(
                "expected one of variation.model_errors, model_errors and true_head, got two"
            )
        true_head = head if true_head is None else true_head
        if true_head.batch_shape not in ((), (1,), (num,)):
            raise ConfigurationError(
                f"true_head: expected one head or {num}, got shape {true_head.batch_shape}"
            )
        own, true = head.actuation, true_head.actuation
        if (own.direct, own.count) != (true.direct, true.count):
            raise ConfigurationError(
                f"true_head: expected actuators as the model has ({', '.join(own.names)}), got "
                f"{', '.join(true.names) or 'none'}"
            )
        self._head = head
        self._head_cache: TrueHeadPrefetcher | None = None
        self.given = true_head
        """True heads before model errors are drawn; they set the limits."""
        heads = np.array(true_head.packed.reshape(-1, PACKED))  # writable: kernels of one type
        if variation is not None and self._heads_vary:
            heads = np.repeat(heads, num, axis=0)
            self._deviates = np.zeros((num, DEVIATES))
            self._head_cache = TrueHeadPrefetcher(variation, true_head, num)
        self.packed = PackedConditions(
            np.empty((num, TRIAL_CONDITIONS)), np.empty((num, len(PER_ACTUATOR), 7)), heads
        )
        """Conditions of the running trials, in packed arrays that the next trials change."""
        self.conditions = _by_name(self.packed)
        """Conditions by name: views of the packed arrays."""
        drawn = variation or Variation()
        self._ranges = drawn.ranges(PER_TRIAL), drawn.ranges(PER_ACTUATOR)
        for name in IMPERFECTIONS:
            getattr(self.conditions, name)[:] = _values(num, name, given.get(name), true_head)
        self._derive()

    def __getstate__(self) -> dict[str, Any]:
        state = vars(self).copy()
        del state["conditions"]  # a copy would have separate arrays in place of views
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.conditions = _by_name(self.packed)

    def _derive(self) -> None:
        """Update the time between frames, which follows from clock drift and frame rate."""
        now = self.conditions
        self.packed.loop[:, len(PER_TRIAL)] = (1.0 + now.clock_drift) / now.frame_rate_hz

    @property
    def model(self) -> HeadModel:
        """The true heads: one, or a population of shape (num,)."""
        if self.variation is not None and self._heads_vary:
            return self.variation.make_true_heads(self.given, self._deviates)
        return self.given

    def largest_value(self, name: str) -> float:
        """Largest value of an imperfection in any trial."""
        given = float(getattr(self.conditions, name).max())
        return given if self.variation is None else self.variation.largest_value(name, given)

    def state_arrays(self) -> Arrays:
        """Conditions of the running trials, as state arrays."""
        arrays: Arrays = self.packed._asdict()
        if self._heads_vary:
            arrays["deviates"] = self._deviates
        else:
            del arrays["heads"]  # given once and for all
        return arrays

    def draw(self, streams: RandomStreams, ids: IntArray) -> None:
        """Draw the varying conditions of the trials of some environments."""
        variation, packed = self.variation, self.packed
        if variation is None:
            return
        keys = streams.seeds, streams.trials
        draw_conditions(*keys, ids, *self._ranges, packed.loop, packed.own)
        self._derive()
        if variation.backlash_rad is not None:
            backlash_rad = self.conditions.backlash_rad  # only of the eyes: the neck is held
            backlash_rad[:, :3] = backlash_rad[:, 3 + self._head.actuation.count :] = 0.0
        if self._head_cache is not None:
            self._deviates[ids], self.conditions.heads[ids] = self._head_cache.take(streams, ids)


def _by_name(packed: PackedConditions) -> Conditions:
    """View packed conditions by name."""
    views = {name: packed.loop[:, i] for i, name in enumerate(PER_TRIAL)}
    views |= {name: packed.own[:, i] for i, name in enumerate(PER_ACTUATOR)}
    return Conditions(**views, heads=packed.heads)


def _values(num: int, name: str, given: ArrayLike | None, head: HeadModel) -> FloatArray:
    """(num,) or (num, 7) values of an imperfection: as given, or the head's own."""
    one = IMPERFECTIONS[name]
    if given is None:
        return np.broadcast_to(one.nominal(head), (num, 7) if one.by_actuator else num)
    shape = "a number" if num == 1 else f"a number or {num} numbers"
    try:
        numbers = real_number_array(given)
        if one.by_actuator:
            shape += f", or ({num}, {head.actuation.count}) by actuator of the eyes"
            values = np.full((num, 7), one.default)
            eyes = values[:, 3 : 3 + head.actuation.count]
            eyes[:] = numbers[:, None] if numbers.ndim == 1 else numbers
        else:
            values = np.broadcast_to(numbers, (num,)).copy()
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"{name}: expected {shape}, got {given!r:.80}") from error
    if not (
        np.isfinite(values).all() and is_valid_range(name, float(values.min()), float(values.max()))
    ):
        raise ConfigurationError(f"{name}: expected {valid_range_text(name)}, got {given!r:.80}")
    return values


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
            `vergence.envs.plants.conditions`.
        **loop: imperfections of the loop by the names of `vergence.envs.plants.conditions`, such
            as `latency_s`: numbers or (num,) arrays; also (num, m) over the eye actuators for
            imperfections of which each actuator has its own.

    Raises:
        ConfigurationError: an argument has an invalid shape or value.
    """

    _varies: ClassVar[frozenset[str]] = frozenset((*RANGES, "model_errors"))
    """Fields of a variation that this plant supports."""
    _kept_table: NDArray[np.void] | None = None

    def __init_subclass__(cls) -> None:
        """Let a subclass with a step of its own be judged like any other plant."""
        super().__init_subclass__()
        if cls.step is not SimulatedPlant.step:
            cls.join, cls.act, cls.judge = Plant.join, Plant.act, Plant.judge  # type: ignore[method-assign]

    @_named
    def __init__(
        self, head: HeadModel, num: int = 1, *, true_head: HeadModel | None = None,
        variation: Variation | Mapping[str, Any] | None = None, **loop: ArrayLike | None,
    ) -> None:  # fmt: skip
        refuse_unknown("plant_options", loop, IMPERFECTIONS)
        num = check_count("num", num)
        if head.batch_shape:
            raise ConfigurationError(
                f"head: expected one head, got a population of shape {head.batch_shape}"
            )
        if true_head is not None and not isinstance(true_head, HeadModel):
            raise ConfigurationError(f"true_head: expected a HeadModel, got {true_head!r:.80}")
        variation = make_variation(variation)
        for name in (*RANGES, "model_errors") if variation is not None else ():
            if name not in self._varies and getattr(variation, name) is not None:
                raise ConfigurationError(
                    f"variation.{name}: expected a plant that can vary it, "
                    f"got {type(self).__name__}, which can vary {', '.join(sorted(self._varies))}"
                )
        self._true_heads = heads = TrueHeadsAndConditions(head, num, true_head, loop, variation)
        self.head = head
        self.num = num
        self.reading = Reading.empty(num)
        self._all = np.arange(num)
        self._streams = RandomStreams(num)
        timing, period_s, sensor = head.timing, head.timing.period_s, head.sensor
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
            num, heads.given.actuation.velocity, sensor.command_resolution_rad_s,
            heads.largest_value("command_latency_s"), period_s,
        )  # fmt: skip
        # the reading of an image looks up joint angles as old as its date
        max_age_s = max(late_s, timing.latency_s) + 1.0 / max_hz + timing.feedback_latency_s
        max_age_s = max(max_age_s, heads.largest_value("speed_span_s"))
        max_age_s += stalled_s + period_s
        feedback_s = heads.largest_value("feedback_latency_s")
        feedback_s += heads.largest_value("speed_latency_s")
        self._feedback = JointFeedbackBuffers.of(head, num, feedback_s, max_age_s)
        self._timing = SensorTiming.of(head)
        self._scene = TrueHeadsAndTargets(
            heads=heads.packed.heads, motions=motion_rows(np.tile(_INITIAL_TARGET_POINT, (num, 1))),
            necks=np.zeros((num, 3)), step=np.zeros(num, dtype=np.int64),
            positions=np.zeros((num, 7)), velocities=np.zeros((num, 7)),
        )  # fmt: skip
        self._missing_joints = np.flatnonzero([not name for name in head.joints])
        self._task = TaskArrays.empty(head, num)

    @property
    def true_head(self) -> HeadModel:
        """See `Simulation.true_head`."""
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
        """Run phases of a control period, see `vergence.envs.plants.step`; False for a nan."""

    def join(self, task: TaskArrays) -> None:
        """See `Plant.join`; a step is then judged in the call that makes it."""
        super().join(task)
        self._task, self._kept_table = task, None

    def act(self) -> Reading | None:
        """See `Plant.act`."""
        return self.reading if self._advance(self._all, ALL_PHASES) else None

    def judge(self, ids: IntArray, reading: Reading) -> Reading:
        """See `Plant.judge`."""
        if reading is not self.reading:
            return super().judge(ids, reading)
        self._advance(ids, JUDGE)
        return reading

    def _motion_arrays(self) -> tuple[Any, ...]:
        """The plant's own arrays for the phase in which it moves the joints."""
        return ()

    @property
    def _table(self) -> NDArray[np.void]:
        """Table of the arrays of a step, made again once one of them has been replaced."""
        if self._kept_table is None:
            arrays = StepArrays(
                timing=self._timing, packed=self._true_heads.packed, keys=self._streams.keys,
                scene=self._scene, motors=self._motors, coupling=self._coupling,
                commands=self._commands, feedback=self._feedback, frames=self._frames,
                exposures=self._exposures, reading=self.reading, task=self._task,
                motion=self._motion_arrays(),
            )  # fmt: skip
            self._kept_table = make_table(arrays)
        return self._kept_table

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_kept_table": None}

    def reset(self, ids: IntArray, positions: FloatArray) -> Reading:
        """Put heads at rest and restart their last trials, see `Plant.reset`."""
        keys, motions = self._streams.keys_of(ids), self._scene.motions[ids]
        return self.begin(TrialStart(ids, *keys, positions, motions))

    def begin(self, start: TrialStart) -> Reading:
        """See `Simulation.begin`."""
        ids, positions = start.ids, start.positions
        if len(self._missing_joints):
            positions = positions.copy()
            positions[:, self._missing_joints] = 0.0
        self.move_targets(ids, start.motions)
        self._scene.positions[ids] = positions
        self._streams.start(ids, start.seeds, start.trials)
        self._true_heads.draw(self._streams, ids)
        self._advance(ids, BEGIN)
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
        truth, period_s = Truth.unknown(self.num), self.head.timing.period_s
        update_truth(self.head.packed, period_s, target_time_s, self._scene, truth)
        truth.motors[:] = self._motors.angles
        return truth

    def onset_s(self) -> FloatArray:
        """See `Simulation.onset_s`."""
        return self.conditions.onset_s + last_jump_time(self._scene.motions)

    def first_detection_times(self) -> tuple[FloatArray, FloatArray]:
        """See `Simulation.first_detection_times`."""
        packed, keys, motions = self._true_heads.packed, self._streams.keys, self._scene.motions
        first, last = np.empty((2, self.num))
        jumps = motion_fields(motions)["jump_time"].copy()
        for since_s, times in ((jumps, first), (last_jump_time(motions), last)):
            first_detection_times(packed, keys, self._scene, since_s, times)
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
        angles, speeds, accelerations, outputs = self._motors[:4]
        measured, reported, loops, filtered = self._feedback[:4]
        scene = self._scene._asdict()
        del scene["heads"]  # part of the conditions
        return join_parts(
            conditions=self._true_heads.state_arrays(), keys=self._streams.keys._asdict(),
            motors={
                "angles": angles, "speeds": speeds, "accelerations": accelerations,
                "driven": outputs,
            },
            commands={"given": self._commands.velocities},
            feedback={
                "measured": measured, "told": reported, "loops": loops, "filtered": filtered,
            },
            frames=self._frames._asdict(), scene=scene, reading=self.reading._asdict(),
        )  # fmt: skip

    def close(self) -> None:
        """Bring the joints to rest where they are."""
        self._scene.velocities[:] = 0.0
        self._motors.speeds[:] = 0.0
        self._motors.accelerations[:] = 0.0
        self._commands.velocities[:] = 0.0
        self.reading.command[:] = 0.0
        self._put_at_rest(self._all)
