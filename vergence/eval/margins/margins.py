"""Margins: what was found of each controller, scenario and imperfection, as rows."""

from dataclasses import dataclass, field
from typing import Any, Final

from vergence.envs.plants.imperfections import IMPERFECTIONS
from vergence.eval.margins.config import MarginsConfig
from vergence.eval.margins.measure import Point
from vergence.eval.margins.ranges import Range
from vergence.models.head import HeadModel

ENDS: Final = ("settles_low", "settles_high", "doubles_low", "doubles_high")
ROW: Final = ("controller", "scenario", "imperfection", "unit", *ENDS)
"""The fields of a row of margins.json."""


@dataclass(frozen=True, kw_only=True)
class Margin:
    """How far one imperfection may be from the expected value.

    The ends are values that were measured, the farthest of those that are good without a gap from
    the expected one on, which may be the end of what was searched; both ends are None where not
    even the expected value is good.
    """

    controller: str
    scenario: str
    imperfection: str
    range: Range
    """What was searched."""
    settles_low: float | None
    """From here on 99 % of the trials that settle untouched still settle."""
    settles_high: float | None
    doubles_low: float | None
    """From here on their median settling time is less than twice what it is untouched."""
    doubles_high: float | None
    points: list[Point]
    """All that was measured, by value."""
    head: HeadModel
    options: dict[str, Any]
    """The options that the controller ran with."""
    tuned: bool | None
    """Whether they were tuned for the head, see `Fitted`."""

    @property
    def unit(self) -> str:
        """The unit of all values."""
        return IMPERFECTIONS[self.imperfection].unit

    def row(self) -> dict[str, Any]:
        """The row of margins.json."""
        return {name: getattr(self, name) for name in ROW}

    def is_open(self, end: str) -> bool:
        """Whether an end is that of the search alone: the imperfection may have more.

        Args:
            end: one of `ENDS`.
        """
        value, one = getattr(self, end), IMPERFECTIONS[self.imperfection]
        if end.endswith("_low"):
            return bool(value == self.range.low > one.least)
        return bool(value == self.range.high < one.most)


@dataclass(frozen=True, kw_only=True)
class Margins:
    """All that was found."""

    config: MarginsConfig
    found: list[Margin]
    notes: list[str] = field(default_factory=list)
    """What was left out, and why, and what is untuned."""
    failures: list[str] = field(default_factory=list)
    """What went wrong in controllers of somebody's own, which are left out."""

    def rows(self) -> list[dict[str, Any]]:
        """The rows of margins.json: plain values, None for no value."""
        return [one.row() for one in self.found]

    def groups(self) -> dict[tuple[str, str], list[Margin]]:
        """The margins of each controller in each scenario."""
        found: dict[tuple[str, str], list[Margin]] = {}
        for one in self.found:
            found.setdefault((one.scenario, one.controller), []).append(one)
        return found

    def by_scenario(self) -> dict[str, list[Margin]]:
        """The margins in each scenario."""
        found: dict[str, list[Margin]] = {}
        for one in self.found:
            found.setdefault(one.scenario, []).append(one)
        return found
