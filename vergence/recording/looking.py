"""Interface of a head that looks at a board: simulated, rendered or real."""

from typing import NamedTuple, Protocol

from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.vision.targets import PlanarTarget


class BoardView(NamedTuple):
    """One view of a board by both eyes of a head at rest."""

    time_s: float
    """Time of the exposure, s; grows from view to view."""
    positions: FloatArray
    """(7,) measured joint angles, rad."""
    corners_px: tuple[FloatArray | None, FloatArray | None]
    """(n, 2) raw pixels of the board's corners by eye, nan for corners that were not found; None
    for an eye to which the board is not visible."""
    sigma_px: tuple[FloatArray | None, FloatArray | None]
    """(n, 2) standard deviations of the corners by eye, px; None as for the corners."""


class Looker(Protocol):
    """A head that can be turned, simulated or real, with a calibration board in front of it."""

    head: HeadModel
    """The known model of the head."""
    target: PlanarTarget
    """The board."""

    def look(self, q: FloatArray) -> BoardView:
        """Bring the head to rest near some joint angles and look once.

        Args:
            q: (7,) rad, within the limits.

        Raises:
            VergenceError: the head has been stopped, or does not answer.
        """

    def close(self) -> None:
        """Bring the head to rest and release it."""
