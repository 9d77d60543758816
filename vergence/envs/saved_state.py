"""The state of a running simulation: arrays by name, copied and restored bit by bit."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError

Arrays = dict[str, NDArray[Any]]
"""Arrays by name."""
SavedState = dict[str, Arrays]
"""Complete state of a simulation: the arrays of each of its parts."""


def join_parts(**parts: Mapping[str, NDArray[Any]]) -> Arrays:
    """Join the arrays of several parts, each named `part.name`."""
    return {f"{part}.{name}": a for part, arrays in parts.items() for name, a in arrays.items()}


def copy_arrays(arrays: Mapping[str, NDArray[Any]]) -> Arrays:
    """Copy all arrays."""
    return {name: array.copy() for name, array in arrays.items()}


def restore_arrays(arrays: Mapping[str, NDArray[Any]], saved: Mapping[str, NDArray[Any]]) -> None:
    """Restore the saved values of arrays.

    Args:
        arrays: updated in place.
        saved: a result of `copy_arrays`.

    Raises:
        ConfigurationError: names, shapes or types differ, as for another simulation.
    """
    forms = [{name: (a.shape, a.dtype) for name, a in part.items()} for part in (arrays, saved)]
    if forms[0] != forms[1]:
        wrong = sorted(name for name, _form in set(forms[0].items()) ^ set(forms[1].items()))
        raise ConfigurationError(
            f"state: expected that of {', '.join(wrong)} as this simulation has it, got another"
        )
    for name, array in arrays.items():
        np.copyto(array, saved[name])
