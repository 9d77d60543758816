"""Statistics of each head of a population, and the rank of the article's single head among them."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from vergence.models.parts import FloatArray

METHODS: Final = ("gaze", "itpc")
METHOD_LABELS: Final = {"gaze": "gaze", "itpc": "ITPC"}
AXES: Final = ("x", "y", "z")
# Percentiles between which the article's head counts as one of the population (chosen: the middle
# 80 %).
LOW: Final = 10.0
HIGH: Final = 90.0


class RankInPopulation(NamedTuple):
    """A figure of the article compared with a population's figures."""

    article: float
    low: float
    """The population's 10th percentile."""
    median: float
    high: float
    """The population's 90th percentile."""
    percentile: float
    """Percentage of the population below the article's figure."""

    @property
    def inside(self) -> bool:
        """True if the article's figure lies between the 10th and 90th percentile."""
        return self.low <= self.article <= self.high


def rank_in_population(article: float, population: ArrayLike) -> RankInPopulation:
    """Compare a figure of the article with a population's.

    Args:
        article: the article's figure.
        population: (heads,) our figures.

    Returns:
        The percentiles of the population and the article's rank in it.
    """
    values = np.asarray(population, dtype=np.float64)
    low, median, high = np.percentile(values, [LOW, 50.0, HIGH])
    below = 100.0 * float(np.mean(values < article))
    return RankInPopulation(article, float(low), float(median), float(high), below)


def verdict(placement: RankInPopulation) -> str:
    """`inside` if the article's figure lies between our 10th and 90th percentile, or `outside`."""
    return "inside" if placement.inside else "outside"


def count_inside(placements: Sequence[RankInPopulation]) -> int:
    """Count the article's figures that lie between the 10th and 90th percentile of ours."""
    return sum(placement.inside for placement in placements)


def axis_columns(**values: Sequence[FloatArray] | FloatArray) -> dict[str, FloatArray]:
    """Columns of a table such as `error_x_mm`, from three arrays per name, one for each axis."""
    return {
        f"{name}_{axis}_mm": value[k]
        for k, axis in enumerate(AXES)
        for name, value in values.items()
    }


def fixation_rows(table: pd.DataFrame, group: str = "population") -> pd.DataFrame:
    """The rows of one group's fixations."""
    chosen = table[(table["case"] == "fixation") & (table["group"] == group)]
    return chosen.astype({"head": int, "point": int})


def absolute_errors_mm(rows: pd.DataFrame, method: str, axis: str) -> FloatArray:
    """(heads, points) absolute errors of the mean fix, mm."""
    of_method = rows[rows["method"] == method]
    wide = of_method.pivot(index="head", columns="point", values=f"error_{axis}_mm")
    return np.asarray(wide.abs().to_numpy(), dtype=np.float64)


def depth_errors_percent(rows: pd.DataFrame, method: str) -> FloatArray:
    """(heads, points) |dz| / z, percent."""
    depth = rows.groupby("point")["truth_z_mm"].first().sort_index().to_numpy()
    return np.asarray(100.0 * absolute_errors_mm(rows, method, "z") / depth)
