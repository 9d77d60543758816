"""The listener that receives a training run's progress, and the run's result."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from vergence.training.validation import ValidationScore

Row = dict[str, Any]
"""One evaluation, by the columns of `vergence.training.curve`."""


class TrainingListener(Protocol):
    """Callbacks that receive a run's progress and may stop it."""

    def begin(self, baselines: dict[str, ValidationScore], unit: str) -> None:
        """Called after the baselines are evaluated; their headline metric is in `unit`."""

    def resumed(self, done: int) -> None:
        """Called if a run is resumed after `done` control steps; 0 if nothing had been saved."""

    def step(self, done: int, total: int) -> None:
        """Called after every step with the number of control steps done and in total."""

    def row(self, row: Row) -> None:
        """Called after each evaluation, when the run has been saved."""

    def stopping(self) -> bool:
        """True to save the run after this update and stop it."""


@dataclass(frozen=True, kw_only=True)
class TrainingResult:
    """Result of a run."""

    folder: Path
    rows: list[Row]
    baselines: dict[str, ValidationScore]
    unit: str
    steps: int
    finished: bool
    """False if the listener stopped it."""
