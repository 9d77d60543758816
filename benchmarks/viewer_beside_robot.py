"""Measure what a viewer costs a running robot: late periods of a deployment, with and without it.

Run ``python -m benchmarks.viewer_beside_robot``. Deployments of some gazes on one emulated head
follow each other in turns: alone; with `vergence view --follow` and a process that reads as a
browser does; with such a viewer that hangs (SIGSTOP) midway; with one that is killed midway.
"""

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.viewer import Reader

VERGENCE = (sys.executable, "-m", "vergence")
TURNS = {"alone": None, "viewer": signal.SIGCONT, "viewer hangs": signal.SIGSTOP,
         "viewer is killed": signal.SIGKILL}  # fmt: skip
"""Signal that the viewer gets in the middle of a turn; None for no viewer."""


def viewer(folder: Path) -> "tuple[subprocess.Popen[str], Reader]":
    """Begin a viewer of a folder's newest log, and a browser's reading of it."""
    command = [*VERGENCE, "view", str(folder), "--follow", "--no-browser", "--port", "0"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    line = process.stderr.readline()
    return process, Reader(line.split()[3])


def deploy(config: Path, log: Path, gazes: int) -> "subprocess.Popen[str]":
    """Begin a deployment."""
    command = [*VERGENCE, "deploy", "state-feedback", "--config", str(config), "--gazes",
               str(gazes), "--images", "--json", "--log", str(log)]  # fmt: skip
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)


def main() -> None:
    """Run the turns and print the late periods of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--gazes", type=int, default=5)
    options = parser.parse_args()
    found: dict[str, list[str]] = {name: [] for name in TURNS}
    late: dict[str, list[float]] = {name: [] for name in TURNS}
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "desk.toml"
        emulator = subprocess.Popen([*VERGENCE, "emulate", "--out", str(config)])
        while not config.exists():
            time.sleep(0.2)
        for number in range(options.rounds):
            for name, disturbed in TURNS.items():
                own = Path(folder) / f"{number}-{name.replace(' ', '-')}"
                own.mkdir()
                beside = None if disturbed is None else viewer(own)
                running = deploy(config, own / "run.mcap", options.gazes)
                time.sleep(8.0)  # into the first gazes
                if beside is not None and disturbed is not None:
                    beside[0].send_signal(disturbed)
                result = json.loads(running.communicate()[0])
                if beside is not None:
                    beside[0].kill()
                    beside[0].communicate()
                    beside[1].kill()
                late[name].append(100.0 * (result["overrun_fraction"] or 0.0))
                found[name].append(f"{result['gazes']} gazes, {len(result['faults'])} faults")
                print(f"round {number + 1}, {name:17s} {late[name][-1]:6.2f} % of periods late, "
                      f"{found[name][-1]}", flush=True)  # fmt: skip
        emulator.kill()
        emulator.wait()
    for name, values in late.items():
        print(f"{name:17s} late periods {np.min(values):.2f} to {np.max(values):.2f} %")


if __name__ == "__main__":
    main()
