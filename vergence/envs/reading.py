"""Sensor readings of heads, their ground truth, and the checks of what users give."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import NECK, FloatArray
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
            time_s=np.zeros(num), frame=np.zeros(num, dtype=np.int64),
            pixels=np.full((num, 2, 2), np.nan), visible=np.zeros((num, 2), dtype=np.bool_),
            exposure_s=np.full(num, np.nan), received_s=np.full(num, np.nan),
            joints_s=np.zeros(num), positions_at_exposure=np.zeros((num, 7)),
            positions=np.zeros((num, 7)), velocities=np.zeros((num, 7)), command=np.zeros((num, 7)),
        )  # fmt: skip

    @classmethod
    def of(cls, returned: object, num: int) -> "Reading":
        """Check what a plant has returned; a copy if its arrays are of types kernels cannot read.

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
            time_s=np.full(num, np.nan), positions=np.full((num, 7), np.nan),
            velocities=np.full((num, 7), np.nan), motors=np.full((num, 7), np.nan),
            target=np.full((num, 3), np.nan), pixels=np.full((num, 2, 2), np.nan),
            pixel_error=np.full((num, 2, 2), np.nan),
            image_visible=np.zeros((num, 2), dtype=np.bool_),
        )  # fmt: skip


def check_tuple_or_nonnegative(
    name: str, value: object, tuple_length: int, positive: bool = False
) -> object:
    """Check finite numbers and return their tuple; for a length of 0, one that is not negative."""
    if tuple_length:
        if not isinstance(value, list | tuple | np.ndarray) or len(value) != tuple_length:
            raise ConfigurationError(f"{name}: expected {tuple_length} numbers, got {value!r}")
        return tuple(check_finite_number(name, item) for item in value)
    (check_above_zero if positive else check_at_least_zero)(name, value)
    return check_finite_number(name, value)


def check_above_zero(name: str, value: object) -> None:
    """Refuse a value that is not a finite number above zero."""
    if check_finite_number(name, value) <= 0.0:
        raise ConfigurationError(f"{name}: expected a finite number above 0, got {value!r}")


def check_at_least_zero(name: str, value: object) -> None:
    """Refuse a value that is not a finite number of at least zero."""
    if check_finite_number(name, value) < 0.0:
        raise ConfigurationError(f"{name}: expected a number of at least 0, got {value!r}")


def check_count(name: str, value: object, *, minimum: int = 1) -> int:
    """Check a whole number of at least `minimum` and return it."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < minimum:
        what = "above 0" if minimum == 1 else f"of at least {minimum}"
        raise ConfigurationError(f"{name}: expected a whole number {what}, got {value!r}")
    return int(value)


def check_finite_number(name: str, value: object) -> float:
    """Check one finite number and return it."""
    odd = isinstance(value, bool | np.timedelta64 | complex)
    if odd or not isinstance(value, int | float | np.integer | np.floating):
        raise ConfigurationError(f"{name}: expected a number, got {value!r:.80}")
    try:
        one = float(value)
    except OverflowError:
        one = np.inf
    if not np.isfinite(one):
        raise ConfigurationError(f"{name}: expected a finite number, got {value!r:.80}")
    return one


def real_number_array(value: ArrayLike) -> FloatArray:
    """Convert real numbers to an array of float64; unlike NumPy, refuse text and booleans."""
    array = np.asarray(value)
    mixed = () if isinstance(value, np.ndarray) else np.asarray(value, dtype=object).flat
    if array.dtype.kind not in "iuf" or any(isinstance(one, bool | np.bool_) for one in mixed):
        raise TypeError(f"expected numbers, got {value!r:.80}")
    return array.astype(np.float64)


def as_action_array(action: ArrayLike) -> NDArray[Any]:
    """Convert an action to an array without changing the type of its numbers."""
    if isinstance(action, np.ndarray) and action.dtype.kind in "biuf":
        return action
    return as_operand("action", action)


def refuse_immobile_eyes(head: HeadModel) -> None:
    """Refuse a head whose eyes do not move."""
    if head.actuation.count:
        return
    what = "which can locate what it sees (triangulate_views) and has nothing to turn"
    if any(head.joints[NECK]):
        what = (
            "on a neck, which stands still here: joints of the part 'both' in place of 'neck' turn "
            "both eyes (leave out --neck of vergence import urdf); triangulate_views locates what "
            "it sees"
        )
    raise ConfigurationError(
        f"head: expected one whose eyes move, got {head.name!r}, a fixed pair, {what}"
    )
