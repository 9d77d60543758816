"""Measure the time from each fault to the rest of an emulated head, in real time.

Run ``python -m benchmarks.faults --moments 100``. A policy turns all joints to and fro; at a random
moment of each trial a fault begins. The emulator records the motion. Process faults are applied to
a separate process that turns the joints in the same way. The bounds are those of docs/robot.md; the
exit status is 1 if a trial exceeded its bound. On a loaded machine the emulator's own process is
late too.
"""

import argparse
import dataclasses
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from rich.console import Console
from rich.progress import track

from benchmarks.wire import emulated, show
from vergence.errors import HardwareError
from vergence.hardware.config import HardwareConfig, load_hardware
from vergence.hardware.emulator.client import WorldClient
from vergence.hardware.plant import HardwarePlant
from vergence.hardware.safety.limits import SafetyConfig
from vergence.models.parts import FloatArray

LONGEST_S = 8.0
"""Time limit of a fault that stops nothing, s."""
GOES_ON_S = 1.5
ONE = np.zeros(1, dtype=np.int64)


class Case(NamedTuple):
    """A fault, the time limit in which the joints must rest, and a part of the expected reason."""

    request: dict[str, Any]
    bound_s: float
    reason: str


class Bounds:
    """Time limits of a head, s."""

    def __init__(self, config: HardwareConfig) -> None:
        timing, actuation = config.head.timing, config.head.actuation
        self.period_s = timing.period_s
        braking_s = float((actuation.velocity[3:] / actuation.acceleration[3:]).max())
        self.rest_s = braking_s + 5.0 * timing.lag_s + 3.0 * timing.period_s
        self.silent_s = 0.1 + 2.0 * timing.period_s + self.rest_s
        self.alone_s = config.bus.watchdog_s + 5.0 * timing.lag_s + 0.02
        self.image_s = config.safety.image_age_s + 0.3 + self.rest_s
        self.follow_s = 0.8 + self.rest_s
        self.leave_s = self.period_s + self.rest_s


def cases(bounds: Bounds) -> dict[str, Case]:
    """Faults of line, servos and cameras that must stop the head, by name."""
    rest_s, period_s = bounds.rest_s, bounds.period_s
    silent_s, image_s, follow_s = bounds.silent_s, bounds.image_s, bounds.follow_s
    answer, image, follow = "expected an answer of the id", "a new image within", "to follow"
    one_s = max(silent_s, bounds.alone_s)
    return {
        "answers lost": Case({"what": "lost"}, silent_s, answer),
        "answers of one lost": Case({"what": "lost", "ids": [2]}, silent_s, "left_tilt"),
        "answers damaged": Case({"what": "bad-crc"}, silent_s, answer),
        "answers cut short": Case({"what": "short"}, silent_s, answer),
        "answers late": Case({"what": "late"}, silent_s, answer),
        "plug of one pulled": Case({"what": "silent", "ids": [3]}, one_s, "right_pan"),
        "cable pulled": Case({"what": "unplug"}, bounds.alone_s, "gone"),
        "overload": Case({"what": "overload", "ids": [1]}, 2.0 * period_s + rest_s, "overload"),
        "reboot": Case({"what": "reboot", "ids": [1]}, 12.0 * period_s + rest_s, "let go"),
        "voltage": Case({"what": "voltage", "value": 4.0}, 1.0 + rest_s, "voltage"),
        "hot": Case({"what": "temperature", "ids": [2], "value": 69}, 1.1 + rest_s, "temperature"),
        "load": Case({"what": "load", "ids": [2], "value": 100}, 4.0 + rest_s, "load"),
        "encoder frozen": Case({"what": "frozen", "ids": [1]}, follow_s, follow),
        "encoder blind": Case({"what": "blind", "ids": [1]}, 0.5, follow),
        "encoder's fault bit": Case({"what": "blind-told", "ids": [1]}, 0.5, "motor encoder"),
        "motor inverted": Case({"what": "inverted", "ids": [1]}, 0.5, "left_pan"),
        "joint stuck": Case({"what": "stuck", "ids": [1]}, follow_s, follow),
        "wrong way": Case({"what": "wrong-way", "ids": [1]}, follow_s, "left_pan"),
        "camera ended": Case({"what": "ended", "eye": "left"}, 0.5 + rest_s, "ended"),
        "camera stalled": Case({"what": "stalled", "eye": "right"}, image_s, image),
        "camera frozen": Case({"what": "frozen", "eye": "left"}, image_s, image),
        "images dropped": Case({"what": "dropped", "eye": "right"}, image_s, image),
        "images late": Case({"what": "late", "eye": "left", "value": 1.0}, image_s, image),
    }


