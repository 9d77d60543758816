"""What the heads of a batch really run with: as given, or drawn anew for each trial."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.envs.plants.variation import RANGES, Variation
from vergence.envs.saved_state import Arrays
from vergence.envs.streams import IntArray, Streams
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.packed import PACKED
from vergence.models.parts import FloatArray
from vergence.models.perturbation import DEVIATES


class Conditions(NamedTuple):
    """What the trials of a batch of heads really run with, hidden from the controller."""

    latency_frames: NDArray[np.int64]
    """(n,) control periods from exposure to reading."""
    lag_s: FloatArray
    """(n,) time constants of the joints' response, s; actuators have ratios to it."""
    detection_noise_px: FloatArray
    """(n,) standard deviation of the detection, px."""
    dropped_frame_probability: FloatArray
    """(n,) probability that a frame never arrives."""
    heads: FloatArray
    """(n or 1, PACKED) the true heads, see `vergence.models.kinematics`."""


class TrueHeads:
    """The heads of a batch as they really are, and what their running trials run with.

    Args:
        head: the model that a controller knows.
        num: how many.
        true_head: see `vergence.envs.plants.simulated.SimulatedPlant`, as are the rest.
        latency_frames: (num,) or a scalar.
        lag_s: (num,) or a scalar, s.
        detection_noise_px: (num,) or a scalar, px.
        dropped_frame_probability: (num,) or a scalar.
        variation: what each trial draws.

    Raises:
        ConfigurationError: an argument has a shape or value that cannot be.
    """

    def __init__(
        self,
        head: HeadModel,
        num: int,
        *,
        true_head: HeadModel | None,
        latency_frames: ArrayLike | None,
        lag_s: ArrayLike | None,
        detection_noise_px: ArrayLike | None,
        dropped_frame_probability: ArrayLike | None,
        variation: Variation | None,
    ) -> None:
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
        self._given = true_head
        heads = np.ascontiguousarray(true_head.packed.reshape(-1, PACKED))
        if self._heads_vary:
            heads = np.repeat(heads, num, axis=0)
            self._deviates = np.zeros((num, DEVIATES))
        timing, sensor = head.timing, head.sensor
        if abs(timing.latency_s * timing.control_rate_hz - timing.latency_frames) > 1e-6:
            raise ConfigurationError(
                f"head {head.name}: timing.latency_s: expected whole control periods of "
                f"{timing.period_s:.6g} s, as a simulated plant delays its images by, such as "
                f"{timing.latency_frames * timing.period_s:.6g} s, got {timing.latency_s:.6g} s"
            )
        self.conditions = Conditions(
            latency_frames=_whole(num, "latency_frames", latency_frames, timing.latency_frames),
            lag_s=_per_head(num, "lag_s", lag_s, timing.lag_s),
            detection_noise_px=_per_head(
                num, "detection_noise_px", detection_noise_px, sensor.detection_noise_px
            ),
            dropped_frame_probability=_per_head(
                num,
                "dropped_frame_probability",
                dropped_frame_probability,
                sensor.dropped_frame_probability,
            ),
            heads=heads,
        )
        """In arrays that the next trials change."""
        if (self.conditions.dropped_frame_probability > 1.0).any():
            raise ConfigurationError(
                f"dropped_frame_probability: expected 0 to 1, got {dropped_frame_probability!r}"
            )

    @property
    def model(self) -> HeadModel:
        """The heads that really move: one, or a population of shape (num,)."""
        if self.variation is not None and self._heads_vary:
            return self.variation.heads(self._head, self._deviates)
        return self._given

    @property
    def longest_latency(self) -> int:
        """The greatest latency that a trial may have or a reading is dated by, control periods."""
        longest = max(int(self.conditions.latency_frames.max()), self._head.timing.latency_frames)
        if self.variation is not None:
            longest = max(longest, *(self.variation.latency_frames(self._head) or (0,)))
        return longest

    def arrays(self) -> Arrays:
        """What the running trials run with, in the arrays that hold it."""
        arrays: Arrays = self.conditions._asdict()
        if self._heads_vary:
            arrays["deviates"] = self._deviates
        else:
            del arrays["heads"]  # given once and for all
        return arrays

    def draw(self, streams: Streams, ids: IntArray) -> None:
        """Draw what the trials of some places run with, where that varies.

        Args:
            streams: the trials' random streams.
            ids: (m,) the places.
        """
        variation = self.variation
        if variation is None:
            return
        shares, deviates = variation.draw(streams, ids)
        frames = variation.latency_frames(self._head)
        if frames is not None:
            low, high = frames
            drawn = low + (shares[:, 0] * (high + 1 - low)).astype(np.int64)
            self.conditions.latency_frames[ids] = drawn
        for column, name in enumerate(RANGES[1:], start=1):
            span = getattr(variation, name)
            if span is not None:
                values = getattr(self.conditions, name)
                values[ids] = span[0] + shares[:, column] * (span[1] - span[0])
        if variation.model_errors is not None:
            self._deviates[ids] = deviates
            self.conditions.heads[ids] = variation.heads(self._head, deviates).packed


def _per_head(num: int, name: str, value: ArrayLike | None, default: float) -> FloatArray:
    """(num,) numbers from a number, from as many, or from the default."""
    given = default if value is None else value
    try:
        array = np.broadcast_to(np.asarray(given, dtype=np.float64), (num,)).copy()
    except (TypeError, ValueError) as error:
        raise ConfigurationError(
            f"{name}: expected a number or {num} numbers, got {given!r}"
        ) from error
    if not (np.isfinite(array) & (array >= 0.0)).all():
        raise ConfigurationError(f"{name}: expected finite values >= 0.0, got {given!r}")
    return array


def _whole(num: int, name: str, value: ArrayLike | None, default: int) -> NDArray[np.int64]:
    numbers = _per_head(num, name, value, default)
    whole = numbers.astype(np.int64)
    if (whole != numbers).any():
        raise ConfigurationError(f"{name}: expected whole numbers, got {value!r}")
    return whole
