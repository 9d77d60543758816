"""Measure the lateness of commands at 120 Hz (`--rate`), with and without real-time priority.

Run ``python -m benchmarks.robot``, with ``--csv docs/results/robot.csv`` to keep the table. It
starts `vergence emulate` with the head `turrets` at 120 Hz, and deploys a law on it with a log, as
on a robot. The configuration has no `emulator` section, since the loop would then also wait for
the ground truth. A command's lateness counts from the tick at which it was due, and includes the
reading of the servos and the policy. A control period is late, and counts as missed, if its tick
has passed by a whole period. A loop that only sleeps from tick to tick is measured before and
after in the same way, as a bare timer. Then all is repeated with real-time priority, as with
`chrt -f 50 vergence deploy ...`, if the system allows it; the emulated head has none.
`stolen_fraction` is the fraction of processor time that the host of a virtual machine gave to
others meanwhile; if it is large, everything is late. It takes five minutes.
"""

import argparse
import os
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.wire import emulated
from vergence.eval.robot.config import DeployConfig
from vergence.eval.robot.deploy import deploy
from vergence.models.head_file import load_head, save_head
from vergence.models.parts import FloatArray
from vergence.models.toml_table import toml_text
from vergence.recording.log import LoggedTrial, read_log

LAW = "state-feedback"
PRIORITY = 50
GAZE_S = 3.0


def bare(seconds: float, period_s: float) -> tuple[int, int, list[float]]:
    """Missed periods and all periods of a loop that only sleeps, and its wake-up latencies, s."""
    begun_s = time.monotonic()
    missed, tick, lateness = 0, 0, []
    while tick * period_s < seconds:
        tick += 1
        due_s = begun_s + tick * period_s
        time.sleep(max(due_s - time.monotonic(), 0.0))
        lateness.append(time.monotonic() - due_s)
        late = max(int(lateness[-1] // period_s), 0)
        missed, tick = missed + late, tick + late
    return missed, tick, lateness


def lateness_of(trial: LoggedTrial, period_s: float) -> list[float]:
    """Times from the ticks at which a trial's commands were due to their sending, s."""
    ticks_s = trial.begun_s + trial.readings.time_s[:-1, 0]
    sent_s = [one.clock_s for one in trial.commands[1 : trial.steps]]
    return [*(np.array(sent_s) - (ticks_s[:-1] + period_s))]


def gazes(robot: Path, seconds: float, period_s: float) -> tuple[int, int, list[float]]:
    """Missed periods and all periods of a law on the head, and lateness of its commands, s."""
    wanted = DeployConfig(
        controller=LAW,
        hardware=robot,
        gazes=round(seconds / GAZE_S),
        duration_s=GAZE_S,
    )
    with tempfile.TemporaryDirectory() as folder:
        found = deploy(wanted, Path(folder) / "log.mcap")
        if found.error is not None:
            raise found.error
        trials = read_log(found.log).trials
    lateness = [one for trial in trials for one in lateness_of(trial, period_s)]
    return found.gazes.missed_periods, found.gazes.periods, lateness


def stolen_by_now() -> FloatArray:
    """(2,) time stolen by the host from a processor of this machine so far, and the time now, s."""
    steal = int(Path("/proc/stat").read_text().split(maxsplit=9)[8])
    taken_s = steal / os.sysconf("SC_CLK_TCK") / (os.cpu_count() or 1)
    return np.array([taken_s, time.monotonic()])


def row(
    name: str, missed: int, periods: int, lateness: list[float], stolen: FloatArray
) -> dict[str, Any]:
    """Row of the table: statistics of a loop's periods."""
    median, most = np.quantile(lateness, [0.5, 0.99])
    return {
        "loop": name,
        "periods": periods,
        "late": missed,
        "late_fraction": missed / periods,
        "median_ms": 1e3 * median,
        "99_percent_ms": 1e3 * most,
        "most_ms": 1e3 * max(lateness),
        "stolen_fraction": stolen[0] / stolen[1],
    }


def measure(robot: Path, seconds: float, period_s: float) -> list[dict[str, Any]]:
    """Rows of the bare timer and of the law."""
    marks = [stolen_by_now()]
    before = bare(0.5 * seconds, period_s)
    marks.append(stolen_by_now())
    law = gazes(robot, seconds, period_s)
    marks.append(stolen_by_now())
    after = bare(0.5 * seconds, period_s)
    marks.append(stolen_by_now())
    timer = before[0] + after[0], before[1] + after[1], before[2] + after[2]
    first, second, third = np.diff(marks, axis=0)
    return [row("bare timer", *timer, first + third), row(LAW, *law, second)]


def main() -> None:
    """Measure, and print a row for each loop."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=120.0, help="control rate, Hz")
    parser.add_argument("--csv", type=Path)
    chosen = parser.parse_args()
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "fast.toml"
        save_head(load_head("turrets").replace(timing={"control_rate_hz": chosen.rate}), file)
        with emulated("--head", str(file)) as config:
            plain = tomllib.loads(config.text)
            del plain["emulator"]
            robot = Path(folder) / "robot.toml"
            robot.write_text(toml_text(plain))
            rows += [
                {"priority": "none", **one}
                for one in measure(robot, chosen.seconds, 1.0 / chosen.rate)
            ]
            try:
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
            except (OSError, AttributeError) as error:
                print(f"no real-time priority here: {error}", file=sys.stderr)
            else:
                found = measure(robot, chosen.seconds, 1.0 / chosen.rate)
                rows += [{"priority": "real-time", **one} for one in found]
    table = pd.DataFrame(rows)
    if chosen.csv is not None:
        table.to_csv(chosen.csv, index=False, float_format="%.4g")
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
