"""Shared by the campaigns: their options, rounds and findings, and children that are watched.

A fork of a process that has loaded everything begins at once, so that thousands of commands can
be tried.
"""

import argparse
import importlib
import itertools
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

from hypothesis import HealthCheck, Phase, given, seed, settings

from vergence.controllers.controller import CONTROLLERS

MODULES: Final = (
    "cli", "eval.gaze_figure", "eval.article.reproduce", "eval.comparison.evaluate",
    "eval.comparison.folder", "eval.comparison.tables", "perception.finding",
    "perception.pictures", "eval.tuning.tune", "models.mujoco.export", "training.choices",
    "training.export", "training.run",
)  # fmt: skip
MEMORY: Final = 6 * 2**30
"""Memory that a command may use beyond its parent, bytes (chosen: no command needs as much)."""
ALLOWED: Final = (0, 1, 2, 130)
"""Exit codes of the command line (chosen: its interface, see vergence.cli)."""
os.environ.setdefault("OMP_NUM_THREADS", "1")  # a fork has its parent's threads no more
os.environ.setdefault("MPLBACKEND", "Agg")

_TRACE: Final = re.compile(r"Traceback \(most recent call last\)|^  File \"", re.MULTILINE)


_HELP: Final = {
    "minutes": "in all, or of each input of a robot",
    "moments": "of each fault and command",
    "seed": "another one tries others",
    "keep": "folder for the files of what was found",
}


def options_of(doc: str, words: Sequence[str], **options: Any) -> argparse.Namespace:
    """Options of a campaign: each has a default, or choices of which one or more are taken."""
    parser = argparse.ArgumentParser(
        prog=" ".join(("python -m tests.campaigns", *sys.argv[1:2])),
        description=doc.partition("\n")[0],
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    for name, given_ in options.items():
        if isinstance(given_, tuple):
            more = {"nargs": "+", "choices": given_, "help": "one or more"}
        else:
            more = {"type": type(given_), "help": _HELP[name]}
        parser.add_argument(f"--{name}", default=given_, **more)
    return parser.parse_args(words)


def rounds(minutes: float, number: int) -> Iterator[int]:
    """Seeds of rounds until the time is up; other ones for another number."""
    begun_s = time.monotonic()
    for place in itertools.count(1_000_003 * number):
        if time.monotonic() - begun_s >= 60.0 * minutes:
            return
        yield place


class Findings:
    """Ends of inputs, and their faults by kind; a folder may keep the files of these."""

    def __init__(self, keep: Path | None = None) -> None:
        self.keep = keep
        self.ends: Counter[str] = Counter()
        self.faults: dict[str, list[str]] = {}

    def add(self, kind: str, case: str, trace: str, folder: Path | None = None) -> None:
        cases = self.faults.setdefault(kind, [])
        cases.append(case)
        if len(cases) == 1:
            print(f"FAULT {kind}\n  {case}\n{trace[-2500:]}", flush=True)
            if self.keep is not None and folder is not None:
                shutil.copytree(folder, self.keep / f"{len(self.faults):03d}", symlinks=True)

    def show(self, what: str) -> None:
        said = ", ".join(f"{end}: {count}" for end, count in sorted(self.ends.items()))
        print(f"{what}: {self.ends.total()} tried; {said}", flush=True)

    def report(self) -> int:
        for kind, cases in self.faults.items():
            print(f"{len(cases)} x {kind}\n  {cases[0]}")
        print(f"{len(self.faults)} kinds of fault")
        return int(bool(self.faults))


class Outcome(NamedTuple):
    """Result of a command; one that a signal has ended, at its limit too, has no exit code."""

    code: int | None
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


def load(commands: Sequence[Sequence[str]]) -> None:
    """Load modules, and run commands in this process, whose machine code its forks begin with."""
    for name in MODULES:
        importlib.import_module(f"vergence.{name}")
    for place in CONTROLLERS.values():
        importlib.import_module(place.partition(":")[0])
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
    begin: Callable[[], None] = lambda: None,
    watch: Callable[[int, float], None] = lambda pid, seconds: None,
) -> Outcome:
    """Run a command in a folder; its HOME, caches and data lie beside it. See `forked`."""
    said = folder.parent / f"{folder.name}.said"
    said.mkdir(exist_ok=True)

    def command() -> int:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for number, name in ((1, "out"), (2, "err")):
            handle = os.open(said / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
            os.dup2(handle, number)
        sys.stdout = open(1, "w", encoding="utf-8", errors="replace", closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", encoding="utf-8", errors="replace", closefd=False)  # noqa: SIM115
        os.environ |= {"HOME": str(said), "XDG_DATA_HOME": str(said / "data"), "COLUMNS": "100"}
        os.chdir(folder)
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
        begin()
        from vergence.cli import main

        try:
            main(list(words))
        except SystemExit as stop:
            return stop.code if isinstance(stop.code, int) else int(stop.code is not None)
        return 0

    code, seconds, _ = forked(command, limit_s, watch)
    out, err = ((said / name).read_text("utf-8", "replace") for name in ("out", "err"))
    return Outcome(code, seconds, out, err)


def forked(
    work: Callable[[], int],
    limit_s: float,
    watch: Callable[[int, float], None] = lambda pid, seconds: None,
) -> tuple[int | None, float, int]:
    """Work in a child, which is killed after a time with all that it has started.

    The parent calls `watch` again and again, with the child's number and age in seconds.

    Returns:
        Exit code, or None if a signal ended it; seconds; greatest memory, KiB.
    """
    begun_s = time.monotonic()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # a fork of a process with threads
        pid = os.fork()
    if pid == 0:
        code = 70
        try:
            os.setsid()
            code = work()
        except BaseException:
            traceback.print_exc()
        finally:
            try:
                sys.stdout.flush()
                sys.stderr.flush()
            finally:
                os._exit(code)
    while True:
        done, status, usage = os.wait4(pid, os.WNOHANG)
        seconds = time.monotonic() - begun_s
        if done or seconds > limit_s:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(pid, signal.SIGKILL)  # workers that have outlived it, too
        if done:
            code = os.WEXITSTATUS(status) if os.WIFEXITED(status) else None
            return code, seconds, usage.ru_maxrss
        watch(pid, seconds)
        time.sleep(0.002)


def fresh(path: Path, model: Path | None = None) -> Path:
    """An empty folder, or a copy of another."""
    shutil.rmtree(path, ignore_errors=True)
    if model is None:
        path.mkdir(parents=True)
    else:
        shutil.copytree(model, path, symlinks=True)
    return path


def try_each(cases: Any, attempt: Callable[[Any], None], number: int, count: int) -> None:
    """Try some inputs of a strategy; they are drawn anew for another number."""

    @seed(number)
    @settings(
        max_examples=count, database=None, deadline=None, derandomize=False,
        phases=(Phase.generate,), suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(cases)
    def run_cases(case: Any) -> None:
        attempt(case)

    run_cases()
