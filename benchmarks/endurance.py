"""Measure leaks of memory, file descriptors and threads in an hour of gazes on an emulated head.

Run ``python benchmarks/endurance.py --minutes 60``. Gazes follow each other on one connection; the
head is closed and reopened every ten gazes. A stop of the head is printed, released and counted;
one cause is a machine that does not let the emulator run for 0.1 s. Each minute a line states the
resources that the process holds; the last line compares the last quarter with the second one.
"""

import argparse
import os
import threading
import time
from pathlib import Path

import numpy as np
import psutil

from benchmarks.wire import emulated
from vergence.controllers.controller import make_controller
from vergence.envs.task import GazeTask, Policy
from vergence.errors import HardwareError

GAZE_S = 2.0
REOPENED = 10
ONE = np.zeros(1, np.int64)


def gaze(task: GazeTask, policy: Policy, number: int, reopen: bool) -> bool:
    """Run one gaze at a random target; True if it ended within 2 px."""
    if reopen:
        task.close()
        task.prepare(policy)
    task.begin(ONE, np.zeros(1, np.uint64), np.full(1, number, np.uint64))
    state, start = None, np.ones(1, np.bool_)
    while task.reading.time_s[0] < GAZE_S:
        action, state = policy.predict(task.observation.copy(), state, start)
        start = np.zeros(1, np.bool_)
        task.step(task.as_action(action))
        if task.plant.fault:
            raise HardwareError(task.plant.fault)
    truth = task.truth()
    assert truth is not None
    return bool(np.abs(truth.pixel_error).max() < 2.0)


def main() -> None:
    """Run gazes for some minutes and print the resources that are held."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--controller", default="state-feedback")
    options = parser.parse_args()
    process, begun_s, rows = psutil.Process(), time.monotonic(), []
    settled = gazes = faults = 0
    with emulated() as config:
        task = GazeTask(
            1, head=config.head, plant="hardware", target="random", plant_options={"config": config}
        )
        policy = make_controller(options.controller, head=config.head)
        try:
            while time.monotonic() - begun_s < 60.0 * options.minutes:
                gazes += 1
                try:
                    settled += gaze(task, policy, gazes, gazes % REOPENED == 1)
                except HardwareError as error:
                    print(f"gaze {gazes}: {error}", flush=True)
                    faults += 1
                    task.plant.release()
                if time.monotonic() - begun_s > 60.0 * (len(rows) + 1):
                    held = (
                        process.memory_info().rss / 2**20,
                        len(os.listdir("/proc/self/fd")) if Path("/proc/self/fd").exists() else 0,
                        threading.active_count(),
                    )
                    rows.append(held)
                    print(
                        f"{len(rows):3d} min: {gazes} gazes, {settled} settled, {faults} stopped, "
                        f"{held[0]:.1f} MiB, {held[1]} descriptors, {held[2]} threads",
                        flush=True,
                    )
        finally:
            task.close()
    quarter = max(len(rows) // 4, 1)
    early, late = np.mean(rows[quarter : 2 * quarter], axis=0), np.mean(rows[-quarter:], axis=0)
    names = ("MiB", "descriptors", "threads")
    told = zip(names, early, late, strict=True)
    print("; ".join(f"{name}: {a:.1f} then {b:.1f}" for name, a, b in told))


if __name__ == "__main__":
    main()
