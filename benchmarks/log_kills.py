"""Measure the loss at the end of a robot's log after SIGKILL, and check that the log replays.

Run ``python benchmarks/log_kills.py``. It starts `vergence emulate`, deploys a law on it several
times, kills each deployment at a random moment, in a gaze or on the way to the next, and reads its
log. The lost time is counted from the last logged measurement of the joints to the kill, on the
monotonic clock that both processes share. It takes some ten minutes.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.progress import track

from benchmarks.wire import emulated
from vergence.eval.robot.config import ReplayConfig
from vergence.eval.robot.replay import replay

LAW = "state-feedback"


def killed(config: str, log: Path, after_s: float) -> float:
    """Kill a deployment some time after its first gaze begins; return the time (monotonic), s."""
    command = [sys.executable, "-m", "vergence", "deploy", LAW, "--config", config]
    command += ["--log", str(log), "--gazes", "100", "--duration", "1"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        line, said = "", ""
        while not line.startswith("gaze "):
            line = process.stderr.readline()
            said = line or said
            if not line:
                raise SystemExit(f"vergence deploy has ended: {said}")
        time.sleep(after_s)
        now_s = time.monotonic()
        os.kill(process.pid, signal.SIGKILL)
    return now_s


def main() -> None:
    """Measure, and print the largest loss."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--moments", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    rng = np.random.default_rng(chosen.seed)
    missing_s, commands, identical = [], 0, 0
    with tempfile.TemporaryDirectory() as folder, emulated() as config:
        for number in track(range(chosen.moments), "log_kills"):
            log = Path(folder) / f"{number}.mcap"
            now_s = killed(config.path, log, rng.uniform(0.0, 2.5))
            found = replay(ReplayConfig(log=log, controller=LAW))
            missing_s.append(now_s - found.log.joints[-1].clock_s)
            assert found.log.truncation_reason
            assert found.rerun is not None
            commands += found.rerun.summary()["commands"]
            identical += found.rerun.summary()["identical"]
    print(
        f"{chosen.moments} kills: at most {1e3 * max(missing_s):.0f} ms missing, "
        f"{1e3 * float(np.median(missing_s)):.0f} ms in the median; {identical} of {commands} "
        "commands the same again"
    )


if __name__ == "__main__":
    main()
