"""What the article states: its target points and its reported results.

Fan et al., Eye Gaze Based 3D Triangulation for Robotic Bionic Eyes, Sensors 2020, 20(18), 5271.
"""

import csv
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Literal

import numpy as np

from vergence.models.parts import FloatArray


@dataclass(frozen=True, kw_only=True)
class Reported:
    """One result that the article reports."""

    experiment: str
    quantity: str
    method: str
    """`gaze`, `itpc` or `both`."""
    axis: str
    low: float
    """In millimetres."""
    high: float | None
    """In millimetres; None where the article gives a least value only."""
    note: str


def _rows(name: str) -> list[dict[str, str]]:
    text = (resources.files("vergence.eval.article") / name).read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))


@cache
def reported_results() -> tuple[Reported, ...]:
    """Every result that the article reports, in its order."""
    return tuple(
        Reported(
            experiment=row["experiment"],
            quantity=row["quantity"],
            method=row["method"],
            axis=row["axis"],
            low=float(row["low_mm"]),
            high=float(row["high_mm"]) if row["high_mm"] else None,
            note=row["note"] or "",
        )
        for row in _rows("reported_results.csv")
    )


def static_points(
    which: Literal["simulated", "physical", "zed_mini"],
) -> FloatArray:
    """The static target points of Table 3, 5 or 7.

    Args:
        which: `simulated` for Table 3, `physical` for Table 5, `zed_mini` for Table 7.

    Returns:
        (points, 3) in N, m.
    """
    name = {
        "simulated": "table3_simulated_static_points.csv",
        "physical": "table5_physical_static_points.csv",
        "zed_mini": "table7_zed_mini_points.csv",
    }[which]
    rows = [[float(row[f"{axis}_mm"]) for axis in "xyz"] for row in _rows(name)]
    return np.array(rows) / 1000.0
