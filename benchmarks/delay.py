"""Measure the accuracy of `vergence measure-delay` on emulated heads with random loops.

Run ``python -m benchmarks.delay [--seed N]``. For each of ten loops it starts `vergence emulate`
with random latencies, jitter, lag, gain, acceleration and backlash, and measures them. It takes
some 12 minutes. `--csv` keeps a summary for each quantity.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from rich.progress import track

from tests.hardware.emulated import emulated
from vergence.errors import HardwareError
from vergence.hardware.config import load_hardware
from vergence.hardware.delay.measure import measure_loop
from vergence.hardware.delay.measurement import LoopMeasurement
from vergence.models.files.head_file import load_head
from vergence.models.joints import EYES

DRAWN = {
    "latency": ("latency_s", 0.04, 0.13, "ms", 1e3),
    "jitter": ("jitter_s", 0.0, 0.01, "ms", 1e3),
    "command-latency": ("command_latency_s", 0.0, 0.017, "ms", 1e3),
    "lag": ("lag_s", 0.015, 0.06, "ms", 1e3),
    "speed-gain": ("speed_gain", 0.85, 1.15, "", 1.0),
    "acceleration": ("acceleration_ratio", 0.375, 1.5, "of the head's", 1.0),
    "backlash": ("backlash_rad", 0.0, 0.003, "mrad", 1e3),
}
"""Options of `vergence emulate`: name in the measurement, least and greatest value, unit, scale."""

EMULATED = {"acceleration": float(load_head("turrets").actuation.acceleration[EYES][0])}
"""The emulated head's own value of options that are drawn as a ratio to it."""


def found_of(measured: LoopMeasurement) -> dict[str, float | None]:
    """Values found by a measurement, by name."""
    values = vars(measured.loop()) | {"latency_s": np.mean(list(measured.latencies_s.values()))}
    return {name: values[name] for name, *_ in DRAWN.values()}


def main() -> None:
    """Measure, and print a row for each loop and quantity, and a summary of each quantity."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--loops", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", type=Path)
    chosen = parser.parse_args()
    rng = np.random.default_rng(chosen.seed)
    rows = []
    for number in track(range(chosen.loops), "delay"):
        drawn = {name: float(rng.uniform(low, high)) for name, (_, low, high, *_) in DRAWN.items()}
        options = [
            word
            for name, value in drawn.items()
            for word in (f"--{name}", f"{value * EMULATED.get(name, 1.0):.6f}")
        ]
        with tempfile.TemporaryDirectory() as folder, emulated(Path(folder), *options) as (desk, _):
            try:
                measured = measure_loop(load_hardware(desk))
            except HardwareError as error:
                print(f"loop {number}: {drawn}: {error}", flush=True)
                continue
        found, sigma = found_of(measured), measured.loop().sigma
        print(f"loop {number}: {measured.rows()}", flush=True)
        for name, (field, _, _, unit, scale) in DRAWN.items():
            value = found[field]
            rows.append(
                {
                    "loop": number,
                    "quantity": name,
                    "unit": unit,
                    "drawn": scale * drawn[name],
                    "found": np.nan if value is None else scale * value,
                    "sigma": scale * sigma.get(field, np.nan),
                }
            )
    table = pd.DataFrame(rows)
    table["error"] = table["found"] - table["drawn"]
    table["relative"] = table["error"] / table["drawn"]
    table["sigmas"] = table["error"] / table["sigma"]
    print(table.to_string(index=False, float_format=lambda value: f"{value:.4g}"))
    summary = pd.DataFrame(
        {
            "quantity": name,
            "unit": group["unit"].iloc[0],
            "loops": chosen.loops,
            "told": int(group["found"].notna().sum()),
            "most": group["error"].abs().max(),
            "median": group["error"].abs().median(),
            "most_relative": group["relative"].abs().max(),
            "bias": group["error"].mean(),
            "spread": group["error"].std(),
            "sigma": group["sigma"].median(),
            "most_sigmas": group["sigmas"].abs().max(),
        }
        for name, group in table.groupby("quantity", sort=False)
    )
    print(summary.to_string(index=False, float_format=lambda value: f"{value:.3g}"))
    if chosen.csv is not None:
        summary.to_csv(chosen.csv, index=False, float_format="%.4g")


if __name__ == "__main__":
    main()
