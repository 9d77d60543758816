"""After how long the emulated head is at rest after each fault, by its own record, in real time.

Run ``python -m benchmarks.faults --moments 100``. A policy turns all joints to and fro; at a drawn
moment of each trial a fault begins. Process faults befall a process of their own that turns the
joints in the same way. The bounds are those of docs/robot.md; the exit status is 1 if a moment was
outside its bound. On a loaded machine the emulator's own process is late too.
"""

import argparse
import dataclasses
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from rich.console import Console
from rich.progress import track

from benchmarks.wire import emulated, show
from vergence.hardware.config import HardwareConfig, load_hardware
from vergence.hardware.emulator.client import EmulatedWorld
from vergence.hardware.plant import HardwarePlant
from vergence.hardware.safety.config import SafetyConfig

LONGEST_S = 8.0
"""Time after which a fault that has stopped nothing is given up, s."""
GOES_ON_S = 1.5
ONE = np.zeros(1, dtype=np.int64)


class Case(NamedTuple):
    """A fault, and within which time the joints are to rest; None where the head goes on."""

    request: dict[str, Any]
    bound_s: float | None


class Bounds:
    """Times of a head."""

    def __init__(self, config: HardwareConfig) -> None:
        timing, actuation = config.head.timing, config.head.actuation
        self.period_s = timing.period_s
        braking_s = float((actuation.velocity[3:] / actuation.acceleration[3:]).max())
        self.rest_s = braking_s + 5.0 * timing.lag_s + 3.0 * timing.period_s
        self.silent_s = 0.1 + 2.0 * timing.period_s + self.rest_s
        self.alone_s = config.bus.watchdog_s + 5.0 * timing.lag_s + 0.02
        self.image_s = config.safety.image_age_s + 0.3 + self.rest_s
        self.follow_s = 0.8 + self.rest_s


def cases(bounds: Bounds) -> dict[str, Case]:
    """The faults by name."""
    rest_s, period_s = bounds.rest_s, bounds.period_s
    return {
        "answers lost": Case({"what": "lost"}, bounds.silent_s),
        "answers of one lost": Case({"what": "lost", "ids": [2]}, bounds.silent_s),
        "answers damaged": Case({"what": "bad-crc"}, bounds.silent_s),
        "answers cut short": Case({"what": "short"}, bounds.silent_s),
        "answers late": Case({"what": "late"}, bounds.silent_s),
        "plug of one pulled": Case({"what": "silent", "ids": [3]}, bounds.silent_s),
        "overload": Case({"what": "overload", "ids": [1]}, 2.0 * period_s + rest_s),
        "reboot": Case({"what": "reboot", "ids": [1]}, 12.0 * period_s + rest_s),
        "voltage": Case({"what": "voltage", "value": 4.0}, 1.0 + rest_s),
        "temperature": Case({"what": "temperature", "ids": [2], "value": 69}, 1.1 + rest_s),
        "load": Case({"what": "load", "ids": [2], "value": 100}, 4.0 + rest_s),
        "encoder frozen": Case({"what": "frozen", "ids": [1]}, bounds.follow_s),
        "joint stuck": Case({"what": "stuck", "ids": [1]}, bounds.follow_s),
        "wrong way": Case({"what": "wrong-way", "ids": [1]}, bounds.follow_s),
        "camera ended": Case({"what": "ended", "eye": "left"}, 0.5 + rest_s),
        "camera stalled": Case({"what": "stalled", "eye": "right"}, bounds.image_s),
        "camera frozen": Case({"what": "frozen", "eye": "left"}, bounds.image_s),
        "images dropped": Case({"what": "dropped", "eye": "right"}, bounds.image_s),
        "images late": Case({"what": "late", "eye": "left", "value": 1.0}, bounds.image_s),
        "images torn": Case({"what": "torn", "eye": "both"}, None),
        "cameras out of step": Case({"what": "out-of-step"}, None),
        "answers doubled": Case({"what": "doubled"}, None),
        "a third of the answers lost": Case({"what": "lost", "probability": 0.3}, None),
        "cable pulled": Case({"what": "unplug"}, bounds.alone_s),
    }


def blind(config: HardwareConfig) -> HardwareConfig:
    """A robot that goes on where it sees no target: the policy here looks at none."""
    return dataclasses.replace(config, safety=SafetyConfig(lost_s=60.0))


