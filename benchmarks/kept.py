"""Tables of results in docs/results: their keys and sources."""

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
    """Columns that identify a row; their values and a column's name form a key: `a/b/column`."""
    source: str = ""
    """Source file in a run folder of `vergence evaluate`; empty for a benchmark's table."""
    always: tuple[str, ...] = ()
    """Columns that are kept even if no document quotes them."""


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
    """Path of a table."""
    return RESULTS / f"{table}.csv"


def numbers_of(path: Path, columns: tuple[str, ...]) -> dict[str, float]:
    """Numbers of a table by key: the values of these columns and the name of its own column."""
    table = pd.read_csv(path).set_index(list(columns))
    numbers: Any = table.select_dtypes("number").stack().dropna()
    return {"/".join(map(str, key)): float(value) for key, value in numbers.items()}


@cache
def _numbers(table: str) -> dict[str, float]:
    return numbers_of(file_of(table), KEPT[table].columns)


def number_of(table: str) -> Callable[[str], float]:
    """Look-up function from the keys of a table to its numbers; reads the table at the first call.

    Raises:
        KeyError: by the returned function, if the table has no such number.
        FileNotFoundError: by the returned function, if there is no such table.
    """
    return lambda key: _numbers(table)[key.strip("/")]


def tables() -> dict[str, Callable[[str], float]]:
    """Look-up function `number_of` of every table, by name."""
    return {table: number_of(table) for table in KEPT}
