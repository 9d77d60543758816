"""The tables of results that the repository keeps: their keys, and where they come from."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results"


class Kept(NamedTuple):
    """A table of docs/results."""

    columns: tuple[str, ...]
    """What names a row; with the name of a column, they name a number: `a/b/column`."""
    source: str = ""
    """The file of a run folder of `vergence evaluate` that it is taken from; else a benchmark's."""
    always: tuple[str, ...] = ()
    """Columns that are taken along also where no document quotes them."""


_SHARES = (
    "trials", "settled_fraction", "settled_2px_fraction", "lost_fraction", "left_again_fraction",
    "swinging_trials",
)  # fmt: skip
_EVALUATED = ("scenario", "plant", "controller")
KEPT = {
    "evaluate": Kept(_EVALUATED, "summary.csv", _SHARES),
    "moving": Kept(_EVALUATED, "summary.csv", _SHARES),
    "learned": Kept(_EVALUATED, "summary.csv", _SHARES),
    "heads": Kept(("head", *_EVALUATED), "summary.csv", _SHARES),
    "margins": Kept(
        ("scenario", "controller", "imperfection"),
        "margins.csv",
        ("unit", "expected", "searched_low", "searched_high"),
    ),
    "beyond_training": Kept(("imperfection", "controller")),
    "returns": Kept(("scenario", "policy")),
    "calm": Kept(("head", "fault", "law")),
    "calm_count": Kept(("scenario", "law")),
    "wire": Kept(("cameras", "law")),
    "on_robot": Kept(_EVALUATED, "summary.csv", _SHARES),
    "delay": Kept(("quantity",)),
    "robot": Kept(("priority", "loop")),
    "stable_baselines": Kept(("way", "seed")),
    "calibration": Kept(("lens",)),
    "calibration_photographs": Kept(("data_set",)),
    "head_calibration": Kept(("head",)),
    "real_light": Kept(("image",)),
}


def file_of(table: str) -> Path:
    """Where a table lies."""
    return RESULTS / f"{table}.csv"


def numbers_of(path: Path, columns: tuple[str, ...]) -> dict[str, float]:
    """Every number of a table, by what these columns and its own one say."""
    table = pd.read_csv(path).set_index(list(columns))
    numbers: Any = table.select_dtypes("number").stack().dropna()
    return {"/".join(map(str, key)): float(value) for key, value in numbers.items()}


@cache
def _numbers(table: str) -> dict[str, float]:
    return numbers_of(file_of(table), KEPT[table].columns)


def number_of(table: str) -> Callable[[str], float]:
    """What gives the number of a key of a table; the table is read when it is first asked.

    Raises:
        KeyError: of what it returns, the table has no such number.
        FileNotFoundError: likewise, there is no such table.
    """
    return lambda key: _numbers(table)[key.strip("/")]


def tables() -> dict[str, Callable[[str], float]]:
    """`number_of` of every table, by name."""
    return {table: number_of(table) for table in KEPT}
