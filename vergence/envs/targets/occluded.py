"""A target on an ellipse that disappears for a while and reappears further along."""

from dataclasses import dataclass
from typing import ClassVar

from vergence.envs.streams import IntArray, RandomStreams
from vergence.envs.targets.board import POINT, Board
from vergence.envs.targets.moments import draw_event_times
from vergence.envs.targets.motion import HIDDEN_FROM, HIDDEN_UNTIL
from vergence.envs.targets.orbits import OrbitTarget
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray


@dataclass(frozen=True, kw_only=True)
class OccludedTarget(OrbitTarget):
    """A target that moves on the ellipse of `OrbitTarget` and is hidden for a part of it.

    It moves on while hidden and reappears elsewhere, where the eyes look if they have moved on with
    it. In the same trial, `orbit` with the same options has the same ellipse.
    """

    kind: ClassVar[str] = "occluded"
    gone_after: tuple[float, float] = (0.8, 2.5)
    """Earliest and latest time at which it disappears, s."""
    gone_s: float = 0.3
    """Duration of its absence, s."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._refuse_unordered("gone_after")

    def draw(
        self, head: HeadModel, streams: RandomStreams, ids: IntArray, board: Board = POINT
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`."""
        rows, q = super().draw(head, streams, ids, board)
        gone = draw_event_times(streams, ids, *self.gone_after)
        rows[:, HIDDEN_FROM], rows[:, HIDDEN_UNTIL] = gone, gone + self.gone_s
        return rows, q
