"""What all simulated plants share: true heads, targets, the sensor model, the random streams."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike

from vergence._jit import bare
from vergence.envs.fields import count
from vergence.envs.plant import Plant, TrialStart
from vergence.envs.plants import starting
from vergence.envs.plants.conditions import Conditions, TrueHeads
from vergence.envs.plants.motors import Motors
from vergence.envs.plants.scene import Scene, look
from vergence.envs.plants.sensing import Frames, Sensor, read, sense
from vergence.envs.plants.variation import RANGES, Variation, make_variation
from vergence.envs.reading import Reading, Truth
from vergence.envs.saved_state import Arrays, copied, named, put_back
from vergence.envs.streams import IntArray, Streams
from vergence.envs.targets.board import POINT, Board
from vergence.envs.targets.motion import motion_rows
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.joint_response import limit_commands
from vergence.models.parts import FloatArray

_AHEAD: Final = (0.0, 0.0, 1.0)
"""Where the targets are until trials are drawn, in N, m."""


class SimulatedPlant(Plant):
    """A batch of simulated heads.

    Args:
        head: the model that a controller knows; its timing and sensors are the plant's
            unless overridden.
        num: how many heads move side by side.
        true_head: the heads that really move: one, or a population of shape (num,). None
            for the model itself.
        latency_frames: (num,) or a scalar, control periods from exposure to reading. A
            reading still dates its image by the model's latency.
        lag_s: (num,) or a scalar, time constants of the joints' response, s; an actuator with a lag
            of its own keeps its ratio to the head's.
        detection_noise_px: (num,) or a scalar, px.
        dropped_frame_probability: (num,) or a scalar.
        variation: what each trial draws anew instead, see `vergence.envs.plants.variation`.

    Raises:
        ConfigurationError: an argument has a shape or value that cannot be.
    """

    _varies: ClassVar[frozenset[str]] = frozenset((*RANGES, "model_errors"))
    """The fields of a variation that this plant can follow."""

    def __init__(
        self,
        head: HeadModel,
        num: int = 1,
        *,
        true_head: HeadModel | None = None,
        latency_frames: ArrayLike | None = None,
        lag_s: ArrayLike | None = None,
        detection_noise_px: ArrayLike | None = None,
        dropped_frame_probability: ArrayLike | None = None,
        variation: Variation | Mapping[str, Any] | None = None,
    ) -> None:
        num = count("num", num)
        if head.batch_shape:
            raise ConfigurationError(
                f"head: expected one head, got a population of shape {head.batch_shape}"
            )
        if true_head is not None and not isinstance(true_head, HeadModel):
            raise ConfigurationError(f"true_head: expected a HeadModel, got {true_head!r:.80}")
        self._true_heads = TrueHeads(
            head,
            num,
            true_head=true_head,
            latency_frames=latency_frames,
            lag_s=lag_s,
            detection_noise_px=detection_noise_px,
            dropped_frame_probability=dropped_frame_probability,
            variation=self._followed(make_variation(variation)),
        )
        self.head = head
        self.num = num
        self.reading = Reading.empty(num)
        self._all = np.arange(num)
        self._streams = Streams(num)
        self._ring = self._true_heads.longest_latency + head.timing.periods_per_frame
        self._frames = Frames.empty(num, self._ring)
        self._scene = Scene(
            heads=self.conditions.heads,
            motions=motion_rows(np.tile(_AHEAD, (num, 1))),
            necks=np.zeros((num, 3)),
            step=np.zeros(num, dtype=np.int64),
            positions=np.zeros((num, 7)),
            velocities=np.zeros((num, 7)),
        )
        self._motors = Motors.of(head, num)
        """None where each eye joint has its own motor: the scene's joints are the motors."""
        self._missing = np.flatnonzero([not name for name in head.joints])
        # made once: every step hands them to kernels
        self._sensor = bare(Sensor.of(head))
        self._drawn = (bare(self.conditions), bare(self._streams.keys))
        self._state = (bare(self._scene), bare(self._frames))
        self._turned = None if self._motors is None else bare(self._motors)
        self._report = (bare(self.reading), self._turned)

    def _followed(self, variation: Variation | None) -> Variation | None:
        for name in (*RANGES, "model_errors") if variation is not None else ():
            if name not in self._varies and getattr(variation, name) is not None:
                raise ConfigurationError(
                    f"variation.{name}: expected a plant that can vary it, "
                    f"got {type(self).__name__}, which can vary {', '.join(sorted(self._varies))}"
                )
        return variation

    @property
    def simulation(self) -> "SimulatedPlant":
        """Itself."""
        return self

    @property
    def true_head(self) -> HeadModel:
        """The heads that really move: one, or a population of shape (num,)."""
        return self._true_heads.model

    @property
    def conditions(self) -> Conditions:
        """What the running trials run with, in arrays that the next trials change."""
        return self._true_heads.conditions

    @property
    def board(self) -> Board:
        """What a target looks like to the eyes: a point, for a plant without images."""
        return POINT

    @abstractmethod
    def _place(self, ids: IntArray) -> None:
        """Put the joints of some heads at rest where the scene says."""

    @abstractmethod
    def _move(self) -> None:
        """Hold the reading's command for a period and bring the scene's joints up to date."""

    def reset(self, ids: IntArray, positions: FloatArray) -> Reading:
        """Put heads at rest and begin their last trials anew, see `Plant.reset`."""
        keys = self._streams.keys
        motions = self._scene.motions[ids]
        return self.begin(TrialStart(ids, keys.seeds[ids], keys.trials[ids], positions, motions))

    def begin(self, start: TrialStart) -> Reading:
        """Begin trials at some places; the others go on as they were.

        Args:
            start: the places and how their trials begin.

        Returns:
            The reading at time zero.
        """
        ids, positions = start.ids, start.positions
        if len(self._missing):
            positions = positions.copy()
            positions[:, self._missing] = 0.0
        self._streams.start(ids, start.seeds, start.trials)
        self._true_heads.draw(self._streams, ids)
        seen_before = starting.begin(
            ids, positions, start.motions, self._sensor, *self._state, *self._report
        )
        self._place(ids)
        self._fill_before(ids, seen_before)
        if self.head.timing.periods_per_frame > 1:
            # the newest image at time zero may have been readable for some periods already
            for step in range(1 - self.head.timing.periods_per_frame, 0):
                self._scene.step[ids] = step
                self._read(ids)
            self._scene.step[ids] = 0
        self._sense(ids)
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
        if not limit_commands(command, self.head.actuation.velocity, self.reading.command):
            raise ConfigurationError("command: expected numbers, got nan")
        self._move()
        self._scene.step[:] += 1
        self._sense(self._all)
        return self.reading

    def truth(self) -> Truth:
        """The present without delay and noise."""
        truth = Truth.unknown(self.num)
        look(self.head.packed, self.head.timing.period_s, bare(self._scene), bare(truth))
        return truth

    def state(self) -> Arrays:
        """See `Simulation.state`."""
        return copied(self._arrays())

    def restore(self, state: Arrays) -> Reading:
        """See `Simulation.restore`."""
        put_back(self._arrays(), state)
        return self.reading

    def _arrays(self) -> Arrays:
        """The arrays that hold the state."""
        scene = self._scene._asdict()
        del scene["heads"]  # those of the conditions
        motors = {}
        if self._motors is not None:
            state = self._motors
            of_motors = {"angles": state.angles, "speeds": state.speeds, "driven": state.driven}
            motors = {"motors": of_motors}
        return named(
            **motors,
            conditions=self._true_heads.arrays(),
            keys=self._streams.keys._asdict(),
            frames=self._frames._asdict(),
            scene=scene,
            reading=self.reading._asdict(),
        )

    def close(self) -> None:
        """Bring the joints to rest where they are."""
        self._scene.velocities[:] = 0.0
        if self._motors is not None:
            self._motors.speeds[:] = 0.0
        self.reading.command[:] = 0.0
        self._place(self._all)

    def _fill_before(self, ids: IntArray, any_seen: bool) -> None:
        """Take the frames before time zero, of those places whose target was there."""
        if any_seen:
            starting.expose_before(ids, self._sensor, *self._drawn, *self._state)

    def _sense(self, ids: IntArray) -> None:
        """Take the present frames of some places, and read their sensors."""
        sense(ids, self._sensor, *self._drawn, *self._state, *self._report)

    def _read(self, ids: IntArray) -> None:
        """Read the sensors of some places."""
        read(ids, self._sensor, self._drawn[0], *self._state, *self._report)
