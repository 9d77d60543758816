"""Settle heads whose commands act late: as late as their model says, later, at high control rates.

Run ``python -m benchmarks.latencies --trials 100``. The trials are those of scenario `workspace` on
the preset `simulated`, with the latency of commands that the head's file says and the true one, and
with servos that overshoot.
"""

import argparse
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table

from vergence.controllers import make_controller
from vergence.envs.plants.conditions import Variation
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import load_scenario

CASES = (
    (120.0, 0.15, 0.17, 0.0), (120.0, 0.2, 0.24, 0.0), (120.0, 0.2, 0.2, 0.0),
    (250.0, 0.2, 0.2, 0.0), (500.0, 0.2, 0.2, 0.0), (1000.0, 0.2, 0.2, 0.0),
    (120.0, 0.0, 0.1, 0.2), (500.0, 0.0, 0.1, 0.2), (1000.0, 0.0, 0.1, 0.2),
)  # fmt: skip
"""Control rate, Hz; command latency in the file and in truth, s; overshoot."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--laws", nargs="+", default=["saccade", "state-feedback", "pursuit"])
    options = parser.parse_args()
    columns = ("Hz", "file (s)", "truth (s)", "overshoot", "law", "settled (%)", "swing", "ms")
    table = Table(*columns, title=f"{options.trials} trials of workspace, settled within 1 px")
    for rate_hz, known_s, true_s, overshoot in CASES:
        scenario = load_scenario("workspace")
        variation = Variation(command_latency_s=(true_s, true_s), overshoot=(overshoot, overshoot))
        scenario = replace(scenario, variation=variation)
        head = scenario.model().replace(
            timing={"control_rate_hz": rate_hz, "command_latency_s": known_s}
        )
        for law in options.laws:
            trials = run_trials(
                make_controller(law, head), scenario, episodes=options.trials, head=head
            )
            settle_s = trials.settle_or_trial_s(1.0)
            table.add_row(
                f"{rate_hz:g}", f"{known_s:g}", f"{true_s:g}", f"{overshoot:g}", law,
                f"{100.0 * np.isfinite(trials.settle_s(1.0)).mean():.1f}",
                str(int(trials.swings.sum())), f"{1000.0 * np.median(settle_s):.0f}",
            )  # fmt: skip
    Console().print(table)


if __name__ == "__main__":
    main()
