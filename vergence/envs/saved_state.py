"""The state of a running simulation: arrays by name, copied out and put back bit by bit."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError

Arrays = dict[str, NDArray[Any]]
"""Arrays by name."""
SavedState = dict[str, Arrays]
"""What a simulation goes on from: the arrays of each of its parts."""


def named(**parts: Mapping[str, NDArray[Any]]) -> Arrays:
    """The arrays of several parts, each named `part.name`."""
    return {f"{part}.{name}": a for part, arrays in parts.items() for name, a in arrays.items()}


def copied(arrays: Mapping[str, NDArray[Any]]) -> Arrays:
    """The same values in arrays of their own."""
    return {name: array.copy() for name, array in arrays.items()}


def put_back(arrays: Mapping[str, NDArray[Any]], saved: Mapping[str, NDArray[Any]]) -> None:
    """Give arrays the values that they had.

    Args:
        arrays: written to in place.
        saved: what `copied` returned.

    Raises:
        ConfigurationError: the values are those of a simulation of another form.
    """
    forms = [{name: (a.shape, a.dtype) for name, a in part.items()} for part in (arrays, saved)]
    if forms[0] != forms[1]:
        wrong = sorted(name for name, _form in set(forms[0].items()) ^ set(forms[1].items()))
        raise ConfigurationError(
            f"state: expected that of {', '.join(wrong)} as this simulation has it, got another"
        )
    for name, array in arrays.items():
        np.copyto(array, saved[name])
