"""Compare learned controllers and the best laws on trials beyond the range of the training.

Run ``python benchmarks/beyond_training.py``, with ``--csv docs/results/beyond_training.csv`` to
keep the table. Scenario ``hardware`` draws each imperfection from a range. Here one imperfection
at a time is set beyond its range in every trial: to 1.5 times its greatest value, or its least
value divided by 1.5; a gain's deviation from 1 is multiplied by 1.5. The others are drawn as
before. A row is an imperfection and a controller: the fraction of test trials that settle to 2 px,
and the median and 95th percentile of the settling time and of its ratio to the bound. A trial that
does not settle counts as infinitely slow. See ``docs/learning.md``.
"""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from vergence.controllers.controller import Controller, make_controller
from vergence.controllers.tuned import find_tuned_or_fallback
from vergence.envs.plants.conditions import Variation
from vergence.eval.trials.results import Trials
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import Scenario, load_scenario

BEYOND: Final = 1.5
"""Factor by which an imperfection exceeds its range (chosen: clearly beyond the training)."""
CONTROLLERS: Final = ("learned-policy", "learned-gain", "pursuit", "saccade", "state-feedback")
BAND_PX: Final = 2.0
"""Error band in which a trial counts as settled, px (chosen: that of the docs' tables)."""


def outside(variation: Variation) -> dict[str, Variation]:
    """Variations with one imperfection beyond its range each, by the name of the imperfection.

    Args:
        variation: variation of the training; it must draw all imperfections named here.
    """

    def greatest(name: str) -> float:
        return BEYOND * float(getattr(variation, name)[1])

    def least(name: str) -> float:
        return float(getattr(variation, name)[0]) / BEYOND

    slow, fast = (1.0 + BEYOND * (bound - 1.0) for bound in variation.speed_gain or (1.0, 1.0))
    values: dict[str, dict[str, float]] = {
        "image delay, long": {"latency_s": greatest("latency_s")},
        "image delay, short": {"latency_s": least("latency_s")},
        "frame jitter": {"jitter_s": greatest("jitter_s")},
        "command latency": {"command_latency_s": greatest("command_latency_s")},
        "feedback latency": {"feedback_latency_s": greatest("feedback_latency_s")},
        "joint lag": {"lag_s": greatest("lag_s")},
        "acceleration, low": {"acceleration_ratio": least("acceleration_ratio")},
        "speed gain, low": {"speed_gain": slow},
        "speed gain, high": {"speed_gain": fast},
        "backlash": {"backlash_rad": greatest("backlash_rad")},
        "detection noise": {"detection_noise_px": greatest("detection_noise_px")},
        "dropped frames": {"dropped_frame_probability": greatest("dropped_frame_probability")},
        "missed detections": {
            "missed_detection_probability": greatest("missed_detection_probability")
        },
        "outliers": {
            "outlier_probability": greatest("outlier_probability"),
            "outlier_px": greatest("outlier_px"),
        },
    }
    changed: dict[str, Variation] = {"none": variation}
    for name, fixed in values.items():
        ranges: dict[str, Any] = {field: (value, value) for field, value in fixed.items()}
        changed[name] = replace(variation, **ranges)
    if variation.model_errors is not None:
        changed["model errors"] = replace(
            variation, model_errors=variation.model_errors.scaled(BEYOND)
        )
    return changed


def controllers(scenario: Scenario, bundles: Mapping[str, str]) -> dict[str, Controller]:
    """Controllers for a scenario's head: tuned laws, and networks from files or as shipped."""
    head, made = scenario.model(), {}
    for name in CONTROLLERS:
        entry = find_tuned_or_fallback(name, scenario.name, head)
        options: dict[str, Any] = {} if entry is None else dict(entry.options)
        if name in bundles:
            options["bundle"] = bundles[name]
        made[name] = make_controller(name, head, **options)
    return made


def found(trials: Trials) -> dict[str, float]:
    """Columns of a row from its trials."""
    settle_s = trials.settle_s(BAND_PX)
    settle_s = np.where(np.isnan(settle_s), np.inf, settle_s)
    ratio = trials.ratio_to_bound(BAND_PX)
    ratio = ratio[~np.isnan(ratio)]
    # no interpolation between trials: one of them may be infinite
    at = {"method": "higher"}
    return {
        "settled_2px_fraction": float(np.isfinite(settle_s).mean()),
        "settle_2px_median_s": float(np.quantile(settle_s, 0.5, **at)),  # type: ignore[call-overload]
        "settle_2px_p95_s": float(np.quantile(settle_s, 0.95, **at)),  # type: ignore[call-overload]
        "ratio_to_bound_2px_median": float(np.quantile(ratio, 0.5, **at)),  # type: ignore[call-overload]
        "ratio_to_bound_2px_p95": float(np.quantile(ratio, 0.95, **at)),  # type: ignore[call-overload]
    }


def main(arguments: list[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--csv", type=Path, help="where to keep the table")
    parser.add_argument("--episodes", type=int, default=200, help="trials of each row")
    parser.add_argument("--policy", help="a bundle for learned-policy; the shipped one by default")
    parser.add_argument("--schedule", help="a bundle for learned-gain; the shipped one by default")
    parser.add_argument("--only", nargs="+", help="some of the imperfections; none for untouched")
    options = parser.parse_args(arguments)
    scenario = load_scenario("hardware")
    assert scenario.variation is not None
    cases = outside(scenario.variation)
    if unknown := set(options.only or ()) - set(cases):
        parser.error(f"--only: expected some of {', '.join(cases)}, got {', '.join(unknown)}")
    cases = {name: cases[name] for name in options.only or cases}
    bundles = {"learned-policy": options.policy, "learned-gain": options.schedule}
    made = controllers(scenario, {name: path for name, path in bundles.items() if path})
    rows = []
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("trials", total=len(cases) * len(made))
        for case, variation in cases.items():
            for name, controller in made.items():
                progress.update(task, description=f"{case}: {name}")
                trials = run_trials(
                    controller,
                    replace(scenario, variation=variation),
                    episodes=options.episodes,
                )
                rows.append({"imperfection": case, "controller": name, **found(trials)})
                progress.advance(task)
    table = Table(title=f"hardware, one imperfection at {BEYOND:g} times its range")
    table.add_column("imperfection", no_wrap=True)
    table.add_column("controller", no_wrap=True)
    for column in ("settled", "median", "95 %", "by bound", "95 %"):
        table.add_column(column)
    for row in rows:
        settled, median, p95, ratio, ratio_p95 = list(row.values())[2:]
        table.add_row(
            str(row["imperfection"]),
            str(row["controller"]),
            f"{settled:.1%}",
            f"{median:.3f} s",
            f"{p95:.3f} s",
            f"{ratio:.2f}",
            f"{ratio_p95:.2f}",
        )
    Console().print(table)
    if options.csv is not None:
        pd.DataFrame(rows).to_csv(options.csv, index=False, float_format="%.6g")


if __name__ == "__main__":
    main()
