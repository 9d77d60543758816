"""Measure how quickly the command line starts: CPU seconds of whole processes.

Run ``python -m benchmarks.start``, with ``--base COMMIT`` to measure that commit too, in turns with
the working tree, with ``--wheel FILE`` for a wheel of ``make wheel``, and with ``--json FILE`` to
keep the table. Cases may be selected by name; without ``first`` and ``gaze`` no kernels are
compiled, which takes a minute for each version of the sources. The byte code is compiled
beforehand.

Counted are user and system time of a process and all that it started, as `os.wait4` returns them.
A process may start others and not wait for them, as the first gaze did at first, to compile its
kernels in two processes. On Linux this program therefore becomes the reaper of orphaned descendants
and waits until there are none: each process is waited for once, by its parent, who passes on its
time, or here.
"""

import argparse
import compileall
import ctypes
import io
import json
import os
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Final

from rich.console import Console
from rich.table import Table

ROOT: Final = Path(__file__).resolve().parent.parent
CASES: Final[Mapping[str, tuple[str, ...]]] = {
    "first": ("-m", "vergence", "gaze"),
    "gaze": ("-m", "vergence", "gaze"),
    "help": ("-m", "vergence", "--help"),
    "info": ("-m", "vergence", "info"),
    "import": ("-c", "import vergence"),
    "numpy": ("-c", "import numpy"),
}
"""Python's words for each case; ``first`` is a gaze with no kernels compiled."""
_PR_SET_CHILD_SUBREAPER: Final = 36
"""Option of prctl(2) that makes orphaned descendants children of the caller (physical: Linux)."""


def adopt_orphans() -> None:
    """Become the parent of all descendants whose own parent ends first."""
    if sys.platform != "linux":
        raise SystemExit("expected Linux, whose prctl(2) is needed to count orphaned processes")
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_CHILD_SUBREAPER) failed")


def cpu_seconds(words: Sequence[str], env: Mapping[str, str] | None = None) -> float:
    """Run Python and return the CPU time of it and its descendants, user and system, s.

    Called after `adopt_orphans`, in a process without other children.

    Args:
        words: Python's arguments.
        env: environment; None for this process's own.
    """
    used_s = 0.0
    with tempfile.TemporaryDirectory() as folder, (Path(folder) / "stderr").open("w+b") as errors:
        started = subprocess.Popen(
            [sys.executable, *words], env=env, cwd=folder, stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=errors,
        )  # fmt: skip
        while True:
            try:
                pid, status, usage = os.wait4(-1, 0)
            except ChildProcessError:
                break
            used_s += usage.ru_utime + usage.ru_stime
            if pid == started.pid:
                started.returncode = os.waitstatus_to_exitcode(status)
        if started.returncode != 0:
            errors.seek(0)
            said = errors.read().decode(errors="replace")
            raise SystemExit(f"python {' '.join(words)} failed:\n{said}")
    return used_s


@dataclass
class Version:
    """A version of the sources, and the times of its cases.

    Args:
        name: name in the table.
        sources: folder that contains the package.
        kernels: empty folder for its compiled kernels.
    """

    name: str
    sources: Path
    kernels: Path
    used_s: dict[str, list[float]] = field(default_factory=dict)
    """CPU times of each case, one a round, s."""

    def measure(self, case: str) -> None:
        """Run a case once more."""
        env = {"PYTHONPATH": str(self.sources), "NUMBA_CACHE_DIR": str(self.kernels)}
        used = cpu_seconds(CASES[case], os.environ | env)
        self.used_s.setdefault(case, []).append(used)

    def prepare(self, cases: Sequence[str]) -> None:
        """Warm up: compile byte code, and kernels if a gaze is among the cases."""
        compileall.compile_dir(self.sources / "vergence", quiet=2)
        if "first" in cases or "gaze" in cases:
            self.measure("first")
        for case in set(cases) - {"first", "gaze"}:
            cpu_seconds(CASES[case], os.environ | {"PYTHONPATH": str(self.sources)})


def extract(commit: str, folder: Path) -> None:
    """Write the package of a commit of this repository into a folder."""
    command = ["git", "-C", str(ROOT), "archive", commit, "vergence"]
    archive = subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as files:
        files.extractall(folder, filter="data")


def rows_of(cases: Sequence[str], versions: Sequence[Version]) -> list[dict[str, object]]:
    """Row of each case: median CPU seconds, and median ratios to the first version in a round."""
    rows: list[dict[str, object]] = []
    for case in cases:
        row: dict[str, object] = {"case": case}
        row |= {f"{one.name}_cpu_s": median(one.used_s[case]) for one in versions}
        for one in versions[1:]:
            pairs = zip(versions[0].used_s[case], one.used_s[case], strict=True)
            row[f"{one.name}_ratio"] = median(new / first for first, new in pairs)
        rows.append(row)
    return rows


def show(rows: Sequence[Mapping[str, object]]) -> None:
    """Print the table."""
    table = Table()
    for title in rows[0]:
        table.add_column(title, justify="left" if title == "case" else "right")
    for row in rows:
        table.add_row(*(f"{v:.3f}" if isinstance(v, float) else str(v) for v in row.values()))
    Console().print(table)


def main(arguments: list[str] | None = None) -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}; or all")
    parser.add_argument("--base", metavar="COMMIT", help="commit to compare with")
    parser.add_argument("--wheel", metavar="FILE", help="wheel to compare with")
    parser.add_argument("--rounds", type=int, default=5, help="rounds; the first gaze has only one")
    parser.add_argument("--json", type=Path, metavar="FILE", help="file to write the table to")
    options = parser.parse_args(arguments)
    cases = options.cases or list(CASES)
    if unknown := set(cases) - set(CASES):
        parser.error(f"expected cases of {', '.join(CASES)}, got {', '.join(sorted(unknown))}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        versions = [Version("now", ROOT, folder / "kernels")]
        if options.base is not None:
            extract(options.base, folder / "base")
            versions.insert(0, Version("base", folder / "base", folder / "base-kernels"))
        if options.wheel is not None:
            with zipfile.ZipFile(options.wheel) as files:
                files.extractall(folder / "wheel")
            versions.append(Version("wheel", folder / "wheel", folder / "wheel-kernels"))
        adopt_orphans()
        for version in versions:
            version.prepare(cases)
        for number in range(max(options.rounds, 1)):
            for case in cases:
                if case != "first":
                    for version in versions if number % 2 == 0 else reversed(versions):
                        version.measure(case)
        rows = rows_of(cases, versions)
    show(rows)
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
