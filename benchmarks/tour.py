"""Try the robot functions on an emulated head: checks, gazes, replay, loop delays, a fault.

Run ``make robot``, or ``python -m benchmarks.tour`` where the extra `robot` is installed. It takes
some two minutes, prints a row for each step, and ends with exit status 0 only if all steps passed.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from benchmarks.robot import bare
from benchmarks.wire import emulated
from vergence.errors import VergenceError
from vergence.eval.robot.config import DeployConfig, ReplayConfig
from vergence.eval.robot.deploy import Deployment, GazeState, deploy
from vergence.eval.robot.replay import replay
from vergence.hardware.checks import check_robot
from vergence.hardware.config import HardwareConfig
from vergence.hardware.delay.measure import measure_loop
from vergence.hardware.emulator.client import WorldClient

LAW: Final = "state-feedback"
"""The law that docs/controllers.md recommends on a robot."""
GAZES: Final = 20
"""Number of gazes (chosen: confidence against run time)."""
FEWEST: Final = 19
"""Gazes that have to settle (chosen: one may fail by chance)."""
NEAR_S: Final = 0.004
"""Largest error of a measured image latency, s (chosen: tolerance of one measurement)."""
ALIKE: Final = 0.1
"""Largest relative error of a measured joint lag (chosen: tolerance of one measurement)."""
LATEST_S: Final = 0.5
"""Time in which the head must be at rest after a pulled cable, s (chosen: watchdog plus lag)."""


MOVING_RAD_S: Final = 0.3
"""Speed of a joint at which the cable is pulled, rad/s (chosen: far above rest)."""
TIMER_S: Final = 3.0
"""Duration of the timer that measures the machine, s (chosen)."""


class Step(NamedTuple):
    """Result of one step."""

    name: str
    went_well: bool
    found: str
    seconds: float


class Tour:
    """Runner of the steps; prints each step as it ends."""

    def __init__(self, console: Console) -> None:
        self.steps: list[Step] = []
        self._console = console

    def step(self, name: str, act: Callable[[], tuple[bool, str]]) -> bool:
        """Run a step and keep its result; a `VergenceError` counts as a failure."""
        begun_s = time.monotonic()
        with self._console.status(name):
            try:
                went_well, found = act()
            except VergenceError as error:
                went_well, found = False, "; ".join(error.lines)
        self.steps.append(Step(name, went_well, found, time.monotonic() - begun_s))
        self._console.print(
            f"{'ok' if went_well else 'FAILED'}: {name}: {found}", markup=False, highlight=False
        )
        return went_well

    @property
    def status(self) -> int:
        """Exit status: 0 if all steps passed, else 1."""
        return 0 if self.steps and all(step.went_well for step in self.steps) else 1

    def table(self) -> Table:
        """Table with a row for each step."""
        table = Table("step", "", "found", "s")
        for step in self.steps:
            mark = "ok" if step.went_well else "FAILED"
            table.add_row(step.name, mark, escape(step.found), f"{step.seconds:.1f}")
        return table


def timed(hardware: HardwareConfig) -> tuple[bool, str]:
    """Check that a bare timer at the control rate is in time on this machine, beside the head."""
    period_s = hardware.head.timing.period_s
    _missed, _periods, late = bare(TIMER_S, period_s)
    most_s = float(np.quantile(late, 0.99))
    return most_s < 0.5 * period_s, (
        f"99 % of a timer's periods late by {1e3 * most_s:.1f} ms at most, tolerated "
        f"{500.0 * period_s:.1f}" + ("" if most_s < 0.5 * period_s else ": end other programs")
    )


def checked(hardware: HardwareConfig) -> tuple[bool, str]:
    """Run all checks of the robot."""
    parts = check_robot(hardware)
    wrong = [str(finding) for part in parts for finding in part.findings]
    return not wrong, "; ".join(wrong) or f"line, servos and cameras: {len(parts)} parts passed"


def deployed(
    hardware: HardwareConfig, gazes: int, log: Path, show: Callable[[GazeState], None]
) -> Deployment:
    """Run gazes of the law; Ctrl-C in them ends the tour."""
    config = DeployConfig(controller=LAW, hardware=Path(hardware.path), gazes=gazes)
    found = deploy(config, log, show=show)
    if isinstance(found.error, KeyboardInterrupt):
        raise found.error
    return found


def gazed(hardware: HardwareConfig, log: Path, console: Console) -> tuple[bool, str]:
    """Check that gazes settle and do not oscillate."""

    def tell(present: GazeState) -> None:
        if present.step == 0 and present.number % 5 == 1:
            console.print(f"gaze {present.number} of {GAZES}")

    found = deployed(hardware, GAZES, log, tell)
    if found.error is not None:
        return False, str(found.error)
    rows = found.gazes.rows()
    settled = sum(row["settle_2px_s"] is not None for row in rows)
    swinging = sum(row["swings"] for row in rows)
    summary = found.gazes.summary()
    median_s, off_mm = (
        float("nan") if summary[name] is None else summary[name]
        for name in ("settle_2px_median_s", "point_error_median_mm")
    )
    return settled >= FEWEST and swinging == 0 and len(rows) == GAZES, (
        f"{settled} of {len(rows)} gazes settled to 2 px, tolerated {FEWEST}, in "
        f"{1e3 * median_s:.0f} ms (median), {swinging} oscillate, point {off_mm:.1f} mm off, "
        f"{summary['overrun_fraction']:.2%} of the periods late"
    )


def hurt(hardware: HardwareConfig, log: Path) -> tuple[bool, str]:
    """Pull the cable in the second of three gazes; check that the head stops and reports why."""
    world = WorldClient(hardware.emulator_address)
    pulled_s: list[float] = []

    def pull(present: GazeState) -> None:
        moving = np.abs(present.reading.velocities).max() > MOVING_RAD_S
        if present.number >= 2 and moving and not pulled_s:
            pulled_s.append(world.begin_fault(what="unplug"))

    try:
        found = deployed(hardware, 3, log, pull)
        time.sleep(LATEST_S)
        rested_s = world.rest_start_s(pulled_s[0]) if pulled_s else None
    finally:
        world.close()
    if found.error is None or rested_s is None:
        return False, f"the reason {found.error}, at rest {rested_s is not None}"
    after_s = rested_s - pulled_s[0]
    told = (
        f"at rest {after_s:.2f} s after the cable was pulled, tolerated {LATEST_S}, reported as: "
        f"{found.error}"
    )
    named = hardware.bus.port in str(found.error)
    return named and 0.0 < after_s < LATEST_S, told  # 0 if the head was not moving


def measured(hardware: HardwareConfig) -> tuple[bool, str]:
    """Check the measured loop of the left eye against the emulated head."""
    found = measure_loop(hardware, ("left",))
    timing, loop = hardware.head.timing, found.loop()
    latency_s = found.latencies_s.get("left", float("nan"))
    near = abs(latency_s - timing.latency_s) < NEAR_S
    alike = abs(loop.lag_s / timing.lag_s - 1.0) < ALIKE
    return near and alike, (
        f"image latency {1e3 * latency_s:.1f} ms, emulated "
        f"{1e3 * timing.latency_s:.0f} +- {1e3 * NEAR_S:.0f} tolerated; joint lag "
        f"{1e3 * loop.lag_s:.1f} ms, emulated {1e3 * timing.lag_s:.0f} +- {ALIKE:.0%} tolerated"
    )


def replayed(log: Path) -> tuple[bool, str]:
    """Check that the law gives identical commands when replayed on its own log."""
    found = replay(ReplayConfig(log=log, controller=LAW))
    assert found.rerun is not None
    summary = found.rerun.summary()
    same, commands = summary["identical"], summary["commands"]
    whole = commands > 0 and len(found.gazes.trials) == GAZES
    return same == commands and whole, f"{same} of {commands} commands reproduced"


def tour(console: Console) -> int:
    """Run all steps; return the exit status."""
    found = Tour(console)
    begun_s = time.monotonic()
    with ExitStack() as stack:
        with console.status("emulated head"):
            hardware = stack.enter_context(emulated())
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        log = folder / "gazes.mcap"
        begun = f"head {hardware.head.name}, servos on a serial line"
        found.steps.append(Step("emulated head", True, begun, time.monotonic() - begun_s))
        if found.step("this machine", lambda: timed(hardware)) and found.step(
            "checks", lambda: checked(hardware)
        ):
            if found.step(f"{GAZES} gazes", lambda: gazed(hardware, log, console)):
                found.step("replay", lambda: replayed(log))
            found.step("measured loop", lambda: measured(hardware))
            found.step("pulled cable", lambda: hurt(hardware, folder / "fault.mcap"))
    console.print(found.table())
    return found.status


if __name__ == "__main__":
    try:
        sys.exit(tour(Console()))
    except KeyboardInterrupt:
        sys.exit(130)
