"""Kills, full disks and lost permission at random moments of the commands that take long.

    python -m tests.campaigns interruptions  # 50 moments each
    python -m tests.campaigns interruptions --moments 5 --commands tune --faults kill

A moment is a time, or just before the command's n-th change of its files, which is where faults
do harm. After it nothing may be half-written under its own name; with the disk full or closed
the command says so in a line; and the next call goes on, or says why not, and comes to the same
tables as one that was left alone. Full disks need root, for a small tmpfs.
"""

import argparse
import contextlib
import ctypes
import json
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from tests.campaigns import corpus
from tests.campaigns.harness import Outcome, fresh, load, run, warm
from vergence.files import PARTIAL_PREFIX

FAULTS: Final = ("kill", "full", "permission")
COMMANDS: Final = {
    "evaluate": corpus.EVALUATE,
    "train": ("train", "gain-schedule", *corpus.STEPS, "--out", "w", *corpus.TRAIN),
    "tune": corpus.TUNE,
    "reproduce": corpus.REPRODUCE,
    "gaze": (*corpus.GAZE, "--out", "g"),
    "export": ("export", "mjcf", "--out", "m"),
}
_OUT: Final = {"evaluate": "e", "train": "w", "tune": "t", "reproduce": "r", "gaze": "g",
               "export": "m"}  # fmt: skip
_SAME: Final = {
    "evaluate": "trials.csv",
    "reproduce": "tables/time-response.csv",
    "gaze": "result.json",
}
"""A file of each command that comes out the same however often it was interrupted. A search is
none of these: an attempt that was cut off is not begun again, and the next one tries another point.
"""
_LIMIT_S: Final = 240.0
"""Time limit of a command, s (chosen: far longer than any takes)."""
_DISK: Final = "48m"
_BALLAST: Final = "ballast"
_CAPABILITIES: Final = 0x20080522
"""Version of the kernel's capability structures (physical: Linux, see capabilities(7))."""
_DAC: Final = 0b110
"""Bits of CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH, which let root ignore file permissions
(physical: Linux)."""
_CHANGES: Final = frozenset(
    ("os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.chmod", "os.truncate", "sqlite3.connect")
)


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A command that was left alone."""

    seconds: float
    changes: int
    """Number of changes of files."""
    files: frozenset[str]
    """Files in its run folder."""
    same: bytes


@dataclass(kw_only=True)
class Changes:
    """Counts the changes of files below a folder, in the process of the command."""

    folder: Path
    moment: int = 0
    """Number of the change to strike before; 0 for none."""
    strike: Callable[[], None] | None = None
    counted: int = 0
    busy: bool = field(default=False)

    def install(self) -> None:
        """Begin to count; there is no end to it in this process."""
        sys.addaudithook(self._hook)

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.busy or not self._counts(event, arguments):
            return
        self.busy = True
        try:
            self.counted += 1
            if self.strike is None:
                place = self.folder.parent / f"{self.folder.name}.changes"
                place.write_text(str(self.counted))
            elif self.counted == self.moment:
                self.strike()
        finally:
            self.busy = False

    def _counts(self, event: str, arguments: tuple[Any, ...]) -> bool:
        if event == "open":
            path, _mode, flags = arguments
            if not isinstance(path, str | bytes) or not flags & (os.O_WRONLY | os.O_RDWR):
                return False
        elif event in _CHANGES:
            path = arguments[0]
        else:
            return False
        name = os.path.abspath(os.fsdecode(path)) if not isinstance(path, int) else ""
        return name.startswith(str(self.folder))


def obey_permissions() -> None:
    """Let the permissions of files hold for this process, even if it is root's."""
    libc = ctypes.CDLL(None, use_errno=True)
    header = (ctypes.c_uint32 * 2)(_CAPABILITIES, 0)
    sets = (ctypes.c_uint32 * 6)()  # effective, permitted, inheritable; and again for bits from 32
    if libc.capget(header, sets) or not sets[0] & _DAC:
        return
    for place in range(3):
        sets[place] &= ~_DAC
    if libc.capset(header, sets):
        raise OSError(ctypes.get_errno(), "capset")


class Trial:
    """One command at a time in a folder that a fault can strike.

    Args:
        folder: working folder.
        fault: one of `FAULTS`.
    """

    def __init__(self, folder: Path, fault: str) -> None:
        self.folder = folder
        self.fault = fault

    def strike(self) -> None:
        """Let the fault happen, in whichever process calls; a kill is the caller's own end."""
        if self.fault == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        elif self.fault == "full":
            with contextlib.suppress(OSError), (self.folder / _BALLAST).open("wb") as ballast:
                while True:
                    ballast.write(bytes(65536))
                    ballast.flush()
        else:
            for path in (self.folder, *self.folder.rglob("*")):
                with contextlib.suppress(OSError):
                    if path.is_dir():
                        path.chmod(0o500)

    def mend(self) -> None:
        """Undo the fault."""
        (self.folder / _BALLAST).unlink(missing_ok=True)
        for path in (self.folder, *self.folder.rglob("*")):
            if path.is_dir():
                path.chmod(0o755)

    def run(
        self, words: tuple[str, ...], *, at_s: float | None = None, at_change: int | None = None
    ) -> Outcome:
        """Run a command, with the fault at a time, before a change, or not at all."""
        changes = Changes(folder=self.folder)
        if at_change is not None:
            changes.moment, changes.strike = at_change, self.strike

        def begin() -> None:
            os.environ["TMPDIR"] = str(self.folder.parent)
            if self.fault == "permission":
                obey_permissions()
            if at_s is None:
                changes.install()

        struck = False

        def watch(pid: int, seconds: float) -> None:
            nonlocal struck
            if at_s is None or struck or seconds < at_s:
                return
            struck = True
            if self.fault == "kill":
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            else:
                self.strike()

        return run(words, self.folder, _LIMIT_S, begin, watch)


