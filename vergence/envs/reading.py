"""What a head's sensors report, and the truth behind it, which no real head knows."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.models.parts import FloatArray
from vergence.operands import as_operand

BoolArray = NDArray[np.bool_]
Image = NDArray[np.uint8]


class Reading(NamedTuple):
    """What the sensors of a batch of heads saw; the same from a simulation and from hardware.

    A plant reuses the arrays: they change with its next step. `copy` keeps them.
    """

    time_s: FloatArray
    """(n,) the present, since the trial's start, on the grid of the schedule: a whole number of
    control periods, also where the step was late; a missed period is skipped. Laws tell a new
    image by its age, which a clock's jitter would change as a new image does."""
    frame: NDArray[np.int64]
    """(n,) how many images have come in this trial; a new one has come when it changes."""
    pixels: FloatArray
    """(n, 2, 2) raw pixels of the target in the newest image; nan where an eye does not see it."""
    visible: BoolArray
    """(n, 2) whether each eye saw the target in the newest image."""
    exposure_s: FloatArray
    """(n,) when the newest image was exposed: measured where the cameras stamp it, else its
    receipt less the nominal latency; nan before the first. Eyes that expose at different times
    have a time between them, as of which both pixels are given."""
    received_s: FloatArray
    """(n,) when the newest image became readable, which may be between two periods; nan before
    the first."""
    joints_s: FloatArray
    """(n,) when the joints were measured: the present less the nominal latency of the feedback."""
    positions_at_exposure: FloatArray
    """(n, 7) joint angles at the exposure of the newest image, as it is dated, rad: between two
    readings of the joints they are interpolated."""
    positions: FloatArray
    """(n, 7) joint angles as they were read last, rad."""
    velocities: FloatArray
    """(n, 7) joint velocities as they were read last, rad/s."""
    command: FloatArray
    """(n, 7) the velocities of the neck's joints and of the actuators of the eyes that were really
    sent for the last period, rad/s; see `vergence.envs.plant.Plant.step`."""

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
    def of(cls, told: object, num: int) -> "Reading":
        """The reading that a plant has returned, in arrays that kernels can read.

        Args:
            told: what came.
            num: how many heads it is of.

        Returns:
            The same reading where its arrays have the types of one, else one of copies.

        Raises:
            ConfigurationError: it is no reading of so many heads.
        """
        if not isinstance(told, Reading):
            raise ConfigurationError(f"plant: expected to return a Reading, got {told!r:.80}")
        arrays: list[Any] = []
        for name, value, form in zip(cls._fields, told, cls.empty(num), strict=True):
            array = as_operand(f"plant: Reading.{name}", value, *form.shape)
            if array.shape != form.shape:
                raise ConfigurationError(
                    f"plant: Reading.{name}: expected shape {form.shape}, got {array.shape}"
                )
            arrays.append(np.ascontiguousarray(value, dtype=form.dtype))
        same = all(new is old for new, old in zip(arrays, told, strict=True))
        return told if same else cls(*arrays)

    def copy(self) -> "Reading":
        """The same values in arrays of their own."""
        return self._replace(**{name: array.copy() for name, array in self._asdict().items()})


class Truth(NamedTuple):
    """What is known about the present without delay or noise, in a simulation above all."""

    time_s: FloatArray
    """(n,) since the trial's start."""
    positions: FloatArray
    """(n, 7) joint angles, rad."""
    velocities: FloatArray
    """(n, 7) joint velocities, rad/s."""
    motors: FloatArray
    """(n, 7) angles of the neck's motors and of those of the eyes' actuators, rad; what they move
    is within half their play of them."""
    target: FloatArray
    """(n, 3) the target in the present N, m."""
    pixels: FloatArray
    """(n, 2, 2) raw pixels of the target, nan behind a camera, not clipped to the image."""
    pixel_error: FloatArray
    """(n, 2, 2) those pixels undistorted as the controller does, less its principal points."""
    image_visible: BoolArray
    """(n, 2) whether the target lies inside each image."""

    @classmethod
    def unknown(cls, num: int) -> "Truth":
        """The truth about heads of which nobody knows it: nan, and nothing in view."""
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
