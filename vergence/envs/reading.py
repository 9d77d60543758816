"""Sensor readings of heads, and their ground truth, which no real head knows."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.models.parts import FloatArray
from vergence.operands import as_operand

BoolArray = NDArray[np.bool_]
Image = NDArray[np.uint8]


class Reading(NamedTuple):
    """Sensor readings of a batch of heads, in one form for simulations and hardware.

    A plant reuses the arrays: its next step changes them. Call `copy` to keep a reading. Compiled
    code has the order of the fields, see `vergence.kernels`.
    """

    time_s: FloatArray
    """(n,) present time since the trial's start, s: always a whole number of control periods, even
    if the step was late; a missed period is skipped. Control laws recognise a new image by its
    age, which jitter of a clock would change as a new image does."""
    frame: NDArray[np.int64]
    """(n,) number of images received in this trial; a change means a new image."""
    pixels: FloatArray
    """(n, 2, 2) raw pixels of the target in the newest image; nan if the eye does not see it."""
    visible: BoolArray
    """(n, 2) True if the eye saw the target in the newest image."""
    exposure_s: FloatArray
    """(n,) exposure time of the newest image, s: measured if the cameras stamp it, else its receipt
    minus the nominal latency; nan before the first image. If the eyes expose at different times,
    it is a time between the exposures, and both pixels are given for this time."""
    received_s: FloatArray
    """(n,) time at which the newest image became readable, s, possibly between two periods; nan
    before the first image."""
    joints_s: FloatArray
    """(n,) measurement time of the joints, s: the present minus the nominal feedback latency."""
    positions_at_exposure: FloatArray
    """(n, 7) joint angles at the newest image's `exposure_s`, rad, interpolated between joint
    readings."""
    positions: FloatArray
    """(n, 7) joint angles read last, rad."""
    velocities: FloatArray
    """(n, 7) joint velocities read last, rad/s."""
    command: FloatArray
    """(n, 7) velocities of the neck's joints and of the eye actuators actually sent for the last
    period, rad/s; see `vergence.envs.plant.Plant.step`."""

    @classmethod
    def empty(cls, num: int) -> "Reading":
        """The reading of heads that have seen nothing yet."""
        return cls(
            time_s=np.zeros(num),
            frame=np.zeros(num, dtype=np.int64),
            pixels=np.full((num, 2, 2), np.nan),
            visible=np.zeros((num, 2), dtype=np.bool_),
            exposure_s=np.full(num, np.nan),
            received_s=np.full(num, np.nan),
            joints_s=np.zeros(num),
            positions_at_exposure=np.zeros((num, 7)),
            positions=np.zeros((num, 7)),
            velocities=np.zeros((num, 7)),
            command=np.zeros((num, 7)),
        )

    @classmethod
    def of(cls, returned: object, num: int) -> "Reading":
        """Check a plant's reading, and convert its arrays to types that kernels can read.

        Args:
            returned: object returned by the plant.
            num: expected number of heads.

        Returns:
            `returned` itself if its arrays already have these types, else a reading with copies.

        Raises:
            ConfigurationError: the object is not a reading of this many heads.
        """
        if not isinstance(returned, Reading):
            raise ConfigurationError(f"plant: expected to return a Reading, got {returned!r:.80}")
        arrays: list[Any] = []
        for name, value, form in zip(cls._fields, returned, cls.empty(num), strict=True):
            array = as_operand(f"plant: Reading.{name}", value, *form.shape)
            if array.shape != form.shape:
                raise ConfigurationError(
                    f"plant: Reading.{name}: expected shape {form.shape}, got {array.shape}"
                )
            arrays.append(np.ascontiguousarray(value, dtype=form.dtype))
        same = all(new is old for new, old in zip(arrays, returned, strict=True))
        return returned if same else cls(*arrays)

    def copy(self) -> "Reading":
        """Copy the reading and its arrays."""
        return self._replace(**{name: array.copy() for name, array in self._asdict().items()})


class Truth(NamedTuple):
    """Ground truth of the present, without delay or noise; mostly known in simulation only."""

    time_s: FloatArray
    """(n,) time since the trial's start, s."""
    positions: FloatArray
    """(n, 7) joint angles, rad."""
    velocities: FloatArray
    """(n, 7) joint velocities, rad/s."""
    motors: FloatArray
    """(n, 7) motor angles of the neck and of the eye actuators, rad; their outputs differ by up to
    half the backlash."""
    target: FloatArray
    """(n, 3) the target in the present N, m."""
    pixels: FloatArray
    """(n, 2, 2) raw pixels of the target; nan behind a camera, not clipped to the image."""
    pixel_error: FloatArray
    """(n, 2, 2) these pixels undistorted by the controller's model, minus its principal points."""
    image_visible: BoolArray
    """(n, 2) True if the target lies inside the image."""

    @classmethod
    def unknown(cls, num: int) -> "Truth":
        """The truth of heads for which it is unknown: nan, and nothing visible."""
        return cls(
            time_s=np.full(num, np.nan),
            positions=np.full((num, 7), np.nan),
            velocities=np.full((num, 7), np.nan),
            motors=np.full((num, 7), np.nan),
            target=np.full((num, 3), np.nan),
            pixels=np.full((num, 2, 2), np.nan),
            pixel_error=np.full((num, 2, 2), np.nan),
            image_visible=np.zeros((num, 2), dtype=np.bool_),
        )