def check(command: str, folder: Path, reference: Reference | None) -> list[str]:
    """Faults of a folder: results that are half-written under their final names."""
    found: list[str] = []
    for place in folder.iterdir():
        if place.name.startswith(".") or not place.is_dir():
            continue
        names = {path.relative_to(place).as_posix() for path in visible(place)}
        if command in ("evaluate", "gaze", "export") and reference is not None:
            missing = reference.files - names
            if missing and names:
                found.append(f"{place.name} lacks {sorted(missing)[:3]}")
        found += [problem for name in sorted(names) if (problem := _unreadable(place / name))]
        if command == "reproduce":
            found += _unfinished(place)
        if command == "train":
            found += _untrained(place)
    return found


def visible(folder: Path) -> Iterator[Path]:
    """The files of a folder that are not hidden, nor in a hidden folder."""
    for path in folder.rglob("*"):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if path.is_file() and not hidden and "tensorboard" not in path.parts:
            yield path


def _unreadable(path: Path) -> str:
    import tomllib

    import pandas as pd

    try:
        if path.suffix == ".json":
            json.loads(path.read_text(encoding="utf-8"))
        elif path.suffix == ".toml":
            tomllib.loads(path.read_text(encoding="utf-8"))
        elif path.suffix == ".csv":
            pd.read_csv(path)
        elif path.suffix == ".svg":
            assert path.read_text(encoding="utf-8").rstrip().endswith("</svg>")
        elif path.suffix == ".html":
            assert path.read_text(encoding="utf-8").rstrip().endswith("</html>")
        elif path.suffix == ".png":
            assert path.read_bytes().endswith(b"IEND\xaeB`\x82")
        elif path.suffix == ".db":
            _sound(path)
        elif path.suffix == ".pt":
            from vergence.training.checkpoint import read_checkpoint

            read_checkpoint(path)
    except Exception as error:
        return f"{path.name} is damaged: {type(error).__name__} {str(error)[:80]}"
    return ""


def _sound(path: Path) -> None:
    with contextlib.closing(sqlite3.connect(path)) as database:
        assert database.execute("pragma integrity_check").fetchone() == ("ok",)


def _unfinished(folder: Path) -> list[str]:
    """Experiments that are marked as finished without what they found."""
    found = []
    for marker in folder.glob("experiments/*.json"):
        content = json.loads(marker.read_text(encoding="utf-8"))
        wanted = [folder / "tables" / f"{marker.stem}.csv"]
        wanted += [folder / "figures" / f"{stem}.svg" for stem in content["figures"]]
        found += [f"{marker.name} without {path.name}" for path in wanted if not path.is_file()]
    return found


def _untrained(folder: Path) -> list[str]:
    from vergence.errors import VergenceError
    from vergence.training.config import load_run

    try:
        load_run(folder)
    except VergenceError as error:
        return [str(error)]
    return []


def _next_words(command: str, folder: Path) -> tuple[str, ...]:
    """Command that a user would call next."""
    if command == "train" and (folder / "w" / "config.toml").is_file():
        return ("train", "--resume", "w")
    return COMMANDS[command]


def _complete(command: str, folder: Path, reference: Reference) -> bool:
    """True if the result exists already, under its own name or a similar one."""
    places = [path for path in folder.glob(f"{_OUT[command]}*") if path.is_dir()]
    return any(
        reference.files <= {path.relative_to(place).as_posix() for path in visible(place)}
        for place in places
    )


