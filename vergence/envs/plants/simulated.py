"""What all simulated plants share: true heads, targets, the sensor model, the random streams."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from vergence.envs.plant import TrialStart
from vergence.envs.plants import sensing, starting
from vergence.envs.plants.conditions import Conditions, TrueHeads
from vergence.envs.plants.scene import look
from vergence.envs.plants.variation import RANGES, Variation, make_variation
from vergence.envs.reading import Reading, Truth
from vergence.envs.streams import IntArray, Streams
from vergence.envs.targets.motion import MOTION
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.joint_response import limit_commands
from vergence.models.parts import FloatArray


class SimulatedPlant(ABC):
    """A batch of simulated heads.

    Args:
        head: the model that a controller knows; its timing and sensors are the plant's
            unless overridden.
        num: how many heads move side by side.
        true_head: the heads that really move: one, or a population of shape (num,). None
            for the model itself.
        latency_frames: (num,) or a scalar, control periods from exposure to reading. A
            reading still dates its image by the model's latency.
        lag_s: (num,) or a scalar, time constants of the joints' response, s.
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
        if num < 1:
            raise ConfigurationError(f"num: expected at least one head, got {num}")
        if head.batch_shape:
            raise ConfigurationError(
                f"head: expected one head, got a population of shape {head.batch_shape}"
            )
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
        self._streams = Streams(num)
        self._all = np.arange(num)
        self._allocate()

    def _followed(self, variation: Variation | None) -> Variation | None:
        for name in (*RANGES, "model_errors") if variation is not None else ():
            if name not in self._varies and getattr(variation, name) is not None:
                raise ConfigurationError(
                    f"variation.{name}: expected a plant that can vary it, "
                    f"got {type(self).__name__}, which can vary {', '.join(sorted(self._varies))}"
                )
        return variation

    @property
    def true_head(self) -> HeadModel:
        """The heads that really move: one, or a population of shape (num,)."""
        return self._true_heads.model

    @property
    def conditions(self) -> Conditions:
        """What the running trials run with, in arrays that the next trials change."""
        return self._true_heads.conditions

    def _allocate(self) -> None:
        num = self.num
        ring = self._true_heads.longest_latency + self.head.timing.periods_per_frame
        self._ring = ring
        self._q = np.zeros((num, 7))
        self._v = np.zeros((num, 7))
        self._command = np.zeros((num, 7))
        self._necks = np.zeros((num, 3))
        self._step = np.zeros(num, dtype=np.int64)
        self._motions = np.zeros((num, MOTION))
        self._frame_pixels = np.zeros((num, ring, 2, 2))
        self._frame_visible = np.zeros((num, ring, 2), dtype=np.bool_)
        self._frame_arrived = np.zeros((num, ring), dtype=np.bool_)
        self._angles = np.zeros((num, ring, 7))
        self.reading = Reading.empty(num)

    @abstractmethod
    def _place(self, ids: IntArray) -> None:
        """Put the joints of some heads at rest where `_q` says."""

    @abstractmethod
    def _move(self) -> None:
        """Hold `_command` for a period and bring `_q` and `_v` up to date."""

    def reset(self, start: TrialStart) -> Reading:
        """Begin trials at some places; the others go on as they were.

        Args:
            start: the places and how their trials begin.

        Returns:
            The reading at time zero.
        """
        ids = start.ids
        self._streams.start(ids, start.seeds, start.trials)
        self._true_heads.draw(self._streams, ids)
        seen_before = starting.begin(
            ids,
            start.positions,
            start.motions,
            self.head.sensor.encoder_resolution_rad,
            self._q,
            self._v,
            self._command,
            self._necks,
            self._motions,
            self._step,
            self._frame_arrived,
            self._angles,
            self.reading.pixels,
            self.reading.visible,
            self.reading.exposure_s,
            self.reading.received_s,
            self.reading.positions_at_exposure,
        )
        self._place(ids)
        self._fill_before(ids, seen_before)
        if self.head.timing.periods_per_frame > 1:
            # the newest image at time zero may have been readable for some periods already
            for step in range(1 - self.head.timing.periods_per_frame, 0):
                self._step[ids] = step
                self._read(ids)
            self._step[ids] = 0
        self._sense(ids)
        return self.reading

    def step(self, joint_velocity: FloatArray) -> Reading:
        """Hold a command for one control period.

        Args:
            joint_velocity: (n, 7) rad/s; clipped to the joints' speeds.

        Returns:
            The reading at the end of the period, in arrays that the next step changes.

        Raises:
            ConfigurationError: a command is nan, or the shape is wrong.
        """
        if joint_velocity.shape != (self.num, 7):
            raise ConfigurationError(
                f"joint_velocity: expected shape ({self.num}, 7), got {joint_velocity.shape}"
            )
        limits = self.head.limits
        if not limit_commands(joint_velocity, limits.velocity, self._command):
            raise ConfigurationError("joint_velocity: expected numbers, got nan")
        self._move()
        self._step += 1
        self._sense(self._all)
        return self.reading

    def truth(self) -> Truth:
        """The present without delay and noise."""
        truth = Truth(
            time_s=np.asarray(self._step * self.head.timing.period_s, dtype=np.float64),
            positions=self._q.copy(),
            velocities=self._v.copy(),
            target=np.empty((self.num, 3)),
            pixels=np.empty((self.num, 2, 2)),
            pixel_error=np.empty((self.num, 2, 2)),
            image_visible=np.empty((self.num, 2), dtype=np.bool_),
        )
        look(
            self.conditions.heads,
            self.head.packed,
            self._motions,
            self._necks,
            self._q,
            self._step,
            self.head.timing.period_s,
            truth.target,
            truth.pixels,
            truth.pixel_error,
            truth.image_visible,
        )
        return truth

    def close(self) -> None:
        """Release what the plant holds: nothing, unless a subclass says otherwise."""

    def _fill_before(self, ids: IntArray, any_seen: bool) -> None:
        """Take the frames before time zero, of those places whose target was there."""
        if not any_seen:
            return
        starting.expose_before(
            self.conditions.heads,
            self._motions,
            self._necks,
            self._q,
            ids,
            self.conditions.detection_noise_px,
            self._streams.seeds,
            self._streams.trials,
            self.head.timing.periods_per_frame,
            self._frame_pixels,
            self._frame_visible,
            self._frame_arrived,
        )

    def _sense(self, ids: IntArray) -> None:
        """Take the present frames of some places, and read their sensors."""
        timing = self.head.timing
        sensing.expose(
            ids,
            self.conditions.heads,
            self._motions,
            self._necks,
            self._q,
            self._step,
            timing.period_s,
            timing.periods_per_frame,
            self.conditions.detection_noise_px,
            self.conditions.dropped_frame_probability,
            self._streams.seeds,
            self._streams.trials,
            self._frame_pixels,
            self._frame_visible,
            self._frame_arrived,
        )
        if timing.exposure_s > 0.0:
            sensing.smear(
                ids,
                self.conditions.heads,
                self._motions,
                self._necks,
                self._q,
                self._v,
                self._step,
                timing.period_s,
                timing.exposure_s,
                self.head.sensor.max_smear_px,
                self._frame_visible,
                self._frame_arrived,
            )
        self._read(ids)

    def _read(self, ids: IntArray) -> None:
        """Read the sensors of some places."""
        timing, sensor = self.head.timing, self.head.sensor
        sensing.read(
            ids,
            self._q,
            self._v,
            self._step,
            timing.period_s,
            self.conditions.latency_frames,
            timing.latency_frames,
            sensor.encoder_resolution_rad,
            sensor.velocity_resolution_rad_s,
            self._frame_pixels,
            self._frame_visible,
            self._frame_arrived,
            self._angles,
            *self.reading,
        )
