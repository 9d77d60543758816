"""Base of controllers with a state: its initial value, its use by `predict`, and its reset."""

from abc import ABC, abstractmethod
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.fitting import checked_layout
from vergence.envs.observation import Observation, ObservationLayout
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_MAX_LISTED_ARRAYS: Final = 10
"""Number of arrays from which on a message does not list their shapes (chosen: detail
against length)."""


class StatefulController(ABC):
    """A controller whose state is one packed row per head.

    The state that `predict` returns is a tuple of one array (..., S), rows of float64 with the
    leading shape of the observations. The caller's arrays are never changed.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.

    Raises:
        ConfigurationError: the layout belongs to another head.
    """

    def __init__(self, *, head: HeadModel, layout: ObservationLayout) -> None:
        self.head = head
        self.layout = checked_layout(head, layout)

    @abstractmethod
    def _initial(self) -> FloatArray:
        """(S,) state at a trial's start."""

    @abstractmethod
    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        """(..., 4) velocities of the eyes' actuators, rad/s; changes `state` (..., S) in place."""

    @cached_property
    def _start(self) -> FloatArray:
        """`_initial`, computed once and never changed."""
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
            ConfigurationError: these are not valid observations, or the state does not belong to
                this controller and this number of heads.
        """
        leading = np.shape(observation)[:-1]
        rows = continued_state(self._start, leading, state, episode_start)
        command = self._command(self.layout.decode(observation), rows)
        return self.layout.action(command), (rows,)


def continued_state(
    initial: FloatArray,
    leading: tuple[int, ...],
    state: tuple[NDArray[Any], ...] | None,
    episode_start: NDArray[Any] | None,
) -> FloatArray:
    """Return the state to continue from, in an array of its own.

    Args:
        initial: (S,) the state at a trial's start.
        leading: the leading shape of the observations.
        state: the state returned by the last call, a tuple of one array (..., S); None at the
            start.
        episode_start: (...) True for an episode that has just begun; its state is reset.

    Returns:
        (..., S) float64.

    Raises:
        ConfigurationError: the state does not belong to such a controller and this number of heads.
    """
    shape = (*leading, initial.size)
    if state is None:
        rows = np.empty(shape)
        rows[...] = initial
        return rows
    given: Any = state  # a caller may pass anything, whatever the annotation says
    several = isinstance(given, tuple | list)
    if not several or len(given) != 1 or np.shape(given[0]) != shape:
        found = " ".join(f"{given!r:.200}".split())[:80]
        if several and len(given) < _MAX_LISTED_ARRAYS:
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
