"""Table of a robot's gazes."""

from collections.abc import Mapping, Sequence
from math import degrees
from typing import Any, Final

from vergence.commands.tables import print_table

_COLUMNS: Final = {
    "gaze": ("gaze", 0, 1.0),
    "duration_s": ("length (s)", 2, 1.0),
    "settle_2px_s": ("to 2 px (ms)", 0, 1000.0),
    "settle_1px_s": ("to 1 px (ms)", 0, 1000.0),
    "fixation_speed_pp": ("at rest (deg/s)", 2, degrees(1.0)),
    "point_error_mm": ("error (mm)", 1, 1.0),
}
"""Field, heading, decimals, and factor to the heading's unit, the one of `vergence evaluate`."""
_LEGEND: Final = (
    "to 2 px: until both eyes come so near the target to stay; at rest: peak to peak speed of the\n"
    "worst joint while they hold it; error: distance of the last fix by gaze, or by ITPC of eyes\n"
    "that cannot converge, from the target"
)


def print_gazes(rows: Sequence[Mapping[str, Any]], summary: Mapping[str, Any]) -> None:
    """Print a row for each gaze, and a summary line."""
    if rows:
        cells = [
            [_cell(row[name], decimals, factor) for name, (_, decimals, factor) in _COLUMNS.items()]
            for row in rows
        ]
        print_table([head for head, *_ in _COLUMNS.values()], cells, wrapped=())
        print(_LEGEND)
    count, settled = summary["gazes"], summary["settled_fraction"]
    if settled is None:
        return
    parts = [f"{summary['controller']}: {round(settled * count)} of {count} settled to 2 px"]
    if summary["settle_2px_median_s"] is not None:
        parts[0] += f", median {_cell(summary['settle_2px_median_s'], 0, 1000.0)} ms"
    if summary["point_error_median_mm"] is not None:
        parts.append(f"median point error {_cell(summary['point_error_median_mm'], 1)} mm")
    if not summary["faults"]:  # a stop truncates periods, so late ones are not known
        parts.append(f"{100.0 * (summary['overrun_fraction'] or 0.0):.2f} % of the periods late")
    print("; ".join(parts))


def _cell(value: float | None, decimals: int, factor: float = 1.0) -> str:
    return "-" if value is None else f"{factor * value:.{decimals}f}"
