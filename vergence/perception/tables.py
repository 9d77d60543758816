"""Write located targets as tables: one row per corner, and one row per target."""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from vergence.models.parts import EYE_NAMES
from vergence.perception.located import LocatedTarget
from vergence.perception.spacing import MM
from vergence.perception.target_finder import tag_number

_AXES = ("x", "y", "z")


def write_corner_table(path: Path, located: Sequence[LocatedTarget]) -> None:
    """Write one row per corner of each target; cells without a solution are empty."""
    head = ["pair", "target", "id", "point"]
    head += [f"{axis}_mm" for axis in _AXES] + [f"sigma_{axis}_mm" for axis in _AXES] + ["gap_mm"]
    for what in ("", "sigma_"):
        head += [f"{what}{eye}_{axis}_px" for eye in EYE_NAMES for axis in "uv"]
    _write(path, head, (row for one in located for row in _points(one)))


def _points(one: LocatedTarget) -> Iterable[list[object]]:
    numbers = np.column_stack(
        [
            MM * one.fix.point,
            MM * one.fix.sigma,
            MM * one.fix.gap,
            *one.pixels,
            *one.sigma_px,
        ]
    )
    for point, row in enumerate(numbers):
        yield [one.pair, one.target, tag_number(one.target), point, *map(_cell, row.tolist())]


def write_target_table(path: Path, located: Sequence[LocatedTarget]) -> None:
    """Write one row per target of each pair."""
    head = ["pair", "target", "id", "points"]
    head += [f"{axis}_mm" for axis in _AXES] + [f"sigma_{axis}_mm" for axis in _AXES]
    head += ["gap_rms_mm", "spacing_mean_mm", "spacing_spread_mm", "spacing_stated_mm"]
    rows: list[list[object]] = []
    for one in located:
        mean, spread, _, stated = one.spacing
        numbers = [*one.centre.point, *one.centre.sigma, one.gap_m, mean, spread, stated]
        cells = [_cell(MM * float(number)) for number in numbers]
        rows.append([one.pair, one.target, tag_number(one.target), int(one.valid.sum()), *cells])
    _write(path, head, rows)


def _cell(value: float) -> float | str:
    return value if np.isfinite(value) else ""


def _write(path: Path, head: list[str], rows: Iterable[list[object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(head)
        writer.writerows(rows)
