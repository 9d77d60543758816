"""Sights from photographs of both eyes, with a table of joint angles."""

from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

from vergence.calibration.head.gathered import MOST_PLACES, RawRecording
from vergence.calibration.observations import BoardObservations, detect_board_corners
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.perception.joint_angles import parse_finite_number, parse_joint_angles, read_pair_rows
from vergence.perception.joint_rows import Row
from vergence.perception.pairing import pair_up
from vergence.perception.photographs import join_first_names
from vergence.recording.looking import BoardView
from vergence.vision.targets import PlanarTarget

TABLES: Final = ("joints.csv", "joints.json", "joints.toml")
"""File names of the table of joint angles."""
_TIME_COLUMN: Final = "time_s"
_PLACEMENT_COLUMN: Final = "placement"


def holds_photographs(path: Path) -> bool:
    """Return True if a folder holds photographs, not logs."""
    return path.is_dir() and any((path / eye).is_dir() for eye in EYE_NAMES)


def read_photographs(
    path: Path,
    head: HeadModel,
    target: PlanarTarget | None,
    progress: Callable[[float], None] | None = None,
) -> RawRecording:
    """Read views of a folder with `left` and `right`, images named alike, and one of `TABLES`."""
    if target is None:
        raise ConfigurationError(
            f"{path}: expected the board of these photographs as --target, got none"
        )
    tables = [path / name for name in TABLES if (path / name).exists()]
    if len(tables) != 1:
        raise ConfigurationError(
            f"{path}: expected one of {', '.join(TABLES)} with the angles of each pair of images, "
            f"got {join_first_names(table.name for table in tables) or 'none'}"
        )
    found = pair_up(*(path / eye for eye in EYE_NAMES))
    names = [pair.name for pair in found.pairs]
    rows = read_pair_rows(tables[0], names)
    taken = [_read(head, rows[name], f"{tables[0]}: {name}") for name in names]
    untimed = [name for name, one in zip(names, taken, strict=True) if one.time_s is None]
    if 0 < len(untimed) < len(names):
        raise ConfigurationError(
            f"{tables[0]}: expected {_TIME_COLUMN} of all pairs or of none, got none of "
            f"{join_first_names(untimed)}"
        )
    seen, failures = detect_board_corners(
        target,
        [list(each) for each in zip(*found.pairs, strict=True)],
        progress,
        head.cameras.response,
    )
    _refuse_other_sizes(path, head, seen)
    board_views = [
        BoardView(
            float(view) if one.time_s is None else one.time_s,
            one.positions,
            (seen.pixels[0, view], seen.pixels[1, view]),
            (seen.sigma[0, view], seen.sigma[1, view]),
        )
        for view, one in enumerate(taken)
    ]
    remarks: tuple[str, ...] = ()
    if found.unpaired:
        names_alone = join_first_names(one.name for one in found.unpaired)
        remarks = (f"{len(found.unpaired)} images without a partner left out: {names_alone}",)
    files = [str(one.relative_to(path)) for pair in found.pairs for one in pair]
    return RawRecording(
        target,
        board_views,
        [one.placement for one in taken],
        (*files, tables[0].name),
        remarks,
        tuple(failures),
    )


class _Taken(NamedTuple):
    """A row of the table."""

    positions: FloatArray
    """(7,) joint angles, rad."""
    placement: int
    """Number of the board's placement."""
    time_s: float | None


def _read(head: HeadModel, row: Row, where: str) -> _Taken:
    angles = {
        name: value for name, value in row.items() if name not in (_TIME_COLUMN, _PLACEMENT_COLUMN)
    }
    time_s = (
        parse_finite_number(row[_TIME_COLUMN], f"{where}: {_TIME_COLUMN}")
        if _TIME_COLUMN in row
        else None
    )
    placement = parse_finite_number(row.get(_PLACEMENT_COLUMN, 0), f"{where}: {_PLACEMENT_COLUMN}")
    if not (placement.is_integer() and 0 <= placement < MOST_PLACES):
        raise ConfigurationError(
            f"{where}: {_PLACEMENT_COLUMN}: expected a whole number below {MOST_PLACES}, got "
            f"{row[_PLACEMENT_COLUMN]!r:.40}"
        )
    return _Taken(parse_joint_angles(head, angles, where), int(placement), time_s)


def _refuse_other_sizes(path: Path, head: HeadModel, observations: BoardObservations) -> None:
    for eye, size in zip(EYE_NAMES, observations.image_sizes, strict=True):
        own = tuple(head.cameras.size[EYE_NAMES.index(eye)].tolist())
        if own != size:
            raise ConfigurationError(
                f"{path / eye}: expected images of {own[0]} x {own[1]} px, as the head "
                f"{head.name} has, got {size[0]} x {size[1]}"
            )
