"""Kills, full disks and lost permission at random moments of the commands that take long.

A moment is a time, or just before the command's n-th change of its files, which is where faults
do harm. After it nothing may be half-written under its own name; with the disk full or closed
the command says so in a line; and the next call goes on, or says why not, and comes to the same
tables as one that was left alone. Full disks need root, for a small tmpfs.
"""

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
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import pandas as pd

from tests.campaigns import corpus
from tests.campaigns.harness import Findings, Outcome, fresh, load, options_of, run
from vergence.errors import VergenceError
from vergence.files import PARTIAL_PREFIX


class Command(NamedTuple):
    """A command, its run folder, and a file of it that comes out the same if interrupted.

    A search has none: an attempt that was cut off is not begun again, and the next one tries
    another point.
    """

    words: tuple[str, ...]
    out: str
    same: str = ""


FAULTS: Final = ("kill", "full", "permission")
COMMANDS: Final = {
    "evaluate": Command(corpus.EVALUATE, "e", "trials.csv"),
    "train": Command(corpus.LEARN, "w"),
    "tune": Command(corpus.TUNE, "t"),
    "reproduce": Command(corpus.REPRODUCE, "r", "tables/time-response.csv"),
    "gaze": Command((*corpus.GAZE, "--out", "g"), "g", "result.json"),
    "export": Command(("export", "mjcf", "--out", "m"), "m"),
}
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


class Reference(NamedTuple):
    """A command that was left alone: its changes of files, and the files of its run folder."""

    seconds: float
    changes: int
    files: frozenset[str]
    same: bytes


def watch_changes(folder: Path, each: Callable[[int], None]) -> None:
    """Call with its number before each change of files below a folder, as long as we live."""
    counted, busy = 0, False

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal counted, busy
        writes = event == "open" and arguments[2] & (os.O_WRONLY | os.O_RDWR)
        if busy or not (writes or event in _CHANGES) or isinstance(arguments[0], int):
            return
        busy = True
        try:
            if os.path.abspath(os.fsdecode(arguments[0])).startswith(str(folder)):
                counted += 1
                each(counted)
        finally:
            busy = False

    sys.addaudithook(hook)


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
    """One command at a time in a folder that one of the faults can strike."""

    def __init__(self, folder: Path, fault: str) -> None:
        self.folder = folder
        self.fault = fault
        self.changes = folder.parent / "changes"

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
            self._permit(0o500)

    def mend(self) -> None:
        """Undo the fault."""
        (self.folder / _BALLAST).unlink(missing_ok=True)
        self._permit(0o755)

    def _permit(self, mode: int) -> None:
        for path in (self.folder, *self.folder.rglob("*")):
            with contextlib.suppress(OSError):
                if path.is_dir():
                    path.chmod(mode)

    def run(
        self, words: tuple[str, ...], *, at_s: float | None = None, at_change: int | None = None
    ) -> Outcome:
        """Run a command, with the fault at a time, before a change, or not at all."""
        struck = False

        def change(number: int) -> None:
            if at_change is None:
                self.changes.write_text(str(number))
            elif number == at_change:
                self.strike()

        def begin() -> None:
            os.environ["TMPDIR"] = str(self.folder.parent)
            if self.fault == "permission":
                obey_permissions()
            if at_s is None:
                watch_changes(self.folder, change)

        def watch(pid: int, seconds: float) -> None:
            nonlocal struck
            if at_s is None or struck or seconds < at_s:
                return
            struck = True
            if self.fault == "kill":
                os.kill(pid, signal.SIGKILL)
            else:
                self.strike()

        return run(words, self.folder, _LIMIT_S, begin, watch)

    def left_alone(self, command: str) -> Reference:
        """Run a command without a fault."""
        self.empty()
        words, out, same = COMMANDS[command]
        outcome = self.run(words)
        assert outcome.code in (0, 1), f"{command} without a fault: {outcome.code}: {outcome.err}"
        place = self.folder / out
        return Reference(
            seconds=outcome.seconds,
            changes=int(self.changes.read_text()),
            files=frozenset(visible(place)),
            same=(place / same).read_bytes() if same else b"",
        )

    def empty(self) -> None:
        """Empty the folder, where a disk may be mounted."""
        for path in self.folder.iterdir():
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()


def visible(folder: Path) -> set[str]:
    """The files of a folder that are not hidden, nor in a hidden folder."""
    paths = [path.relative_to(folder) for path in folder.rglob("*") if path.is_file()]
    return {
        path.as_posix()
        for path in paths
        if not any(part.startswith(".") or part == "tensorboard" for part in path.parts)
    }


def check(command: str, folder: Path, reference: Reference | None) -> list[str]:
    """Faults of a folder: results that are half-written under their final names."""
    from vergence.training.config import load_run

    found: list[str] = []
    for place in folder.iterdir():
        if place.name.startswith(".") or not place.is_dir():
            continue
        names = visible(place)
        if command in ("evaluate", "gaze", "export") and reference is not None:
            missing = reference.files - names
            if missing and names:
                found.append(f"{place.name} lacks {sorted(missing)[:3]}")
        found += filter(None, (_damage(place / name) for name in sorted(names)))
        if command == "reproduce":
            found += _unfinished(place)
        if command == "train":
            try:
                load_run(place)
            except VergenceError as error:
                found.append(str(error))
    return found


