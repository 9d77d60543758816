"""Validation of user input to environments, targets and controllers: numbers, and the head."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import NECK, FloatArray
from vergence.operands import as_operand


def check_tuple_or_nonnegative(
    name: str, value: object, tuple_length: int, positive: bool = False
) -> object:
    """Check `size` finite numbers and return them as a tuple.

    With size 0, check one number of at least 0.

    Args:
        name: name for error messages.
        value: the user's value.
        tuple_length: number of elements; 0 for a single number instead of a tuple.
        positive: True if the single number must not be zero.

    Raises:
        ConfigurationError: the value is something else.
    """
    if tuple_length:
        if not isinstance(value, list | tuple | np.ndarray) or len(value) != tuple_length:
            raise ConfigurationError(f"{name}: expected {tuple_length} numbers, got {value!r}")
        return tuple(check_finite_number(name, item) for item in value)
    (check_above_zero if positive else check_at_least_zero)(name, value)
    return check_finite_number(name, value)


def check_above_zero(name: str, value: object) -> None:
    """Refuse a value that is not a finite number above zero.

    Args:
        name: name for error messages.
        value: the user's value.

    Raises:
        ConfigurationError: it is not.
    """
    if check_finite_number(name, value) <= 0.0:
        raise ConfigurationError(f"{name}: expected a finite number above 0, got {value!r}")


def check_at_least_zero(name: str, value: object) -> None:
    """Refuse a value that is not a finite number of at least zero; see `check_above_zero`."""
    if check_finite_number(name, value) < 0.0:
        raise ConfigurationError(f"{name}: expected a number of at least 0, got {value!r}")


def check_count(name: str, value: object, *, minimum: int = 1) -> int:
    """Check a whole number of at least `minimum` and return it.

    Args:
        name: name for error messages.
        value: the user's value.
        minimum: smallest valid value.

    Raises:
        ConfigurationError: the value is something else.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < minimum:
        what = "above 0" if minimum == 1 else f"of at least {minimum}"
        raise ConfigurationError(f"{name}: expected a whole number {what}, got {value!r}")
    return int(value)


def check_finite_number(name: str, value: object) -> float:
    """Check one finite number and return it, see `check_tuple_or_nonnegative`."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise ConfigurationError(f"{name}: expected a number, got {value!r}")
    one = float(value)
    if not np.isfinite(one):
        raise ConfigurationError(f"{name}: expected a finite number, got {value!r}")
    return one


def real_number_array(value: ArrayLike) -> FloatArray:
    """Convert real numbers to an array; unlike NumPy, refuse text and booleans.

    Args:
        value: a number, or numbers in lists, tuples or an array.

    Returns:
        (...) float64, which may hold nan and inf.

    Raises:
        TypeError: something in it is not a number.
        ValueError: its rows differ in length.
    """
    array = np.asarray(value)
    mixed = () if isinstance(value, np.ndarray) else np.asarray(value, dtype=object).flat
    if array.dtype.kind not in "iuf" or any(isinstance(one, bool | np.bool_) for one in mixed):
        raise TypeError(f"expected numbers, got {value!r:.80}")
    return array.astype(np.float64)


def as_action_array(action: ArrayLike) -> NDArray[Any]:
    """Convert an action to an array without changing the type of its numbers.

    Raises:
        ConfigurationError: an element is not a real number, or its rows differ in length.
    """
    if isinstance(action, np.ndarray) and action.dtype.kind in "biuf":
        return action
    return as_operand("action", action)


def refuse_immobile_eyes(head: HeadModel) -> None:
    """Refuse a head whose eyes do not move.

    Raises:
        ConfigurationError: they do not.
    """
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
