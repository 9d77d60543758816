"""Read the joint angles at which image pairs were taken: one row for all pairs, or one for each."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import EYES, NECK, FloatArray
from vergence.perception.joint_rows import PAIR, Row, read_table_rows
from vergence.perception.photographs import join_first_names

_LIMIT_TOLERANCE_RAD: Final = 0.1
"""Tolerance of a joint's limits, rad: encoders have an offset, and limits are rounded (chosen:
these against angles in the wrong unit)."""
_RADIANS_PER_SUFFIX: Final = {"_rad": 1.0, "_deg": math.pi / 180.0}


def eyes_move(head: HeadModel) -> bool:
    """True if points depend on joint angles: frame N follows the neck, so only eye joints count."""
    return head.actuation.count > 0


def read_joint_angles(
    head: HeadModel, file: Path | None, pairs: Sequence[str]
) -> Mapping[str, FloatArray]:
    """Joint angles (7,) by pair, rad, from JSON, CSV or TOML; a head at rest without a file."""
    if file is None:
        return dict.fromkeys(pairs, head.rest())
    rows = read_pair_rows(file, pairs)
    return {pair: parse_joint_angles(head, row, f"{file}: {pair}") for pair, row in rows.items()}


def read_pair_rows(file: Path, pairs: Sequence[str]) -> Mapping[str, Row]:
    """Rows by pair, without the column `pair`, see `read_joint_angles`."""
    rows = read_table_rows(file)
    if len(rows) == 1 and PAIR not in rows[0]:
        return dict.fromkeys(pairs, rows[0])
    by_pair: dict[str, Row] = {}
    for number, row in enumerate(rows, 1):
        name = str(row.pop(PAIR, ""))
        if not name:
            raise ConfigurationError(
                f"{file}: expected the name of the left image as {PAIR!r} in each of the "
                f"{len(rows)} rows, got none in row {number}"
            )
        if name in by_pair:
            raise ConfigurationError(f"{file}: expected one row for each pair, got two of {name!r}")
        by_pair[name] = row
    found = {}
    for pair in pairs:
        name = pair if pair in by_pair else Path(pair).stem
        if name not in by_pair:
            raise ConfigurationError(
                f"{file}: expected a row whose {PAIR!r} is {pair!r}, got "
                f"{join_first_names(by_pair)}"
            )
        found[pair] = by_pair[name]
    return found


def parse_joint_angles(head: HeadModel, row: Row, where: str) -> FloatArray:
    """(7,) rad, of a row by joints or actuators (`_deg`: degrees); `where` is for messages."""
    given = _radians(head, row, where)
    own = head.actuation
    joints = [name for name in dict.fromkeys(head.joints[EYES]) if name]
    lacking = [name for name in joints if name not in given]
    q = head.rest()
    for place, name in enumerate(head.joints):
        q[place] = given.get(name, q[place])
    if lacking:
        if not own.count or not all(name in given for name in own.names):
            raise ConfigurationError(
                f"{where}: expected the angles of {', '.join(joints)}, got none of "
                f"{', '.join(lacking)}"
            )
        actuators = np.zeros(7)
        actuators[NECK] = q[NECK]
        actuators[EYES][: own.count] = [given[name] for name in own.names]
        q = own.joints_of(actuators)
    for place, name in enumerate(head.joints):
        low, high = (
            head.limits.lower[place] - _LIMIT_TOLERANCE_RAD,
            head.limits.upper[place] + _LIMIT_TOLERANCE_RAD,
        )
        if name and not low <= q[place] <= high:
            raise ConfigurationError(
                f"{where}: {name}: expected {head.limits.lower[place]:.4g} to "
                f"{head.limits.upper[place]:.4g} rad, got {q[place]:.4g} "
                f"(an angle in degrees is named {name}_deg)"
            )
    return q


def _radians(head: HeadModel, row: Row, where: str) -> dict[str, float]:
    """Angles of a row by the names of joints and actuators, rad."""
    names = dict.fromkeys(name for name in (*head.joints, *head.actuation.names) if name)
    found: dict[str, float] = {}
    for column, value in row.items():
        name, unit = column, 1.0
        for suffix, size in _RADIANS_PER_SUFFIX.items():
            if column not in names and column.endswith(suffix):
                name, unit = column.removesuffix(suffix), size
        if name not in names:
            raise ConfigurationError(
                f"{where}: expected joints among {', '.join(names) or 'none (a fixed pair)'}, "
                f"got {column!r:.80}"
            )
        if name in found:
            raise ConfigurationError(f"{where}: expected {name} once, got it twice")
        found[name] = unit * parse_finite_number(value, f"{where}: {column}")
    return found


def parse_finite_number(value: Any, where: str) -> float:
    """Convert a table's value to a finite number."""
    if not isinstance(value, bool) and isinstance(value, int | float | str):
        try:
            number = float(value)
        except (ValueError, OverflowError):
            number = math.nan
        if math.isfinite(number):
            return number
    raise ConfigurationError(f"{where}: expected a number, got {value!r:.80}")
