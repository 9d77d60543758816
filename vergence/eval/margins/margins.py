"""Measured margins of controllers, by scenario and imperfection, and their rows."""

from dataclasses import dataclass, field
from typing import Any, Final

from vergence.envs.plants.imperfections import IMPERFECTIONS
from vergence.eval.margins.config import MarginsConfig
from vergence.eval.margins.measure import MarginPoint
from vergence.eval.margins.ranges import SearchInterval
from vergence.models.head import HeadModel

RANGE_ENDS: Final = ("settles_low", "settles_high", "doubles_low", "doubles_high")
MARGIN_ROW_FIELDS: Final = ("controller", "scenario", "imperfection", "unit", *RANGE_ENDS)
"""The fields of a row of margins.json."""


@dataclass(frozen=True, kw_only=True)
class Margin:
    """Margin of one imperfection: the ranges about the expected value in which criteria hold.

    Each end is a measured value: the farthest one up to which the criterion holds at every measured
    value from the expected one on. It may be the end of the searched range. Both ends are None if
    the criterion does not even hold at the expected value.
    """

    controller: str
    scenario: str
    imperfection: str
    range: SearchInterval
    """Searched range."""
    settles_low: float | None
    """Low end of the range in which 99 % of the trials that settle in the unmodified scenario still
    settle."""
    settles_high: float | None
    """High end of that range."""
    doubles_low: float | None
    """Low end of the range in which the median settle time of these trials is less than twice that
    in the unmodified scenario."""
    doubles_high: float | None
    """High end of that range."""
    points: list[MarginPoint]
    """All measurements, sorted by value."""
    head: HeadModel
    options: dict[str, Any]
    """The controller's options."""
    tuned: bool | None
    """True if the options were tuned for the head, see `ResolvedOptions`."""

    @property
    def unit(self) -> str:
        """The unit of all values."""
        return IMPERFECTIONS[self.imperfection].unit

    def row(self) -> dict[str, Any]:
        """The row of margins.json."""
        return {name: getattr(self, name) for name in MARGIN_ROW_FIELDS}

    def is_open(self, end: str) -> bool:
        """True if an end is only the end of the search, while the imperfection may go beyond it.

        Args:
            end: one of `RANGE_ENDS`.
        """
        value, one = getattr(self, end), IMPERFECTIONS[self.imperfection]
        if end.endswith("_low"):
            return bool(value == self.range.low > one.least)
        return bool(value == self.range.high < one.most)


@dataclass(frozen=True, kw_only=True)
class Margins:
    """All margins of a run."""

    config: MarginsConfig
    margins: list[Margin]
    notes: list[str] = field(default_factory=list)
    """Notes on controllers and imperfections that are left out, and on untuned controllers."""
    failures: list[str] = field(default_factory=list)
    """Errors of user-defined controllers, which are left out."""

    def rows(self) -> list[dict[str, Any]]:
        """The rows of margins.json: plain values, None for no value."""
        return [one.row() for one in self.margins]

    def groups(self) -> dict[tuple[str, str], list[Margin]]:
        """The margins of each controller in each scenario."""
        found: dict[tuple[str, str], list[Margin]] = {}
        for one in self.margins:
            found.setdefault((one.scenario, one.controller), []).append(one)
        return found

    def by_scenario(self) -> dict[str, list[Margin]]:
        """The margins in each scenario."""
        found: dict[str, list[Margin]] = {}
        for one in self.margins:
            found.setdefault(one.scenario, []).append(one)
        return found
