"""Measure oscillations of laws on a target at rest, with single and combined faults of the loop.

Run ``python benchmarks/calm.py``, with ``--csv docs/results/calm.csv`` to keep the table. A row is
a head, a fault and a law with its default options. It has trials of `hardware`, 8 s long and with
one additional fault, or trials of `desk`, which has all faults and its own head. Columns: fraction
of trials that settle to 2 px, number of trials that oscillate ("swing"), fraction that left the
2 px band again, and medians of the peak-to-peak speed of a joint in the last 5 s and of the ratio
of the settling time to its bound.

``--count``, with ``--csv docs/results/calm_count.csv``, counts the oscillating trials in all
scenarios with targets at rest, and in `hardware` with one quantity of the loop at an end of the
range in which margins are searched; these trials have the duration of their scenario. See
``docs/controllers.md``.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import track
from rich.table import Table

from vergence.controllers.controller import make_controller
from vergence.eval.margins.run import (
    IMPERFECTION_RANGES,
    has_effect,
    search_interval,
    with_imperfection,
)
from vergence.eval.trials.results import Trials
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import SCENARIOS, Scenario, load_scenario
from vergence.models.parts import LoopTiming

HEADS: Final = ("turrets", "physical", "icub")
RECOMMENDED: Final = ("state-feedback", "saccade", "pursuit")
LEARNED: Final = ("learned-gain", "learned-policy")
LAWS: Final = ("delay-compensated", *RECOMMENDED, *LEARNED)
WITH_NETWORKS: Final = ("turrets", "physical")
"""Heads with shipped networks."""
DESK: Final = "desk"
"""Name of the row and of the scenario with all faults together and its own head."""
DURATION_S: Final = 8.0
"""Duration of a trial, s (chosen: that of `desk`, so that the last 5 s are fixation)."""
BAND_PX: Final = 2.0
"""Error band in which a trial counts as settled, px (chosen: that of the docs' tables)."""
WORST: Final = 20
"""Most rows of the count that are printed (chosen: detail against length)."""
WIDTH: Final = 130
"""Width of the printed tables, characters (numerical)."""
Rows = list[dict[str, Any]]

FAULTS: Final[dict[str, Callable[[LoopTiming], dict[str, float]]]] = {
    "none": lambda timing: {},
    "filtered 40 ms": lambda timing: {"speed_filter_s": 0.04},
    "filtered 80 ms": lambda timing: {"speed_filter_s": 0.08},
    "speed 20 ms late": lambda timing: {"speed_latency_s": 0.02},
    "over 1 period": lambda timing: {"speed_span_s": timing.period_s},
    "over 2 periods": lambda timing: {"speed_span_s": 2.0 * timing.period_s},
    "over 4 periods": lambda timing: {"speed_span_s": 4.0 * timing.period_s},
    "overshoot 0.05": lambda timing: {"overshoot": 0.05},
    "overshoot 0.15": lambda timing: {"overshoot": 0.15},
    "overshoot 0.3": lambda timing: {"overshoot": 0.3},
    "lost 5 %": lambda timing: {"lost_command_probability": 0.05},
    "lost 15 %": lambda timing: {"lost_command_probability": 0.15},
    "stalls": lambda timing: {"stall_probability": 0.005, "stall_s": 0.1},
    "missed 40 %": lambda timing: {"missed_detection_probability": 0.4},
    "outliers 5 %": lambda timing: {"outlier_probability": 0.05},
    "false detections": lambda timing: {
        "false_detection_probability": 0.002,
        "false_detection_s": 0.2,
    },
    "skew": lambda timing: {"skew_s": 0.5 * timing.frame_s},
    "images 60 ms late": lambda timing: {"latency_s": timing.latency_s + 0.06},
    "play 8 mrad": lambda timing: {"backlash_rad": 0.008},
    "jitter 30 ms": lambda timing: {"jitter_s": 0.03},
    "acceleration 0.3": lambda timing: {"acceleration_ratio": 0.3},
}
"""Values of each fault, given the nominal timing of the head.

`over` N periods: speed estimated from the difference of angles over that span.
"""


class Case(NamedTuple):
    """Row of the table."""

    head: str
    fault: str
    law: str

    def scenario(self) -> Scenario:
        """Scenario of the trials."""
        if self.fault == DESK:
            return load_scenario(DESK)
        scenario = replace(
            load_scenario("hardware"), head=self.head, head_overrides={}, duration_s=DURATION_S
        )
        for name, value in FAULTS[self.fault](scenario.model().timing).items():
            scenario = with_imperfection(scenario, name, value)
        return scenario


def calm(trials: Trials) -> dict[str, float]:
    """Columns of a row from its trials."""
    return {
        "trials": trials.num,
        "settled_2px_fraction": float(np.isfinite(trials.settle_s(BAND_PX)).mean()),
        "swinging_trials": int(trials.swings.sum()),
        "left_again_fraction": float(trials.left_again.mean()),
        "fixation_peak_to_peak_median_deg_s": float(
            np.rad2deg(np.median(trials.fixation_peak_to_peak_rad_s))
        ),
        "ratio_to_bound_2px_median": float(np.median(trials.ratio_to_bound(BAND_PX))),
    }


def held(case: Case, episodes: int) -> dict[str, Any]:
    """Run the trials of a row; return the row."""
    scenario = case.scenario()
    controller = make_controller(case.law, head=scenario.model())
    trials = run_trials(controller, scenario, episodes=episodes)
    return {**case._asdict(), **calm(trials)}


def cases(heads: Sequence[str], faults: Sequence[str], laws: Sequence[str]) -> list[Case]:
    """All rows of these heads, faults and laws."""
    own = load_scenario(DESK).head
    return [
        Case(head, fault, law)
        for head in heads
        for fault in faults
        if fault != DESK or head == own
        for law in laws
        if law not in LEARNED or head in WITH_NETWORKS
    ]


def far_out() -> Iterator[tuple[str, Scenario]]:
    """Scenarios with targets at rest, and `hardware` with a quantity at an end of its search range.

    An end at the expected value is left out: its trials are those of `hardware`, or milder.
    """
    yield from ((name, one) for name, one in SCENARIOS.items() if not one.target_moves)
    hardware = load_scenario("hardware")
    head = hardware.model()
    for name in IMPERFECTION_RANGES:
        span = search_interval(name, hardware, head)
        for value in (span.low, span.high) if has_effect(name, hardware) else ():
            if value != span.expected:
                yield f"hardware, {name} = {value:g}", with_imperfection(hardware, name, value)


def swinging(name: str, scenario: Scenario, law: str, episodes: int) -> dict[str, Any]:
    """Run the trials of a row of the count; return the row."""
    controller = make_controller(law, head=scenario.model())
    trials = run_trials(controller, scenario, episodes=episodes)
    found = {"trials": trials.num, "swinging_trials": int(trials.swings.sum())}
    return {"scenario": name, "law": law, **found}


def sums(rows: Rows) -> Rows:
    """Sums of the count over all scenarios, for each law and for all laws."""
    return [
        {
            "scenario": "all",
            "law": law,
            **{
                column: sum(row[column] for row in rows if law in ("all", row["law"]))
                for column in ("trials", "swinging_trials")
            },
        }
        for law in (*dict.fromkeys(row["law"] for row in rows), "all")
    ]


def show(rows: Rows) -> None:
    """Print a table for each head."""
    laws = dict.fromkeys(row["law"] for row in rows)
    for head in dict.fromkeys(row["head"] for row in rows):
        out = Table(
            "fault",
            *laws,
            box=SIMPLE_HEAD,
            title=f"{head}: settled to {BAND_PX:g} px, trials that swing, peak to peak in deg/s",
            title_justify="left",
        )
        own = [row for row in rows if row["head"] == head]
        for fault in dict.fromkeys(row["fault"] for row in own):
            out.add_row(fault, *(_cell(row) for row in own if row["fault"] == fault))
        Console(width=WIDTH).print(out)


def _cell(row: dict[str, Any]) -> str:
    settled, swing = row["settled_2px_fraction"], row["swinging_trials"]
    return f"{100.0 * settled:.1f} %, {swing}, {row['fixation_peak_to_peak_median_deg_s']:.1f}"


def show_count(rows: Rows) -> None:
    """Print the scenarios with most oscillating trials, and the sums."""
    swing: dict[str, dict[str, int]] = {}
    for row in rows:
        swing.setdefault(row["scenario"], {})[row["law"]] = row["swinging_trials"]
    out = Table(
        "trials of",
        *next(iter(swing.values())),
        box=SIMPLE_HEAD,
        title=f"trials that swing, of {rows[0]['trials']} each",
        title_justify="left",
    )
    for name in sorted(swing, key=lambda name: -sum(swing[name].values()))[:WORST]:
        if any(swing[name].values()):
            out.add_row(name, *map(str, swing[name].values()))
    Console(width=WIDTH).print(out)
    for row in sums(rows):
        print(f"{row['law']}: {row['swinging_trials']} of {row['trials']} trials swing")


def main(arguments: list[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", action="store_true", help="count all trials that swing")
    parser.add_argument("--trials", type=int, default=300, help="trials of each row")
    parser.add_argument("--head", nargs="+", choices=HEADS, default=list(HEADS))
    parser.add_argument("--fault", nargs="+", choices=[*FAULTS, DESK], default=[*FAULTS, DESK])
    parser.add_argument("--law", nargs="+", choices=LAWS, help="all; recommended ones with --count")
    parser.add_argument("--csv", type=Path, help="where to keep the table")
    options = parser.parse_args(arguments)
    laws = options.law or (RECOMMENDED if options.count else LAWS)
    if options.count:
        jobs = [
            partial(swinging, name, scenario, law) for name, scenario in far_out() for law in laws
        ]
    else:
        jobs = [partial(held, case) for case in cases(options.head, options.fault, laws)]
    if not jobs:
        parser.error(f"--fault: {DESK} has its own head, {load_scenario(DESK).head}")
    rows = [job(options.trials) for job in track(jobs, "calm", console=Console(stderr=True))]
    (show_count if options.count else show)(rows)
    if options.csv is not None:
        table = pd.DataFrame([*rows, *(sums(rows) if options.count else ())])
        table.to_csv(options.csv, index=False, float_format="%.6g")


if __name__ == "__main__":
    main()
