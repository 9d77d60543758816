"""Controllers with a state: how it begins, what `predict` does with it, when it is forgotten."""

from abc import ABC, abstractmethod
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.fitting import fitting_layout
from vergence.envs.layout import Observation, ObservationLayout
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_MANY = 10
"""Arrays whose shapes a message does not list."""


class StatefulController(ABC):
    """A controller whose state is one row of numbers per head.

    The state that `predict` returns is a tuple of one array (..., S), rows of float64 with the
    leading shape of the observations. The caller's arrays are never changed.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.

    Raises:
        ConfigurationError: the layout is another head's.
    """

    def __init__(self, *, head: HeadModel, layout: ObservationLayout) -> None:
        self.head = head
        self.layout = fitting_layout(head, layout)

    @abstractmethod
    def _initial(self) -> FloatArray:
        """(S,) the state at a trial's start."""

    @abstractmethod
    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        """(..., 4) velocities of the eyes' actuators, rad/s; (..., S) `state` changes in place."""

    @cached_property
    def _start(self) -> FloatArray:
        """`_initial`, made once and never changed."""
        return self._initial()

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Choose actions, see `Controller.predict`.

        Raises:
            ConfigurationError: these are no observations, or the state is not one of this
                controller for so many heads.
        """
        leading = np.shape(observation)[:-1]
        rows = carried_on(self._start, leading, state, episode_start)
        command = self._command(self.layout.decode(observation), rows)
        return self.layout.action(command), (rows,)


def carried_on(
    initial: FloatArray,
    leading: tuple[int, ...],
    state: tuple[NDArray[Any], ...] | None,
    episode_start: NDArray[Any] | None,
) -> FloatArray:
    """The memory with which a controller goes on, in an array of its own.

    Args:
        initial: (S,) the memory at a trial's start.
        leading: the leading shape of the observations.
        state: what the last call returned, a tuple of one array (..., S); None at the start.
        episode_start: (...) whether an episode has just begun, and the memory with it.

    Returns:
        (..., S) float64.

    Raises:
        ConfigurationError: the state is not one of such a controller for so many heads.
    """
    shape = (*leading, initial.size)
    if state is None:
        rows = np.empty(shape)
        rows[...] = initial
        return rows
    given: Any = state  # of a caller's own, whatever the annotation says
    several = isinstance(given, tuple | list)
    if not several or len(given) != 1 or np.shape(given[0]) != shape:
        found = " ".join(f"{given!r:.200}".split())[:80]
        if several and len(given) < _MANY:
            found = ", ".join(str(np.shape(part)) for part in given)
        raise ConfigurationError(
            f"state: expected a tuple of one array of shape {shape}, got {found or '()'}"
        )
    rows = np.array(state[0], dtype=np.float64)
    if episode_start is not None:
        begun = np.asarray(episode_start, dtype=np.bool_)
        if begun.any():
            rows[np.broadcast_to(begun, leading)] = initial
    return rows
