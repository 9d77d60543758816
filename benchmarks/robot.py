"""How many commands are late at 120 Hz, beside a bare timer's, with and without priority.

Run ``python -m benchmarks.robot``. It starts `vergence emulate` with the head `turrets` at 120 Hz,
and lets a law look at targets while its own thread paces the loop. A control period is late where
its tick has passed by a whole period, and is missed then. Before and after, a loop that only sleeps
until its next tick is counted alike, beside the same emulated head. Then all again with a real-time
priority, as `chrt -f 50 vergence deploy ...` has it, where the system lets it be had. Four minutes.
"""

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.wire import emulated
from vergence.controllers.controller import make_controller
from vergence.envs.rollout import run_trial
from vergence.envs.task import GazeTask
from vergence.hardware.config import HardwareConfig
from vergence.hardware.plant import HardwarePlant
from vergence.models.files.head_file import load_head, save_head

RATE_HZ = 120.0
LAW = "state-feedback"
PRIORITY = 50
GAZE_S = 3.0


def bare(seconds: float) -> tuple[int, int]:
    """Periods missed by a loop that only sleeps, and all of them."""
    period_s, begun_s = 1.0 / RATE_HZ, time.monotonic()
    missed, tick = 0, 0
    while tick < seconds * RATE_HZ:
        tick += 1
        due_s = begun_s + tick * period_s
        time.sleep(max(due_s - time.monotonic(), 0.0))
        late = int((time.monotonic() - due_s) // period_s)
        if late > 0:
            missed, tick = missed + late, tick + late
    return missed, tick


def gazes(config: HardwareConfig, seconds: float) -> tuple[int, int]:
    """Periods missed by a law on the head, and all of them."""
    options = {"config": config}
    target = {"kind": "random", "start": "rest"}
    task = GazeTask(1, head=config.head, plant="hardware", target=target, plant_options=options)
    plant, policy = task.plant, make_controller(LAW, config.head)
    assert isinstance(plant, HardwarePlant)
    passed = 0
    try:
        task.prepare(policy)
        for number in range(round(seconds / GAZE_S)):
            before = plant.overruns
            steps = round(GAZE_S * RATE_HZ)
            run_trial(task, policy, steps, lambda step: None, first_trial=number)
            passed += steps + plant.overruns - before
        return plant.overruns, passed
    finally:
        task.close()


def measure(config: HardwareConfig, seconds: float) -> list[dict[str, Any]]:
    """A row for the bare timer and one for the law."""
    halves = [bare(0.5 * seconds)]
    law = gazes(config, seconds)
    halves.append(bare(0.5 * seconds))
    timer = tuple(np.sum(halves, axis=0).tolist())
    return [
        {"loop": name, "periods": periods, "late": late, "late_fraction": late / periods}
        for name, (late, periods) in (("bare timer", timer), (LAW, law))
    ]


def main() -> None:
    """Measure, and print a row a loop."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--csv", type=Path)
    chosen = parser.parse_args()
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "fast.toml"
        save_head(load_head("turrets").replace(timing={"control_rate_hz": RATE_HZ}), file)
        with emulated("--head", str(file)) as config:
            rows += [{"priority": "none", **row} for row in measure(config, chosen.seconds)]
            try:
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
            except (OSError, AttributeError) as error:
                print(f"no real-time priority here: {error}", file=sys.stderr)
            else:
                found = measure(config, chosen.seconds)
                rows += [{"priority": "real-time", **row} for row in found]
    table = pd.DataFrame(rows)
    if chosen.csv is not None:
        table.to_csv(chosen.csv, index=False, float_format="%.4g")
    print(table.to_string(index=False, float_format=lambda value: f"{value:.4%}"))


if __name__ == "__main__":
    main()
