"""Measure the accuracy of `vergence measure-delay` on emulated heads with random loops.

Run ``python -m benchmarks.delay [--seed N]``. Each of twenty loops has random latencies, jitter,
lag, gain, acceleration, backlash, friction and gravity, and is measured in simulated time: every
other one turns the tilts, which gravity loads. `--real` measures `vergence emulate` instead, in
real time, a minute for each loop. `--smooth` is without friction and gravity. `--detuned` draws the
gain of each motor's integral too, from 0.4 to 2.5 of that which cancels its pole; its lag is then
only nominal. `--csv` keeps a summary for each quantity.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rich.progress import track

from tests.hardware.emulated import emulated
from tests.hardware.virtual import VirtualRobot, WatchedWorld, virtual_config
from vergence.errors import HardwareError
from vergence.hardware.config import load_hardware
from vergence.hardware.delay.measure import LoopMeasurement, measure_loop
from vergence.hardware.emulator.config import EmulatorConfig
from vergence.models.head_file import load_head
from vergence.models.parts import EYE_NAMES, EYES

HEAD = load_head("turrets")
TARGET = np.array([0.0, -0.1, 1.0])
ASSUMED_LATENCY_S = 0.08

DRAWN = {
    "latency": ("latency_s", 0.04, 0.13, "ms", 1e3),
    "jitter": ("jitter_s", 0.0, 0.01, "ms", 1e3),
    "command-latency": ("command_latency_s", 0.0, 0.017, "ms", 1e3),
    "lag": ("lag_s", 0.015, 0.06, "ms", 1e3),
    "speed-gain": ("speed_gain", 0.85, 1.15, "", 1.0),
    "acceleration": ("acceleration_ratio", 0.375, 1.5, "of the head's", 1.0),
    "backlash": ("backlash_rad", 0.0, 0.006, "mrad", 1e3),
    "friction": ("", 0.0, 0.08, "", 1.0),
    "gravity": ("", 0.0, 0.15, "", 1.0),
    "integral": ("", 0.4, 2.5, "", 1.0),
}
"""Options of `vergence emulate`, but for `integral`: name in the measurement, if it has one, least
and greatest value, unit, scale."""

EMULATED = {"acceleration": float(HEAD.actuation.acceleration[EYES][0])}
"""The emulated head's own value of options that are drawn as a ratio to it."""
CAMERA = ("latency", "jitter")


def found_of(measured: LoopMeasurement) -> dict[str, float | None]:
    """Values found by a measurement, by name."""
    return vars(measured.loop()) | {"latency_s": np.mean(list(measured.latencies_s.values()))}


def measure_simulated(
    options: dict[str, float], integral: float, tilts: bool, seed: int
) -> LoopMeasurement:
    """Measure a loop in simulated time, both eyes one after the other."""
    names = {"lag": "lag_s", "acceleration": "acceleration_rad_s2"}
    motors = {
        names.get(name, DRAWN[name][0] or name): value
        for name, value in options.items()
        if name not in CAMERA
    }
    eyes = []
    for eye, name in enumerate(EYE_NAMES):
        with pytest.MonkeyPatch.context() as patch:
            world = WatchedWorld(
                HEAD, TARGET, EmulatorConfig(**motors), seed=2 * seed + eye,
                latency_s=options["latency"], jitter_s=options["jitter"],
            )  # fmt: skip
            for servo in world.servos.values():
                servo._motor.integral_s /= integral
            robot = VirtualRobot(patch, world, virtual_config(HEAD, ASSUMED_LATENCY_S))
            actuator = f"{name}_{'tilt' if tilts else 'pan'}"
            measured = measure_loop(
                robot.config, (name,), actuator=actuator, clock=robot.clock,
                sleep=robot.clock.sleep,
            )  # fmt: skip
        eyes += measured.eyes
    return LoopMeasurement(eyes=tuple(eyes))


def measure_real(options: dict[str, float]) -> LoopMeasurement:
    """Measure a loop of `vergence emulate`, in real time."""
    words = [word for name, value in options.items() for word in (f"--{name}", f"{value:.6f}")]
    with tempfile.TemporaryDirectory() as folder, emulated(Path(folder), *words) as (desk, _):
        return measure_loop(load_hardware(desk))


def main() -> None:
    """Measure, and print a row for each loop and quantity, and a summary of each quantity."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--loops", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--real", action="store_true")
    parser.add_argument("--smooth", action="store_true")
    parser.add_argument("--detuned", action="store_true")
    parser.add_argument("--csv", type=Path)
    chosen = parser.parse_args()
    if chosen.real and chosen.detuned:
        parser.error("--detuned: expected simulated time; cure: leave --real out")
    rng = np.random.default_rng(chosen.seed)
    rows = []
    for number in track(range(chosen.loops), "delay"):
        drawn = {name: float(rng.uniform(low, high)) for name, (_, low, high, *_) in DRAWN.items()}
        options = {name: value * EMULATED.get(name, 1.0) for name, value in drawn.items()}
        integral = options.pop("integral")
        if chosen.smooth:
            options |= {"friction": 0.0, "gravity": 0.0}
        try:
            if chosen.real:
                measured = measure_real(options)
            else:
                kept = integral if chosen.detuned else 1.0
                measured = measure_simulated(options, kept, number % 2 == 1, number)
        except HardwareError as error:
            print(f"loop {number}: {drawn}: {error}", flush=True)
            continue
        found, sigma = found_of(measured), measured.loop().sigma
        print(f"loop {number}: {measured.rows()} {measured.misfits()}", flush=True)
        for name, (field, _, _, unit, scale) in DRAWN.items():
            if not field:
                continue
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
            "within_3_sigmas": (group["sigmas"].dropna().abs() < 3.0).mean(),
        }
        for name, group in table.groupby("quantity", sort=False)
    )
    print(summary.to_string(index=False, float_format=lambda value: f"{value:.3g}"))
    if chosen.csv is not None:
        summary.to_csv(chosen.csv, index=False, float_format="%.4g")


if __name__ == "__main__":
    main()
