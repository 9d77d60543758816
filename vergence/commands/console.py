"""Console output of commands while they work: notes, progress bars."""

import codecs
import io
import logging
import queue
import sys
import time
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from logging.handlers import QueueHandler, QueueListener
from typing import Final

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

_PROGRESS_AFTER_S: Final = 2.0
"""Time after which a progress bar appears, s (chosen: short work shows none)."""
_LONGEST_NOTE: Final = 1000
"""Longest note, characters; longer ones, such as quoted input, lose their middle
(chosen: detail against length)."""
_MOST_FAILURES: Final = 5
"""Most unreadable files that are listed one by one (chosen: detail against length)."""


def print_to_stderr(text: str) -> None:
    """Print a line on standard error, prefixed with the program's name."""
    line = "".join(
        c if c.isprintable() else f"\\x{ord(c):02x}" for c in " ".join(text.splitlines())
    )
    if len(line) > _LONGEST_NOTE:
        line = f"{line[: _LONGEST_NOTE // 2]} ... {line[-_LONGEST_NOTE // 2 :]}"
    print(f"vergence: {line}", file=sys.stderr)


@contextmanager
def logging_to_stderr(verbosity: int) -> Iterator[None]:
    """Print the package's log records from a thread, so that a slow terminal delays no robot."""
    logger = logging.getLogger("vergence")
    before = logger.level
    # a robot's log file records INFO in any case
    logger.setLevel(logging.DEBUG if verbosity > 1 else logging.INFO)
    records: queue.SimpleQueue[logging.LogRecord] = queue.SimpleQueue()
    handler, listener = QueueHandler(records), QueueListener(records, _Notes())
    handler.addFilter(lambda record: not hasattr(record, "warned"))  # shown as warnings already
    if verbosity:
        logger.addHandler(handler)
        listener.start()
    try:
        yield
    finally:
        logger.setLevel(before)
        if verbosity:
            logger.removeHandler(handler)
            listener.stop()


class _Notes(logging.Handler):
    """Log handler that prints records with the time since the program's start, s."""

    def emit(self, record: logging.LogRecord) -> None:
        name = record.name.removeprefix("vergence.")
        level = f"{record.levelname.lower()}: " if record.levelno >= logging.WARNING else ""
        with suppress(OSError):  # standard error is closed
            print_to_stderr(
                f"{1e-3 * record.relativeCreated:.3f} s {name}: {level}{record.getMessage()}"
            )


def print_guesses(guesses: Sequence[str]) -> None:
    """Print one line per assumed or doubtful value of a calibration."""
    for guess in guesses:
        print_to_stderr(f"assumed: {guess}")


def print_read_errors(read_errors: Sequence[str]) -> None:
    """Print one line per file that could not be read, at most `_MOST_FAILURES`."""
    for text in read_errors[:_MOST_FAILURES]:
        print_to_stderr(f"error: {text}")
    if len(read_errors) > _MOST_FAILURES:
        print_to_stderr(
            f"error: and {len(read_errors) - _MOST_FAILURES} more that could not be read"
        )


def replace_unprintable() -> None:
    """Make standard output and error replace characters that their encoding lacks."""
    codecs.register_error(_ERROR_HANDLER_NAME, _ascii_replacement)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_ERROR_HANDLER_NAME)


_ERROR_HANDLER_NAME = "vergence-plain"
_ASCII_LOOKALIKES = {
    "–": "-", "—": "-", "−": "-", "×": "x", "±": "+-", "°": " deg", "µ": "u", "…": "...",
    "≤": "<=", "≥": ">=",
}  # fmt: skip


def _ascii_replacement(error: UnicodeError) -> tuple[str, int]:
    """Error handler for codecs: a lookalike in ASCII, or else the character's escape code."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    found = []
    for character in error.object[error.start : error.end]:
        plain = _ASCII_LOOKALIKES.get(character) or _line_of_a_box(character)
        found.append(plain or character.encode("ascii", "backslashreplace").decode())
    return "".join(found), error.end


def _line_of_a_box(character: str) -> str:
    name = unicodedata.name(character, "")
    if not name.startswith("BOX DRAWINGS"):
        return ""
    if " AND " in name:
        return "+"
    return "|" if "VERTICAL" in name else "-"


@contextmanager
def progress_bar(label: str) -> Iterator[Callable[[float], None]]:
    """Show a progress bar on standard error, only on a terminal and after two seconds."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    bar = Progress(*columns, console=console, transient=True)
    task = bar.add_task(label, total=1.0)
    begun = time.monotonic()
    shown = False

    def report(fraction: float) -> None:
        nonlocal shown
        if not shown and console.is_terminal and time.monotonic() - begun > _PROGRESS_AFTER_S:
            bar.start()
            shown = True
        bar.update(task, completed=fraction)

    try:
        yield report
    finally:
        if shown:
            bar.stop()


_LINE_INTERVAL_S: Final = 30.0
"""Time between two progress lines if there is no terminal, s (chosen: news against length)."""


class ExperimentProgress:
    """Progress of experiments: a bar for each on a terminal, lines elsewhere."""

    def __init__(self) -> None:
        columns = (
            TextColumn("{task.description:<18}"),
            BarColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[state]}"),
        )
        self._console = Console(stderr=True)
        self._bars = Progress(*columns, console=self._console)
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> "ExperimentProgress":
        if self._console.is_terminal:
            self._bars.start()
        return self

    def __exit__(self, *exception: object) -> None:
        if self._console.is_terminal:
            self._bars.stop()

    def begin(self, name: str) -> Callable[[int, int], None]:
        """See `ReproduceListener.begin`."""
        task = self._tasks[name] = self._bars.add_task(name, total=None, state="")
        told_s = time.monotonic()

        def report(done: int, total: int) -> None:
            nonlocal told_s
            if not self._console.is_terminal and time.monotonic() - told_s > _LINE_INTERVAL_S:
                told_s = time.monotonic()
                print_to_stderr(f"{name}: {done} of {total}")
            # an experiment may map several rounds of jobs: the bar shows the present one
            self._bars.update(task, completed=done, total=total, state=f"{done} of {total}")

        return report

    def warn(self, name: str, why: str) -> None:
        """See `ReproduceListener.warn`."""
        if self._console.is_terminal:
            self._console.print(f"vergence: {name} {why}", markup=False, highlight=False)
        else:
            print_to_stderr(f"{name} {why}")

    def end(self, name: str, seconds: float | None) -> None:
        """See `ReproduceListener.end`."""
        state = "kept from an earlier call" if seconds is None else f"{seconds:.1f} s"
        self._bars.update(self._tasks[name], completed=1, total=1, state=state)
        if not self._console.is_terminal:
            print(f"{name}: {state}", file=sys.stderr, flush=True)
