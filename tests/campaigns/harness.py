"""Runs the command line in a forked child: in a folder of its own, with a limit, watched.

A fork of a process that has loaded everything begins at once, so that thousands of commands can
be tried.
"""

import importlib
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from vergence.controllers.controller import CONTROLLERS

MODULES: Final = (
    "vergence.cli",
    "vergence.eval.gaze_figure",
    "vergence.eval.article.reproduce",
    "vergence.eval.comparison.evaluate",
    "vergence.eval.comparison.folder",
    "vergence.eval.comparison.tables",
    "vergence.perception.detect",
    "vergence.eval.reporting.locate_figure",
    "vergence.eval.tuning.tune",
    "vergence.models.mujoco.export",
    "vergence.training.choices",
    "vergence.training.export",
    "vergence.training.run",
)
MEMORY: Final = 6 * 2**30
"""Memory that a command may use beyond its parent, bytes (chosen: no command needs as much)."""
ALLOWED: Final = (0, 1, 2, 130)
"""Exit codes of the command line (chosen: its interface, see vergence.cli)."""
os.environ.setdefault("OMP_NUM_THREADS", "1")  # a fork has its parent's threads no more
os.environ.setdefault("MPLBACKEND", "Agg")

_TRACE: Final = re.compile(r"Traceback \(most recent call last\)|^  File \"", re.MULTILINE)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of a command."""

    words: tuple[str, ...]
    code: int | None
    """None for a command that a signal has ended, that of the limit included."""
    seconds: float
    out: str
    err: str

    def faults(self) -> list[str]:
        """Faults in the output or exit code that no user should ever see."""
        found = []
        if self.code is not None and self.code not in ALLOWED:
            found.append(f"exit code {self.code}")
        if _TRACE.search(self.err) or _TRACE.search(self.out):
            found.append("a stack trace")
        if "a fault of vergence itself" in self.err:
            found.append("an unexpected error")
        if self.code == 2 and not self.err.strip():
            found.append("exit code 2 and not a word")
        return found


def load() -> None:
    """Load modules, and compile the kernels that are not in the cache yet."""
    for name in MODULES:
        importlib.import_module(name)
    for place in CONTROLLERS.values():
        importlib.import_module(place.partition(":")[0])


def warm(commands: Sequence[Sequence[str]]) -> None:
    """Run commands in this process, whose machine code its forks then begin with."""
    from vergence.cli import main

    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder, Path(os.devnull).open("w") as nowhere:
        os.chdir(folder)
        try:
            for words in commands:
                with redirect_stdout(nowhere), redirect_stderr(nowhere), suppress(SystemExit):
                    main(list(words))
        finally:
            os.chdir(here)


def run(
    words: Sequence[str],
    folder: Path,
    limit_s: float,
    begin: Callable[[], None] | None = None,
    watch: Callable[[int, float], None] | None = None,
) -> Outcome:
    """Run a command in a folder.

    Args:
        words: words of the command line.
        folder: the current folder of the command; its HOME, caches and data lie beside it.
        limit_s: time limit, s, after which it is killed.
        begin: called in the child before the command.
        watch: called in the parent, again and again, with the child's number and the seconds
            since it began.
    """
    said = folder.parent / f"{folder.name}.said"
    said.mkdir(exist_ok=True)
    begun = time.monotonic()
    pid = os.fork()
    if pid == 0:
        _child(words, folder, said, begin)
    status = _wait(pid, begun, limit_s, watch)
    return Outcome(
        words=tuple(words),
        code=os.WEXITSTATUS(status) if os.WIFEXITED(status) else None,
        seconds=time.monotonic() - begun,
        out=(said / "out").read_text(encoding="utf-8", errors="replace"),
        err=(said / "err").read_text(encoding="utf-8", errors="replace"),
    )


def _wait(
    pid: int, begun: float, limit_s: float, watch: Callable[[int, float], None] | None
) -> int:
    while True:
        done, status = os.waitpid(pid, os.WNOHANG)
        seconds = time.monotonic() - begun
        if done:
            _kill_group(pid)  # workers that have outlived it
            return status
        if watch is not None:
            watch(pid, seconds)
        if seconds > limit_s:
            _kill_group(pid)
        time.sleep(0.002)


def _kill_group(pid: int) -> None:
    try:
        os.killpg(pid, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        return


def _child(
    words: Sequence[str], folder: Path, said: Path, begin: Callable[[], None] | None
) -> None:
    code = 70
    try:
        os.setsid()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for number, name in ((1, "out"), (2, "err")):
            handle = os.open(said / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
            os.dup2(handle, number)
        sys.stdout = open(1, "w", encoding="utf-8", errors="replace", closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", encoding="utf-8", errors="replace", closefd=False)  # noqa: SIM115
        os.environ["HOME"] = str(said)
        os.environ["XDG_DATA_HOME"] = str(said / "data")
        os.environ["COLUMNS"] = "100"
        os.chdir(folder)
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
        if begin is not None:
            begin()
        from vergence.cli import main

        try:
            main(list(words))
            code = 0
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(code)


def fresh(path: Path, model: Path | None = None) -> Path:
    """An empty folder, or a copy of another."""
    shutil.rmtree(path, ignore_errors=True)
    if model is None:
        path.mkdir(parents=True)
    else:
        shutil.copytree(model, path, symlinks=True)
    return path


def try_each(
    cases: st.SearchStrategy[Any], attempt: Callable[[Any], None], number: int, count: int
) -> None:
    """Try some inputs of a strategy; they are drawn anew for another number."""

    @seed(number)
    @settings(
        max_examples=count,
        database=None,
        deadline=None,
        derandomize=False,
        phases=(Phase.generate,),
        suppress_health_check=list(HealthCheck),
    )
    @given(cases)
    def run_cases(case: Any) -> None:
        attempt(case)

    run_cases()