_ENDS: Final = {".svg": "</svg>", ".html": "</html>", ".png": "IEND\xaeB`\x82"}


def _damage(path: Path) -> str:
    """The reason why a file cannot be read, if there is one."""
    try:
        if path.suffix == ".json":
            json.loads(path.read_text(encoding="utf-8"))
        elif path.suffix == ".toml":
            tomllib.loads(path.read_text(encoding="utf-8"))
        elif path.suffix == ".csv":
            pd.read_csv(path)
        elif path.suffix in _ENDS:
            assert path.read_text(encoding="latin1").rstrip().endswith(_ENDS[path.suffix])
        elif path.suffix == ".db":
            with contextlib.closing(sqlite3.connect(path)) as database:
                assert database.execute("pragma integrity_check").fetchone() == ("ok",)
        elif path.suffix == ".pt":
            from vergence.training.checkpoint import read_checkpoint

            read_checkpoint(path)
    except Exception as error:
        return f"{path.name} is damaged: {type(error).__name__} {str(error)[:80]}"
    return ""


def _unfinished(folder: Path) -> list[str]:
    """Experiments that are marked as finished without what they found."""
    found = []
    for marker in folder.glob("experiments/*.json"):
        content = json.loads(marker.read_text(encoding="utf-8"))
        wanted = [folder / "tables" / f"{marker.stem}.csv"]
        wanted += [folder / "figures" / f"{stem}.svg" for stem in content["figures"]]
        found += [f"{marker.name} without {path.name}" for path in wanted if not path.is_file()]
    return found


def try_moment(
    trial: Trial, command: str, reference: Reference, rng: random.Random
) -> tuple[str, str, list[str]]:
    """Strike once, look, mend, call again, look: the moment, exit codes, and faults."""
    trial.empty()
    words, out, same = COMMANDS[command]
    if rng.random() < 0.5:
        at_s = rng.uniform(0.0, 1.1 * reference.seconds)
        when, outcome = f"at {at_s:.2f} s", trial.run(words, at_s=at_s)
    else:
        change = rng.randint(1, max(1, reference.changes))
        when, outcome = f"before change {change}", trial.run(words, at_change=change)
    wrong = outcome.faults()
    if outcome.code is None and (trial.fault != "kill" or outcome.seconds >= _LIMIT_S):
        wrong.append("it did not end by itself")
    if outcome.code == 2 and "error:" not in outcome.err:
        wrong.append("exit code 2 without a reason")
    wrong += check(command, trial.folder, reference)
    trial.mend()
    if trial.fault == "full" and list(trial.folder.glob(f"{PARTIAL_PREFIX}*")):
        wrong.append("a half-written folder is left")
    places = [path for path in trial.folder.glob(f"{out}*") if path.is_dir()]
    there = any(reference.files <= visible(place) for place in places)
    if command == "train" and (trial.folder / "w" / "config.toml").is_file():
        words = ("train", "--resume", "w")
    again = trial.run(words)
    wrong += [f"the next call: {fault}" for fault in again.faults()]
    wrong += [f"after the next call: {fault}" for fault in check(command, trial.folder, reference)]
    if list(trial.folder.glob(f"{PARTIAL_PREFIX}*")) and again.code != 2:
        wrong.append("what was half-written is still there after the next call")
    if again.code == 2 and not there:
        wrong.append(f"the next call does not go on: {again.err.strip()[-200:]}")
    if again.code not in (0, 1, 2):
        wrong.append(f"the next call ended with {again.code}")
    result = trial.folder / out / same
    if same and result.is_file() and result.read_bytes() != reference.same:
        wrong.append(f"{same} is another than that of a run left alone")
    if wrong:
        wrong.append(f"stderr: {outcome.err.strip()[-1200:]}")
        wrong.append(f"stderr of the next call: {again.err.strip()[-600:]}")
    return when, f"{'killed' if outcome.code is None else outcome.code} then {again.code}", wrong


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


def main(words: list[str], folder: Path) -> Findings:
    """Interrupt."""
    options = options_of(
        __doc__ or "", words, moments=50, seed=0, commands=tuple(COMMANDS), faults=FAULTS
    )
    load(corpus.WARM)
    found = Findings()
    for fault in options.faults:
        if fault == "full" and os.getuid() != 0:
            print("full: left out, as a small tmpfs needs root")
            continue
        for command in options.commands:
            rng = random.Random(f"{options.seed} {fault} {command}")
            found.ends.clear()
            with disk(folder / fault / command, fault) as work:
                trial = Trial(work, fault)
                reference = trial.left_alone(command)
                for number in range(options.moments):
                    when, codes, wrong = try_moment(trial, command, reference, rng)
                    found.ends[codes] += 1
                    if wrong:
                        name = f"{fault} {command} {number} {when}: {codes}"
                        found.add(name, "\n    ".join(wrong), "")
            alone = f"{reference.seconds:.1f} s and {reference.changes} changes alone"
            found.show(f"{fault} {command} ({alone})")
    return found
