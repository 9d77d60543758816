"""Checks of the numbers that a user gives to targets."""

import numpy as np

from vergence.errors import ConfigurationError


def numbers(name: str, value: object, size: int, above_zero: bool = False) -> object:
    """Finite numbers: a tuple, or one that is not negative.

    Args:
        name: what a message calls them.
        value: what was given.
        size: how many, 0 for one number instead of a tuple.
        above_zero: whether the one number may not be zero.

    Raises:
        ConfigurationError: the value is something else.
    """
    if size:
        if not isinstance(value, list | tuple | np.ndarray) or len(value) != size:
            raise ConfigurationError(f"{name}: expected {size} numbers, got {value!r}")
        return tuple(_number(name, item) for item in value)
    number = _number(name, value)
    if number < 0.0 or (number == 0.0 and above_zero):
        raise ConfigurationError(f"{name}: expected a number above 0, got {value!r}")
    return number


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise ConfigurationError(f"{name}: expected a number, got {value!r}")
    number = float(value)
    if not np.isfinite(number):
        raise ConfigurationError(f"{name}: expected a finite number, got {value!r}")
    return number
