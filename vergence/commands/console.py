"""What commands show while they work: notes, progress bars."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

_PROGRESS_AFTER_S = 2.0


def note(text: str) -> None:
    """A line on standard error, under the program's name."""
    print(f"vergence: {text}", file=sys.stderr)


@contextmanager
def progress(what: str) -> Iterator[Callable[[float], None]]:
    """A progress bar on standard error, from two seconds on and only on a terminal."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    bar = Progress(*columns, console=console, transient=True)
    task = bar.add_task(what, total=1.0)
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


class Bars:
    """A progress bar for each experiment on a terminal, a line for each elsewhere."""

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

    def __enter__(self) -> "Bars":
        if self._console.is_terminal:
            self._bars.start()
        return self

    def __exit__(self, *exception: object) -> None:
        if self._console.is_terminal:
            self._bars.stop()

    def begin(self, name: str) -> Callable[[int, int], None]:
        """See `Listener.begin`."""
        task = self._tasks[name] = self._bars.add_task(name, total=None, state="")

        def report(done: int, total: int) -> None:
            # an experiment may map several rounds of jobs: the bar shows the present one
            self._bars.update(task, completed=done, total=total, state=f"{done} of {total}")

        return report

    def end(self, name: str, seconds: float | None) -> None:
        """See `Listener.end`."""
        state = "kept from an earlier call" if seconds is None else f"{seconds:.1f} s"
        self._bars.update(self._tasks[name], completed=1, total=1, state=state)
        if not self._console.is_terminal:
            print(f"{name}: {state}", file=sys.stderr, flush=True)
