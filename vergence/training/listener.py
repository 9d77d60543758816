"""Who is told how a training run goes, and what is told of it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from vergence.training.validation import Score

Row = dict[str, Any]
"""One evaluation, by the columns of `vergence.training.curve`."""


class Listener(Protocol):
    """Who is told how a run goes, and may stop it."""

    def begin(self, baselines: dict[str, Score], unit: str) -> None:
        """The baselines have been evaluated; their headline metric is in `unit`."""

    def going_on(self, done: int) -> None:
        """A run goes on from so many control steps; from 0 where nothing had been saved."""

    def step(self, done: int, total: int) -> None:
        """So many control steps have been learned from."""

    def row(self, row: Row) -> None:
        """An evaluation has been made and the run saved."""

    def stopping(self) -> bool:
        """Whether to save the run after this update and leave it."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """How a run has ended."""

    folder: Path
    rows: list[Row]
    baselines: dict[str, Score]
    unit: str
    steps: int
    finished: bool
    """False if the listener stopped it."""
