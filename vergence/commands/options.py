"""Options and output files shared by several commands."""

import errno
import json
import os
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

import tyro

from vergence.commands.console import print_to_stderr
from vergence.commands.extras import require_modules
from vergence.errors import ConfigurationError

if TYPE_CHECKING:
    from vergence.reporting.jobs import Mapper, Progress

T = TypeVar("T")
Flat = Annotated[T, tyro.conf.arg(name="")]
"""A dataclass whose fields are options of the command that holds it."""
CalibrationSize = Annotated[
    str | None,
    tyro.conf.arg(
        help_behavior_hint="",
        metavar="WIDTHxHEIGHT",
        help="Image size in pixels, such as 640x480, if the calibration does not have it.",
    ),
]
CalibrationLens = Annotated[
    Literal["brown-conrady", "rational", "fisheye"] | None,
    tyro.conf.arg(
        help_behavior_hint="",
        metavar="{brown-conrady,rational,fisheye}",
        help="Lens model, if the calibration does not name it; by default the coefficient count "
        "decides.",
    ),
]


@dataclass(frozen=True, kw_only=True)
class JobOptions:
    """Processes and machines that run a command's jobs."""

    workers: Annotated[int | None, tyro.conf.arg(help_behavior_hint="", metavar="INT")] = None
    """Processes on this machine; one per processor by default."""
    cluster: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="HOST:PORT")] = None
    """Address of a Ray cluster to run on (needs the extra cluster)."""

    def open_mapper(self, progress: "Progress | None" = None) -> "AbstractContextManager[Mapper]":
        """See `vergence.reporting.jobs.open_mapper`."""
        from vergence.reporting.jobs import open_mapper

        return open_mapper(self.workers, self.cluster, progress)


@dataclass(frozen=True, kw_only=True)
class TableOptions:
    """File formats of a command's tables."""

    parquet: bool = False
    """Also write tables as Parquet, beside the CSV (needs the extra parquet)."""

    def check(self) -> None:
        """Refuse, before any work is done, a format that cannot be written."""
        if self.parquet:
            require_modules("parquet", "pyarrow")

    def convert(self, *tables: Path) -> None:
        """Also write finished CSV files as Parquet, if requested."""
        if self.parquet:
            from vergence.reporting.runs import write_parquet

            for table in tables:
                try:
                    write_parquet(table)
                except OSError as error:
                    raise ConfigurationError(
                        f"parquet: {table} is written, and cannot be as Parquet: "
                        f"{error.strerror or error}"
                    ) from error


class RunFolder:
    """Run folder of a command, written at its end.

    Attributes:
        folder: path of the run folder; after `save`, the path at which it was written.
        saved: True once it is written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.saved = False

    def save(self, write: Callable[[Path], None]) -> bool:
        """Write the folder, elsewhere if taken by now; report that or a failure. True if done."""
        from vergence.reporting.runs import save_run_at_free_path

        try:
            place = save_run_at_free_path(self.folder, write)
        except ConfigurationError as error:
            print_to_stderr(f"error: {error}")
            return False
        if place != self.folder:
            print_to_stderr(f"{self.folder} has been taken meanwhile: written to {place} instead")
        self.folder, self.saved = place, True
        return True

    def finish(
        self,
        write: Callable[[Path], None],
        result: Callable[[], object],
        print_text: Callable[[], None],
        *,
        as_json: bool,
    ) -> None:
        """Save the folder, and print text, or JSON alone, even if that fails."""
        self.save(write)
        if as_json:
            print(json.dumps(result(), indent=2, allow_nan=False))
            return
        print_text()
        if self.saved:
            print_written(self.folder)


def print_written(folder: Path) -> None:
    """Print the path of a run folder, and of the report in it, if it has one."""
    report = next(folder.glob("*.html"), None)
    print(f"written to {folder}" + ("" if report is None else f"; report: {report}"))


@contextmanager
def claimed_run_folder(folder: Path) -> Iterator[RunFolder]:
    """Claim a command's run folder until its end, and report its path on an interrupt."""
    from vergence.reporting.runs import locked_run_folder

    found = RunFolder(folder)
    with locked_run_folder(found.folder):
        try:
            yield found
        except KeyboardInterrupt:
            if found.saved:
                raise KeyboardInterrupt(f"{found.folder} is written") from None
            raise


def check_writable(out: Path) -> None:
    """Refuse, before any work is done, a file that cannot be written."""
    there = next(parent for parent in out.absolute().parents if parent.exists())
    if not there.is_dir() or not os.access(there, os.W_OK):
        raise ConfigurationError(f"out: expected a folder that can be written, got {there}")


def check_figure(path: Path, inputs: Iterable[Path] = ()) -> None:
    """Refuse, before any work is done, a figure that cannot be written."""
    if path.suffix.lower() != ".png":
        raise ConfigurationError(f"figure: expected a name that ends in .png, got {path}")
    try:
        with tempfile.TemporaryDirectory(prefix=".vergence-", dir=path.parent):
            pass
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        replaces = path.exists() and any(
            one.samefile(path.parent if one.is_dir() else path) for one in inputs if one.exists()
        )
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigurationError(
            f"figure: expected a file that can be written, got {path}: {reason}"
        ) from error
    if replaces:
        raise ConfigurationError(f"figure: expected another file than the images, got {path}")


def parse_size(text: str | None) -> tuple[int, int] | None:
    """Width and height stated by a text such as 640x480, pixels; None for None."""
    if text is None:
        return None
    match = re.fullmatch(r"(\d{2,5})[xX](\d{2,5})", text)
    if match is None:
        raise ConfigurationError(
            f"size: expected WIDTHxHEIGHT in pixels as one word, such as 640x480, got {text!r:.80}"
        )
    return int(match[1]), int(match[2])


def dated_run_folder(command: str) -> Path:
    """Default run folder of a command: runs/WHAT-DATE-TIME."""
    return Path("runs") / f"{command}-{datetime.now():%Y%m%d-%H%M%S-%f}"
