"""Measure whether laws come to rest on joints with friction: an emulated robot, simulated time.

Run ``python -m benchmarks.friction`` from the project's root. Each trial has a target at rest, at
a drawn place before the head `turrets`. Its servos have friction and gravity, as fractions of their
greatest torque; static friction is 1.6 times that of motion. Columns, for each law: share of the
trials in which both eyes settle to 1 px within 4 s and stay there for 5 s; medians of the settle
time of these and of the error in the last 5 s of all; and how often a trial leaves 1 px in them.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.hardware.virtual import VirtualRobot, WatchedWorld, virtual_config
from vergence import load_head
from vergence.controllers.controller import make_controller
from vergence.envs.task import GazeTask, run_trial
from vergence.hardware.emulator.config import EmulatorConfig

LAWS: Final = ("state-feedback", "saccade")
SETTLE_S: Final = 4.0
"""Time within which a trial has to settle, s (chosen)."""
STAY_S: Final = 5.0
"""Time for which it has to stay settled, s (chosen)."""
BAND_PX: Final = 1.0
"""Error below which both eyes count as settled, px (chosen)."""
NOISE_PX: Final = 0.1
"""Detection noise, standard deviation, px (chosen: of a webcam)."""


def errors_px(law: str, motors: EmulatorConfig, seed: int, head_name: str) -> NDArray[np.float64]:
    """Error of the worse eye after each control period of a trial, px."""
    head = load_head(head_name)
    low, high = (-0.3, -0.25, 0.5), (0.3, 0.2, 1.5)
    point = np.random.default_rng(seed).uniform(low, high)
    latency_s = head.timing.latency_s
    errors = []
    with pytest.MonkeyPatch.context() as patch:
        world = WatchedWorld(head, point, motors, latency_s=latency_s, noise_px=NOISE_PX, seed=seed)
        robot = VirtualRobot(patch, world=world, config=virtual_config(head, latency_s))
        task = GazeTask(
            1,
            head=head,
            plant="hardware",
            target={"kind": "static", "point": (0.0, 0.0, 1.0)},
            plant_options={"config": robot.config, **robot.options, "view_check": False},
        )

        def record(_: int) -> None:
            pixels = np.array(world.state(robot.clock())["pixels"])
            off = head.undistort(pixels) - head.cameras.principal
            errors.append(np.linalg.norm(off, axis=-1).max())

        try:
            controller = make_controller(law, head, task.layout)
            steps = round((SETTLE_S + STAY_S) * head.timing.control_rate_hz)
            run_trial(task, controller, steps, record, seed=seed)
        finally:
            task.close()
    return np.array(errors)


@dataclass(frozen=True)
class Row:
    """One law's trials."""

    kept: float
    settle_s: float
    error_px: float
    exits: float


def measure(law: str, motors: EmulatorConfig, seeds: Sequence[int], head: str = "turrets") -> Row:
    """Run the trials of a law."""
    rate = load_head(head).timing.control_rate_hz
    settled, rest, exits = [], [], []
    for seed in seeds:
        error = errors_px(law, motors, seed, head)
        last = int(np.flatnonzero(error > BAND_PX)[-1])
        settled.append((last + 1) / rate)
        late = error[-round(STAY_S * rate) :]
        rest.append(np.median(late))
        exits.append(np.count_nonzero(np.diff((late > BAND_PX).astype(int)) > 0))
    times = np.array(settled)
    kept = times <= SETTLE_S
    return Row(
        kept=float(kept.mean()),
        settle_s=float(np.median(times[kept])) if kept.any() else np.nan,
        error_px=float(np.median(rest)),
        exits=float(np.mean(exits)),
    )


def main(arguments: list[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--friction", type=float, nargs="+", default=[0.0, 0.02, 0.05, 0.08])
    parser.add_argument("--gravity", type=float, default=0.0, help="fraction of the torque")
    parser.add_argument("--lag", type=float, help="time constant of the servos, s; the head's")
    parser.add_argument("--law", nargs="+", default=list(LAWS))
    parser.add_argument("--head", default="turrets")
    parser.add_argument("--trials", type=int, default=40, help="trials of each law")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first trial")
    options = parser.parse_args(arguments)
    seeds = range(options.seed, options.seed + options.trials)
    print(f"{'law':16}friction  settled  settle_s  error_px  exits")
    for friction in options.friction:
        motors = EmulatorConfig(friction=friction, gravity=options.gravity, lag_s=options.lag)
        for law in options.law:
            started_s = time.perf_counter()
            row = measure(law, motors, seeds, options.head)
            print(
                f"{law:16}{friction:8.2f}  {row.kept:6.1%}  {row.settle_s:8.2f}"
                f"  {row.error_px:8.2f}  {row.exits:5.2f}"
                f"  ({time.perf_counter() - started_s:.0f} s)",
                flush=True,
            )


if __name__ == "__main__":
    main()