def try_moment(
    trial: Trial, command: str, reference: Reference, rng: random.Random
) -> tuple[str, list[str]]:
    """Strike once, look, mend, call again, look.

    Returns:
        Outcome of the moment, and its faults.
    """
    fresh_contents(trial.folder)
    if rng.random() < 0.5:
        at_s = rng.uniform(0.0, 1.1 * reference.seconds)
        when, outcome = f"at {at_s:.2f} s", trial.run(COMMANDS[command], at_s=at_s)
    else:
        change = rng.randint(1, max(1, reference.changes))
        when = f"before change {change}"
        outcome = trial.run(COMMANDS[command], at_change=change)
    wrong = outcome.faults()
    if outcome.code is None and (trial.fault != "kill" or outcome.seconds >= _LIMIT_S):
        wrong.append("it did not end by itself")
    if outcome.code == 2 and "error:" not in outcome.err:
        wrong.append("exit code 2 without a reason")
    wrong += check(command, trial.folder, reference)
    trial.mend()
    if (
        trial.fault != "kill"
        and list(trial.folder.glob(f"{PARTIAL_PREFIX}*"))
        and trial.fault == "full"
    ):
        wrong.append("a half-written folder is left")
    there = _complete(command, trial.folder, reference)
    again = trial.run(_next_words(command, trial.folder))
    wrong += [f"the next call: {fault}" for fault in again.faults()]
    wrong += [f"after the next call: {fault}" for fault in check(command, trial.folder, reference)]
    if list(trial.folder.glob(f"{PARTIAL_PREFIX}*")) and again.code != 2:
        wrong.append("what was half-written is still there after the next call")
    if again.code == 2 and not there:
        wrong.append(f"the next call does not go on: {again.err.strip()[-200:]}")
    if again.code not in (0, 1, 2):
        wrong.append(f"the next call ended with {again.code}")
    name = _SAME.get(command)
    result = trial.folder / _OUT[command] / (name or "")
    if name and result.is_file() and result.read_bytes() != reference.same:
        wrong.append(f"{name} is another than that of a run left alone")
    if wrong:
        wrong.append(f"stderr: {outcome.err.strip()[-1200:]}")
        wrong.append(f"stderr of the next call: {again.err.strip()[-600:]}")
    said = f"{outcome.code if outcome.code is not None else 'killed'} then {again.code}"
    return f"{when}: {said}", wrong


def fresh_contents(folder: Path) -> None:
    """Empty a folder, which may be where a disk is mounted."""
    for path in folder.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()


def left_alone(trial: Trial, command: str) -> Reference:
    """Run a command without a fault."""
    fresh_contents(trial.folder)
    outcome = trial.run(COMMANDS[command])
    if outcome.code not in (0, 1):
        raise AssertionError(f"{command} without a fault: {outcome.code}: {outcome.err}")
    place = trial.folder / _OUT[command]
    name = _SAME.get(command)
    counted = trial.folder.parent / f"{trial.folder.name}.changes"
    return Reference(
        seconds=outcome.seconds,
        changes=int(counted.read_text()) if counted.exists() else 1,
        files=frozenset(path.relative_to(place).as_posix() for path in visible(place)),
        same=(place / name).read_bytes() if name else b"",
    )


@contextlib.contextmanager
def disk(folder: Path, fault: str) -> Iterator[Path]:
    """A folder to work in; on a small disk of its own where it shall be full."""
    work = fresh(folder / "work")
    if fault != "full":
        yield work
        return
    options = ["-t", "tmpfs", "-o", f"size={_DISK}", "tmpfs", str(work)]
    subprocess.run(["mount", *options], check=True)
    try:
        yield work
    finally:
        subprocess.run(["umount", "-l", str(work)], check=False)


def main(arguments: list[str]) -> int:
    """Interrupt; 1 if something was wrong."""
    parser = argparse.ArgumentParser(
        "tests.campaigns interruptions", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--moments", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--commands", nargs="+", choices=list(COMMANDS), default=list(COMMANDS)[:4])
    parser.add_argument("--faults", nargs="+", choices=FAULTS, default=list(FAULTS))
    options = parser.parse_args(arguments)
    faults = [fault for fault in options.faults if fault != "full" or os.getuid() == 0]
    if faults != options.faults:
        print("full: left out, as a small tmpfs needs root")
    load()
    warm(corpus.WARM)
    wrong = 0
    for fault in faults:
        for command in options.commands:
            wrong += _moments(fault, command, options.moments, options.seed)
    print(f"{wrong} moments with something wrong")
    return 1 if wrong else 0


def _moments(fault: str, command: str, moments: int, seed: int) -> int:
    """Strike at so many moments; how many of them came to harm."""
    rng = random.Random(f"{seed} {fault} {command}")
    with tempfile.TemporaryDirectory() as place, disk(Path(place), fault) as folder:
        Path(place).chmod(0o777)
        trial = Trial(folder, fault)
        reference = left_alone(trial, command)
        begun, wrong = time.monotonic(), 0
        ends: Counter[str] = Counter()
        for number in range(moments):
            said, found = try_moment(trial, command, reference, rng)
            ends[said.split(": ")[1]] += 1
            if found:
                wrong += 1
                print(f"WRONG {fault} {command} {number} {said}", *found, sep="\n    ", flush=True)
        taken = time.monotonic() - begun
        shown = ", ".join(f"{how}: {n}" for how, n in sorted(ends.items()))
        alone = f"{reference.seconds:.1f} s and {reference.changes} changes alone"
        print(f"{fault} {command}: {wrong} of {moments} wrong; exit codes {shown} "
              f"({alone}; {taken:.0f} s)", flush=True)  # fmt: skip
    return wrong
