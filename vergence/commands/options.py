"""Options that several commands have."""

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
from typing import TYPE_CHECKING, Annotated, TypeVar

import tyro

from vergence.commands.console import note
from vergence.commands.extras import require
from vergence.errors import ConfigurationError

if TYPE_CHECKING:
    from vergence.eval.jobs import Mapper, Progress

T = TypeVar("T")
Flat = Annotated[T, tyro.conf.arg(name="")]
"""A dataclass whose fields are options of the command that holds it."""


@dataclass(frozen=True, kw_only=True)
class Machines:
    """Where a command's jobs run."""

    workers: Annotated[int | None, tyro.conf.arg(help_behavior_hint="", metavar="INT")] = None
    """Processes on this machine; one per processor by default."""
    cluster: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="HOST:PORT")] = None
    """Address of a Ray cluster to run on, HOST:PORT (needs the extra cluster)."""

    def open_mapper(self, progress: "Progress | None" = None) -> "AbstractContextManager[Mapper]":
        """See `vergence.eval.jobs.open_mapper`."""
        from vergence.eval.jobs import open_mapper

        return open_mapper(self.workers, self.cluster, progress)


@dataclass(frozen=True, kw_only=True)
class Tables:
    """How a command writes its tables."""

    parquet: bool = False
    """Write tables as Parquet too, beside the CSV (needs the extra parquet)."""

    def check(self) -> None:
        """Refuse, before any work is done, what could not be written.

        Raises:
            ConfigurationError: pyarrow is not installed.
        """
        if self.parquet:
            require("parquet", "pyarrow")

    def convert(self, *tables: Path) -> None:
        """Write finished CSV files as Parquet too, if that is wanted.

        Raises:
            ConfigurationError: one cannot be written.
        """
        if self.parquet:
            from vergence.eval.reporting.parquet import write_parquet

            for table in tables:
                try:
                    write_parquet(table)
                except OSError as error:
                    raise ConfigurationError(
                        f"parquet: {table} is written, and cannot be as Parquet: "
                        f"{error.strerror or error}"
                    ) from error


class Output:
    """The run folder of a command, which it writes in the end.

    Attributes:
        folder: where it belongs; once it is written, where it is.
        saved: whether it is written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.saved = False

    def save(self, write: Callable[[Path], None]) -> bool:
        """Write the folder; say where it is instead if its place has been taken, or that it is not.

        Args:
            write: called with the folder to write to.

        Returns:
            Whether it is written: a command still prints what it has found where it is not.
        """
        from vergence.eval.reporting.runs import save_run

        try:
            place = save_run(self.folder, write)
        except ConfigurationError as error:
            note(f"error: {error}")
            return False
        if place != self.folder:
            note(f"{self.folder} has been taken meanwhile: written to {place} instead")
        self.folder, self.saved = place, True
        return True

    def conclude(
        self,
        write: Callable[[Path], None],
        found: Callable[[], object],
        show: Callable[[], None],
        *,
        as_json: bool,
    ) -> None:
        """Save the folder, and print what was found whether or not that could be done.

        Args:
            write: see `save`.
            found: gives the result as plain values.
            show: prints it for people.
            as_json: whether to print it as JSON, and nothing else.
        """
        self.save(write)
        if as_json:
            print(json.dumps(found(), indent=2, allow_nan=False))
            return
        show()
        if self.saved:
            print(f"written to {self.folder}")


@contextmanager
def output(folder: Path) -> Iterator[Output]:
    """Hold the run folder of a command until its end, and say where it is if it is interrupted.

    Args:
        folder: where it belongs.

    Yields:
        The folder, to be saved.

    Raises:
        ConfigurationError: it cannot be written, or another process is writing to it.
        KeyboardInterrupt: says what is written.
    """
    from vergence.eval.reporting.runs import locked_run_folder

    found = Output(folder)
    with locked_run_folder(found.folder):
        try:
            yield found
        except KeyboardInterrupt:
            if found.saved:
                raise KeyboardInterrupt(f"{found.folder} is written") from None
            raise


def check_writable(out: Path) -> None:
    """Refuse, before any work is done, a file that could not be written in the end.

    Args:
        out: the file; folders on the way to it are made when it is written.

    Raises:
        ConfigurationError: the first of these that is there is none, or cannot be written.
    """
    there = next(parent for parent in out.absolute().parents if parent.exists())
    if not there.is_dir() or not os.access(there, os.W_OK):
        raise ConfigurationError(f"out: expected a folder that can be written, got {there}")


def check_figure(path: Path, inputs: Iterable[Path] = ()) -> None:
    """Refuse, before any work is done, a picture that could not be written in the end.

    Args:
        path: of the picture.
        inputs: files that it must not replace, and folders of them.

    Raises:
        ConfigurationError: it is no .png, its folder is not there or cannot be written, or it is
            a folder or one of the inputs.
    """
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
    """The width and the height that a text names, pixels; None for none.

    Raises:
        ConfigurationError: it names none.
    """
    if text is None:
        return None
    match = re.fullmatch(r"(\d{2,5})[xX](\d{2,5})", text)
    if match is None:
        raise ConfigurationError(
            f"size: expected WIDTHxHEIGHT in pixels as one word, such as 640x480, got {text!r:.80}"
        )
    return int(match[1]), int(match[2])


def dated_folder(what: str) -> Path:
    """The run folder of a command that was given none."""
    return Path("runs") / f"{what}-{datetime.now():%Y%m%d-%H%M%S-%f}"
