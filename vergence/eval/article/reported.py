"""Target points and results that the article states.

Fan et al., Eye Gaze Based 3D Triangulation for Robotic Bionic Eyes, Sensors 2020, 20(18), 5271.
"""

import csv
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Final, Literal

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.parts import FloatArray

ARTICLE_GAIN: Final = 4.0
"""Gain of the article's control law, 1/s (physical: a setting of the article's system)."""
ARTICLE_LARGEST_PERCENT: Final = {"gaze": 4.97, "itpc": 6.98}
"""The article's largest depth errors of static targets on its head, percent of depth."""


@dataclass(frozen=True, kw_only=True)
class ReportedResult:
    """One result that the article reports."""

    experiment: str
    quantity: str
    method: str
    """`gaze`, `itpc`, `both`, or the control law of a gaze shift."""
    axis: str
    unit: str
    low: float
    high: float | None
    """None if the article gives only a least value."""

    @property
    def span(self) -> tuple[float, float]:
        """Least and greatest value; equal if the article gives one number."""
        return self.low, self.low if self.high is None else self.high


def _rows(name: str) -> list[dict[str, str]]:
    text = (resources.files("vergence.eval.article") / name).read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))


@cache
def reported_results() -> tuple[ReportedResult, ...]:
    """Every result that the article reports, in its order."""
    return tuple(
        ReportedResult(
            experiment=row["experiment"], quantity=row["quantity"], method=row["method"],
            axis=row["axis"], unit=row["unit"], low=float(row["low"]),
            high=float(row["high"]) if row["high"] else None,
        )
        for row in _rows("reported_results.csv")
    )  # fmt: skip


def reported_result(experiment: str, quantity: str, method: str, axis: str) -> ReportedResult:
    """Look up one result that the article reports."""
    wanted = (experiment, quantity, method, axis)
    for row in reported_results():
        if (row.experiment, row.quantity, row.method, row.axis) == wanted:
            return row
    raise ConfigurationError(f"reported: expected a result of the article, got {wanted}")


def static_points(which: Literal["simulated", "physical", "zed_mini"]) -> FloatArray:
    """(points, 3) static target points of Table 3, 5 or 7, in N, m."""
    name = {
        "simulated": "table3_simulated_static_points.csv",
        "physical": "table5_physical_static_points.csv",
        "zed_mini": "table7_zed_mini_points.csv",
    }[which]
    rows = [[float(row[f"{axis}_mm"]) for axis in "xyz"] for row in _rows(name)]
    return np.array(rows) / 1000.0