class Mover:
    """A policy that turns all joints to and fro for ever, by drawn sinusoids."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rate = 2.0 * np.pi * rng.uniform(0.5, 1.2, 4)
        self._phase = rng.uniform(0.0, 2.0 * np.pi, 4)
        self._peak = rng.uniform(1.5, 3.0, 4)

    def drive(self, plant: HardwarePlant, seconds: float) -> None:
        """Turn the joints for a time, or until a fault stops them."""
        wish, until_s = np.zeros((1, 7)), time.monotonic() + seconds
        while time.monotonic() < until_s and not plant.fault:
            angle = self._rate * time.monotonic() + self._phase
            wish[0, 3:] = self._peak * np.sin(angle)
            plant.step(wish)


def rested_s(world: EmulatedWorld, since_s: float, wait_s: float = 0.6) -> float:
    """After how long from a time on all joints rested, s; inf if one turns still."""
    time.sleep(wait_s)
    rested = world.rested_s(since_s)
    return np.inf if rested is None else rested - since_s


def befall(config: HardwareConfig, case: Case, rng: np.random.Generator) -> tuple[float, str]:
    """One moment of a fault: after how long all rested, and what was said."""
    world = EmulatedWorld(config.emulator)
    plant = HardwarePlant(config.head, config=config)
    try:
        mover = Mover(rng)
        plant.reset(ONE, config.head.rest()[None])
        mover.drive(plant, rng.uniform(0.3, 1.5))
        if plant.fault:
            return np.inf, f"before the fault: {plant.fault}"
        since_s = world.fault(**case.request)
        mover.drive(plant, LONGEST_S if case.bound_s is not None else GOES_ON_S)
        if case.bound_s is None:
            return np.nan, plant.fault
        return rested_s(world, since_s), plant.fault
    finally:
        if case.request["what"] != "unplug":
            world.clear()
            world.fault(what="reboot")  # what has latched
        plant.close()
        world.close()


def turn(path: str) -> None:
    """Turn the joints to and fro for ever: what process faults befall."""
    config = blind(load_hardware(path))
    plant = HardwarePlant(config.head, config=config)
    plant.reset(ONE, config.head.rest()[None])
    mover = Mover(np.random.default_rng(0))
    print("turning", flush=True)
    try:
        mover.drive(plant, 60.0)
    finally:
        plant.close()


def kill(config: HardwareConfig, number: int, rng: np.random.Generator) -> tuple[float, str]:
    """One moment of a signal to a process that turns the joints."""
    world = EmulatedWorld(config.emulator)
    words = [sys.executable, "-m", "benchmarks.faults", "--turn", config.path]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(rng.uniform(0.3, 1.5))
        since_s = time.monotonic()
        process.send_signal(number)
        after_s = rested_s(world, since_s)
        process.kill()
    world.close()
    return after_s, ""


def measure(name: str, bound_s: float | None, moments: list[tuple[float, str]]) -> dict[str, Any]:
    """A row of the table."""
    times = np.array([after_s for after_s, _ in moments])
    row: dict[str, Any] = {"fault": name, "moments": len(moments), "reaction": "stops"}
    if bound_s is None:
        stopped = sum(bool(text) for _, text in moments)
        return row | {"reaction": "goes on", "within": len(moments) - stopped}
    row |= {"median_ms": 1e3 * np.median(times), "worst_ms": 1e3 * times.max()}
    return row | {"bound_ms": 1e3 * bound_s, "within": int((times <= bound_s).sum())}


def main() -> None:
    """Let all faults befall the head, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", help="names of faults")
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--turn", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.turn:
        turn(options.turn)
        return
    rng, rows = np.random.default_rng(options.seed), []
    console = Console(stderr=True)

    def run(name: str, bound_s: float | None, one: Callable[[], tuple[float, str]]) -> None:
        if options.only and name not in options.only:
            return
        moments = [one() for _ in track(range(options.moments), name, console=console)]
        rows.append(measure(name, bound_s, moments))
        for after_s, text in moments:
            if after_s > (bound_s or np.inf) or (bound_s is None and text):
                console.print(f"{name}: {1e3 * after_s:.0f} ms: {text}")

    def pull() -> tuple[float, str]:
        with emulated() as fresh:
            return befall(blind(fresh), cases(Bounds(fresh))["cable pulled"], rng)

    with emulated() as head:
        config = blind(head)
        bounds = Bounds(config)
        for name, case in cases(bounds).items():
            if name != "cable pulled":
                run(name, case.bound_s, lambda case=case: befall(config, case, rng))
        for number in (signal.SIGINT, signal.SIGKILL, signal.SIGSTOP):
            run(number.name, bounds.alone_s, lambda number=number: kill(config, number, rng))
    run("cable pulled", bounds.alone_s, pull)
    table = pd.DataFrame(rows)
    show(table)
    if options.csv:
        table.to_csv(options.csv, index=False, float_format="%.4g")
    raise SystemExit(int((table.within < table.moments).any()))


if __name__ == "__main__":
    main()
