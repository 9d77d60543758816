"""How laws hold a target at rest where the servos' speeds are read late.

Run ``python benchmarks/late_speed.py``, with ``--csv docs/results/late_speed.csv`` to keep the
table. Smart servos filter the speed that they report, and drivers take differences of angles: the
speed is then older than the angle. A row is a head, a reading and a law: the share of the trials of
`hardware` that settle to 2 px, and the mean, over trials and actuators, of how far commands swing
in the last half second, peak to peak. See ``docs/controllers.md``.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table

from vergence import load_head
from vergence.controllers.controller import make_controller
from vergence.eval.margins.measure import moved
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import load_scenario

LAWS = ("delay-compensated", "state-feedback", "saccade", "pursuit")
HEADS = ("turrets", "physical")
HELD_S = 0.5
BAND_PX = 2.0


READINGS: dict[str, Callable[[float], tuple[str, float]]] = {
    "as the angle": lambda period_s: ("speed_filter_s", 0.0),
    "filtered 40 ms": lambda period_s: ("speed_filter_s", 0.04),
    "filtered 80 ms": lambda period_s: ("speed_filter_s", 0.08),
    "over 2 periods": lambda period_s: ("speed_span_s", 2.0 * period_s),
    "over 4 periods": lambda period_s: ("speed_span_s", 4.0 * period_s),
}
"""Which option of the loop has which value, by the control period."""


def held(law: str, head: str, reading: str, episodes: int) -> dict[str, float]:
    """How one law holds the targets of one head."""
    model = load_head(head)
    scenario = moved(load_scenario("hardware"), *READINGS[reading](model.timing.period_s))
    controller = make_controller(law, head=model)
    trials = run_trials(controller, scenario, episodes=episodes, head=head)
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
        {"head": head, "reading": reading, "law": law, **held(law, head, reading, options.trials)}
        for head in HEADS
        for reading in READINGS
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
