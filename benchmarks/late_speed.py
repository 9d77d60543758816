"""How laws hold a target at rest where the servos' speeds are read late.

Run ``python benchmarks/late_speed.py``, with ``--csv docs/results/late_speed.csv`` to keep the
table. Smart servos filter the speed that they report, and drivers take differences of angles: the
speed is then older than the angle. A row is a head, a reading and a law: the share of the trials of
`hardware` that settle to 2 px, and the mean, over trials and actuators, of how far commands swing
in the last half second, peak to peak. See ``docs/controllers.md``.
"""

import argparse
from collections import deque
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table

from vergence import load_head
from vergence.controllers.controller import make_controller
from vergence.envs.plants.kinematic import KinematicPlant
from vergence.envs.reading import Reading
from vergence.envs.streams import IntArray
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import load_scenario

LAWS = ("delay-compensated", "state-feedback", "saccade", "pursuit")
HEADS = ("turrets", "physical")
HELD_S = 0.5
BAND_PX = 2.0


class Filtered40(KinematicPlant):
    """Speeds that a low-pass filter of first order has smoothed."""

    filter_s: ClassVar[float] = 0.04

    def reset(self, ids: IntArray, positions: Any) -> Reading:
        """See `Plant.reset`."""
        return self._late(super().reset(ids, positions), begun=True)

    def begin(self, start: Any) -> Reading:
        """See `Simulation.begin`."""
        return self._late(super().begin(start), begun=True)

    def step(self, command: Any) -> Reading:
        """See `Plant.step`."""
        return self._late(super().step(command))

    def _late(self, reading: Reading, begun: bool = False) -> Reading:
        if begun:
            self._speeds = reading.velocities.copy()
        share = -np.expm1(-self.head.timing.period_s / self.filter_s)
        self._speeds += share * (reading.velocities - self._speeds)
        reading.velocities[:] = self._speeds
        return reading


class Filtered80(Filtered40):
    """The same with twice the time constant."""

    filter_s = 0.08


class Difference2(Filtered40):
    """Differences of angles over two control periods."""

    periods: ClassVar[int] = 2

    def _late(self, reading: Reading, begun: bool = False) -> Reading:
        if begun:
            self._angles = deque([reading.positions.copy()], maxlen=self.periods + 1)
            return reading
        self._angles.append(reading.positions.copy())
        span_s = (len(self._angles) - 1) * self.head.timing.period_s
        reading.velocities[:] = (self._angles[-1] - self._angles[0]) / span_s
        return reading


class Difference4(Difference2):
    """Over four."""

    periods = 4


READINGS = {
    "as the angle": KinematicPlant,
    "filtered 40 ms": Filtered40,
    "filtered 80 ms": Filtered80,
    "over 2 periods": Difference2,
    "over 4 periods": Difference4,
}


def held(law: str, head: str, plant: type[KinematicPlant], episodes: int) -> dict[str, float]:
    """How one law holds the targets of one head."""
    scenario = load_scenario("hardware")
    controller = make_controller(law, head=load_head(head))
    name = f"{plant.__module__}:{plant.__name__}"
    trials = run_trials(controller, scenario, episodes=episodes, head=head, plant=name)
    count = trials.head.actuation.count
    last = trials.command[-round(HELD_S / trials.head.timing.period_s) :]
    return {
        "settled": float(np.isfinite(trials.settle_s(BAND_PX)).mean()),
        "swing_deg_s": float(np.rad2deg(np.ptp(last, axis=0)[:, :count].mean())),
    }


def main(arguments: list[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--csv", type=Path, help="where to keep the table")
    parser.add_argument("--trials", type=int, default=300)
    options = parser.parse_args(arguments)
    rows = [
        {"head": head, "reading": reading, "law": law, **held(law, head, plant, options.trials)}
        for head in HEADS
        for reading, plant in READINGS.items()
        for law in LAWS
    ]
    table = Table(
        title=f"{options.trials} trials of hardware: settled to {BAND_PX:g} px, swing in deg/s",
        title_justify="left",
    )
    for column in ("head", "speed reading", *LAWS):
        table.add_column(column)
    for (head, reading), group in pd.DataFrame(rows).groupby(["head", "reading"], sort=False):
        cells = [f"{row.settled:.0%}, {row.swing_deg_s:.1f}" for row in group.itertuples()]
        table.add_row(str(head), str(reading), *cells)
    Console().print(table)
    if options.csv is not None:
        pd.DataFrame(rows).to_csv(options.csv, index=False, float_format="%.6g")


if __name__ == "__main__":
    main()
