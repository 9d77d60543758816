"""A head that can be told to look somewhere and say what it saw: simulated, drawn or real."""

from typing import NamedTuple, Protocol

from vergence.models.boards import PlanarTarget
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray


class Sight(NamedTuple):
    """What both eyes of a head at rest saw of a board, once."""

    time_s: float
    """Of the exposure, s; grows from look to look."""
    positions: FloatArray
    """(7,) joint angles that were read, rad."""
    corners_px: tuple[FloatArray | None, FloatArray | None]
    """(n, 2) raw pixels of the board's corners by eye, nan for corners that were not found; None
    for an eye that does not see the board."""
    sigma_px: tuple[FloatArray | None, FloatArray | None]
    """(n, 2) their standard deviations."""


class Looker(Protocol):
    """A head before a board."""

    head: HeadModel
    """The model that is known of it."""
    target: PlanarTarget
    """The board."""

    def look(self, q: FloatArray) -> Sight:
        """Bring the head to rest near some joint angles and look once.

        Args:
            q: (7,) rad, within the limits.

        Raises:
            VergenceError: the head has been stopped, or does not answer.
        """

    def close(self) -> None:
        """Bring the head to rest and release it."""