GOES_ON: dict[str, dict[str, Any]] = {
    "images torn": {"what": "torn", "eye": "both"},
    "cameras out of step": {"what": "out-of-step"},
    "answers doubled": {"what": "doubled"},
    "a third of the answers lost": {"what": "lost", "probability": 0.3},
}
"""Faults that must not stop the head."""


def blind(config: HardwareConfig) -> HardwareConfig:
    """Configuration that tolerates a lost target, since the policy here fixates none."""
    return dataclasses.replace(config, safety=SafetyConfig(lost_s=60.0, view_check=False))


class Mover:
    """Policy that turns all joints to and fro by random sinusoids."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rate = 2.0 * np.pi * rng.uniform(0.5, 1.2, 4)
        self._phase = rng.uniform(0.0, 2.0 * np.pi, 4)
        self._peak = rng.uniform(1.5, 3.0, 4)

    def command(self, time_s: float) -> FloatArray:
        """(1, 7) velocity command at a time, rad/s."""
        command = np.zeros((1, 7))
        command[0, 3:] = self._peak * np.sin(self._rate * time_s + self._phase)
        return command

    def drive(self, plant: HardwarePlant, seconds: float) -> None:
        """Turn the joints for a time, or until a fault stops them."""
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s and not plant.fault:
            plant.step(self.command(time.monotonic()))


def rested_s(world: WorldClient, since_s: float, wait_s: float = 0.6) -> float:
    """Time from `since_s` until all joints rested, s; inf if one still turns."""
    time.sleep(wait_s)
    rested = world.rest_start_s(since_s)
    return np.inf if rested is None else rested - since_s


def befall(
    config: HardwareConfig,
    happen: Callable[[HardwarePlant, WorldClient, Mover], float],
    rng: np.random.Generator,
    wait_s: float = 0.6,
) -> tuple[float, str]:
    """Run one trial of an event; return the time until all joints rested, s, and the reason."""
    world = WorldClient(config.emulator_address)
    plant = HardwarePlant(config.head, config=config)
    try:
        mover = Mover(rng)
        plant.reset(ONE, config.head.rest()[None])
        mover.drive(plant, rng.uniform(0.3, 1.5))
        if plant.fault:
            raise HardwareError(plant.fault)
        since_s = happen(plant, world, mover)
        return rested_s(world, since_s, wait_s), plant.fault
    finally:
        with suppress(HardwareError):  # the cable may have been pulled
            world.clear_faults()
            world.begin_fault(what="reboot")  # clears latched errors
        plant.close()
        world.close()


def fault(
    request: dict[str, Any], longest_s: float
) -> Callable[[HardwarePlant, WorldClient, Mover], float]:
    """Event: a fault of the emulator begins while the policy continues."""

    def happen(plant: HardwarePlant, world: WorldClient, mover: Mover) -> float:
        since_s = world.begin_fault(**request)
        mover.drive(plant, longest_s)
        return since_s

    return happen


def sleeps(plant: HardwarePlant, world: WorldClient, mover: Mover) -> float:
    """Event: the policy sleeps for a second."""
    since_s = time.monotonic()
    time.sleep(1.0)
    mover.drive(plant, 0.1)
    return since_s


def says_nan(plant: HardwarePlant, world: WorldClient, mover: Mover) -> float:
    """Event: the policy commands nan."""
    since_s = time.monotonic()
    plant.step(np.full((1, 7), np.nan))
    return since_s


def raises(plant: HardwarePlant, world: WorldClient, mover: Mover) -> float:
    """Event: the policy raises an exception, and the plant is closed."""
    since_s = time.monotonic()
    plant.close()
    return since_s


def turn(path: str) -> None:
    """Turn the joints to and fro for a minute: the process to which process faults apply."""
    config = blind(load_hardware(path))
    plant = HardwarePlant(config.head, config=config)
    for number in (signal.SIGINT, signal.SIGTERM):  # as in the commands
        signal.signal(number, signal.default_int_handler)
    plant.reset(ONE, config.head.rest()[None])
    mover = Mover(np.random.default_rng(0))
    print("turning", flush=True)
    try:
        mover.drive(plant, 60.0)
    finally:
        plant.close()


def kill(config: HardwareConfig, number: int, rng: np.random.Generator) -> tuple[float, str]:
    """Run one trial of a signal to a process that turns the joints."""
    world = WorldClient(config.emulator_address)
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


def again(one: Callable[[], tuple[float, str]], tries: int = 5) -> tuple[float, str]:
    """Run one trial; repeat it if the load of the machine stops the head before its fault."""
    for _ in range(tries - 1):
        try:
            return one()
        except HardwareError as error:
            print(f"drawn again: {error}", file=sys.stderr)
    return one()


def measure(
    name: str, moments: list[tuple[float, str]], bound_s: float | None, reason: str = ""
) -> dict[str, Any]:
    """Row of the table; without a bound the head must not stop."""
    times = np.array([after_s for after_s, _ in moments])
    row: dict[str, Any] = {"fault": name, "moments": len(moments)}
    if bound_s is None:
        return row | {"reaction": "goes on", "within": sum(not said for _, said in moments)}
    within = sum(after_s <= bound_s and reason in said for after_s, said in moments)
    row |= {"reaction": "rests", "within": within, "bound_ms": 1e3 * bound_s}
    return row | {"median_ms": 1e3 * float(np.median(times)), "worst_ms": 1e3 * float(times.max())}


def main() -> None:
    """Run all faults and print the table."""
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

    def run(
        name: str, one: Callable[[], tuple[float, str]], bound_s: float | None, reason: str = ""
    ) -> None:
        if options.only and name not in options.only:
            return
        moments = [again(one) for _ in track(range(options.moments), name, console=console)]
        rows.append(measure(name, moments, bound_s, reason))
        console.print(rows[-1])
        for after_s, said in moments:
            if bound_s is None and said:
                console.print(f"{name}: stopped: {said}")
            if bound_s is not None and not (after_s <= bound_s and reason in said):
                console.print(f"{name}: {1e3 * after_s:.0f} ms: {said}")

    def pull() -> tuple[float, str]:
        with emulated() as fresh:
            return befall(blind(fresh), fault({"what": "unplug"}, LONGEST_S), rng)

    with emulated() as head:
        config = blind(head)
        bounds = Bounds(config)
        for name, case in cases(bounds).items():
            happen = fault(case.request, LONGEST_S)
            one = pull if name == "cable pulled" else partial(befall, config, happen, rng)
            run(name, one, case.bound_s, case.reason)
        for name, request in GOES_ON.items():
            run(name, partial(befall, config, fault(request, GOES_ON_S), rng, 0.0), None)
        run("policy sleeps", partial(befall, config, sleeps, rng), bounds.alone_s, "silence")
        run("policy says nan", partial(befall, config, says_nan, rng), bounds.leave_s, "nan")
        run("policy raises", partial(befall, config, raises, rng), bounds.leave_s)
        for number in (signal.SIGINT, signal.SIGTERM):
            run(number.name, partial(kill, config, number, rng), bounds.leave_s)
        for number in (signal.SIGKILL, signal.SIGSTOP):
            run(number.name, partial(kill, config, number, rng), bounds.alone_s)
    table = pd.DataFrame(rows)
    show(table)
    if options.csv:
        table.to_csv(options.csv, index=False, float_format="%.4g")
    raise SystemExit(int((table.within < table.moments).any()))


if __name__ == "__main__":
    main()
