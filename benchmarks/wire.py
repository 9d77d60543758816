"""Compare the settling of laws on an emulated head and in a simulation with the same delays.

Run ``python benchmarks/wire.py``, with ``--csv docs/results/wire.csv`` to keep the table. It starts
`vergence emulate`: servos on a pseudo-terminal and two camera streams ("the wire"), in separate
processes. Each law runs on the same random targets from the same random starts there and on the
plant `rendered`, whose frames have the phase, latency and jitter measured on the wire. Settling
means a true error within 2 px. See ``docs/robot.md``.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from rich.console import Console
from rich.progress import track
from rich.table import Table

from vergence.controllers.controller import make_controller
from vergence.envs.task import GazeTask, Policy
from vergence.eval.trials.metrics import settle_time
from vergence.hardware.config import HardwareConfig, load_hardware
from vergence.hardware.emulator.client import WorldClient
from vergence.hardware.plant import HardwarePlant
from vergence.triangulation import Fix

LAWS = ("ibvs", "state-feedback", "saccade", "pursuit")
CAMERAS = {"together": "", "half a frame apart": "--right-late 0.0167"}
"""Options for `vergence emulate`, by the exposure times of the cameras."""
BAND_PX = 2.0
SEED = 7
KILLED_RAD_S = 3.0


class Loop(NamedTuple):
    """Timing of the frames of a trial on the wire."""

    phase: float
    """Phase of the exposures relative to the start of the trial, in frame periods, 0 to 1."""
    latency_s: float
    """Low quantile (5 %) of the time from exposure to the reading with the image, s."""
    jitter_s: float
    """Difference of the 95 % quantile from that, s."""


class Gaze(NamedTuple):
    """Result of one gaze."""

    settled_s: float
    points_within: bool
    """True if the points by gaze and from the images are both within three standard deviations of
    the truth in each axis."""
    error_px: float


@contextmanager
def emulated(*words: str) -> Iterator[HardwareConfig]:
    """Run an emulated head during the block; yields its configuration."""
    with tempfile.TemporaryDirectory() as folder:
        desk = Path(folder) / "desk.toml"
        command = [sys.executable, "-m", "vergence", "emulate", "--out", str(desk), *words]
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
            try:
                while not desk.exists():
                    if process.poll() is not None:
                        raise SystemExit("vergence emulate has ended")
                    time.sleep(0.1)
                yield load_hardware(desk)
            finally:
                process.terminate()


def look(
    task: GazeTask, policy: Policy, trial: int, duration_s: float
) -> tuple[Gaze, list[tuple[float, float]]]:
    """Run one gaze; also return the exposure and arrival time of each image, s."""
    one = np.zeros(1, dtype=np.int64)
    task.begin(one, np.full(1, SEED, np.uint64), np.full(1, trial, np.uint64))
    state, start = None, np.ones(1, dtype=np.bool_)
    times: list[float] = []
    errors: list[Any] = []
    images: list[tuple[float, float]] = []
    frame = 0
    while not times or times[-1] < duration_s:
        action, state = policy.predict(task.observation.copy(), state, start)
        start = np.zeros(1, dtype=np.bool_)
        task.step(task.as_action(action))
        truth, reading = task.truth(), task.reading
        assert truth is not None
        times.append(float(reading.time_s[0]))
        errors.append(truth.pixel_error[0].copy())
        if reading.frame[0] != frame:
            frame = int(reading.frame[0])
            images.append((float(reading.exposure_s[0]), float(reading.received_s[0])))
    gaze, views = task.fixes()
    assert truth is not None
    end = float(np.linalg.norm(errors[-1], axis=-1).max())
    settled = float(settle_time(times, errors, BAND_PX))
    inside = within(gaze, truth.target[0]) and within(views, truth.target[0])
    return Gaze(settled, inside, end), images


def within(fix: Fix, target: Any) -> bool:
    """True if a fix is within three standard deviations of the truth in each axis."""
    return bool((np.abs(fix.point[0] - target) < 3.0 * fix.sigma[0]).all())


def loop_of(plant: HardwarePlant, world: WorldClient, images: list[tuple[float, float]]) -> Loop:
    """Frame timing of the last trial, from the exposure times recorded by the emulator."""
    frame_s = plant.head.timing.frame_s
    exposed = np.array(world.ask({"exposures": None})["times"]) - plant.begun_s
    dated, came = np.array(images).T
    nearest = np.array([exposed[np.abs(exposed - one).argmin()] for one in dated])
    late = came - nearest
    least, most = np.quantile(late, [0.05, 0.95])
    phase = (nearest / frame_s) % 1.0
    angle = np.angle(np.exp(2j * np.pi * phase).mean())
    return Loop(float(angle / (2.0 * np.pi) % 1.0), float(least), float(most - least))


def measure(config: HardwareConfig, laws: list[str], gazes: int, duration_s: float) -> Any:
    """Table with a row for each gaze, on the wire and in simulation."""
    head = config.head
    policies = {name: make_controller(name, head=head) for name in laws}
    world = WorldClient(config.emulator_address)
    options = {"config": config}
    task = GazeTask(1, head=head, plant="hardware", target="random", plant_options=options)
    plant = task.plant
    assert isinstance(plant, HardwarePlant)
    rows: list[dict[str, Any]] = []
    loops: dict[tuple[str, int], Loop] = {}
    used, begun_s = time.process_time(), time.monotonic()
    try:
        for policy in policies.values():
            task.prepare(policy)
        jobs = [(name, trial) for name in laws for trial in range(gazes)]
        for name, trial in track(jobs, "on the wire", console=Console(stderr=True)):
            found, images = look(task, policies[name], trial, duration_s)
            loops[name, trial] = loop_of(plant, world, images)
            rows.append({"law": name, "where": "wire", "trial": trial, **found._asdict()})
        counts = plant.diagnostics()
    finally:
        task.close()
    share = (time.process_time() - used) / (time.monotonic() - begun_s)
    for name, trial in track(jobs, "in simulation", console=Console(stderr=True)):
        loop = loops[name, trial]
        sim = GazeTask(
            1,
            head=head,
            plant="rendered",
            target="random",
            plant_options={
                "frame_phase": loop.phase,
                "latency_s": loop.latency_s,
                "jitter_s": loop.jitter_s,
            },
        )
        found, _images = look(sim, policies[name], trial, duration_s)
        sim.close()
        rows.append({"law": name, "where": "simulation", "trial": trial, **found._asdict()})
    table = pd.DataFrame(rows)
    middle = Loop(*np.median(np.array(list(loops.values())), axis=0))
    print(
        f"latency {1e3 * middle.latency_s:.1f} ms, jitter {1e3 * middle.jitter_s:.1f} ms; "
        f"{100 * share:.0f} % of a core; "
        + ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items())
    )
    return table


def summary(table: Any) -> Any:
    """Table with a row for each law: settled gazes, medians, points within three sigma."""
    rows = []
    for name, group in table.groupby("law", sort=False):
        row: dict[str, Any] = {"law": name}
        for where, part in group.groupby("where", sort=False):
            settled = part.settled_s.fillna(np.inf)
            row[f"{where}_settled"] = int(np.isfinite(settled).sum())
            row[f"{where}_median_s"] = float(np.median(settled))
            row[f"{where}_points_within"] = int(part.points_within.sum())
        row["gazes"] = len(part)
        row["ratio"] = row["wire_median_s"] / row["simulation_median_s"]
        rows.append(row)
    return pd.DataFrame(rows)


def show(table: Any) -> None:
    """Print a table."""
    out = Table()
    for name in table.columns:
        out.add_column(
            name.replace("_", " "), justify="left" if name in ("law", "cameras") else "right"
        )
    for row in table.itertuples(index=False):
        out.add_row(*(f"{one:.3f}" if isinstance(one, float) else str(one) for one in row))
    Console(width=160).print(out)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("laws", nargs="*", default=list(LAWS))
    parser.add_argument("--gazes", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=2.5)
    parser.add_argument("--emulate", help="words for vergence emulate, in place of both cameras'")
    parser.add_argument("--csv", type=Path)
    options = parser.parse_args()
    settings = CAMERAS if options.emulate is None else {options.emulate: options.emulate}
    parts = []
    for name, words in settings.items():
        with emulated(*words.split()) as config:
            table = measure(config, options.laws, options.gazes, options.seconds)
        parts.append(summary(table))
        parts[-1].insert(0, "cameras", name)
        show(parts[-1])
    if options.csv:
        pd.concat(parts).to_csv(options.csv, index=False, float_format="%.6g")


if __name__ == "__main__":
    main()
