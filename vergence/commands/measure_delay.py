"""`vergence measure-delay`: measure a robot's control loop and write it into its configuration."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from vergence import interrupts
from vergence.commands.checks import check_robot_and_print
from vergence.commands.console import print_to_stderr, progress_bar
from vergence.commands.extras import require_modules
from vergence.commands.tables import print_table
from vergence.errors import ConfigurationError, HardwareError
from vergence.files import atomic_file

if TYPE_CHECKING:
    from vergence.hardware.delay.measure import LoopMeasurement


@dataclass(frozen=True, kw_only=True)
class MeasureDelay:
    """Measure latencies and lag of a robot's loop: each eye in turn moves about a fixed target."""

    hardware: Annotated[Path, tyro.conf.arg(name="config", metavar="PATH")]
    """TOML file that describes the robot (see docs/robot.md); receives the results."""
    eye: Literal["both", "left", "right"] = "both"
    """Eyes to measure the loop of."""
    actuator: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="NAME")] = None
    """Actuator to turn; by default the one that moves an eye's image most."""
    view_check: bool = True
    """Compare the images with the configuration first, while each joint turns by 0.1 rad."""
    write: bool = True
    """Write the results into the file: the cameras' latency_s and the table [loop]."""
    json: bool = False
    """Print the result as JSON, and nothing else, on standard output."""

    def run(self) -> int:
        """Run the command."""
        if self.write:
            require_modules("robot", "tomlkit")
        from vergence.hardware.config import load_hardware, write_loop
        from vergence.hardware.delay.measure import actuator_slot, measure_loop
        from vergence.models.parts import EYE_NAMES

        hardware = load_hardware(self.hardware)
        if self.write:
            with self._writing(), atomic_file(self.hardware):
                pass  # refuses a read-only file before anything moves; writes nothing
        eyes = EYE_NAMES if self.eye == "both" else (self.eye,)
        for eye in eyes:  # refuses a wrong actuator before the robot is checked
            actuator_slot(hardware.head, EYE_NAMES.index(eye), self.actuator)
        check_robot_and_print(hardware)
        interrupts.raise_on_termination()
        try:
            with progress_bar("measure") as report:
                measurement = measure_loop(
                    hardware, eyes, report, self.actuator, view_check=self.view_check
                )
        except HardwareError:
            print_to_stderr(f"{self.hardware} stays as it was")
            raise
        if self.json:
            print(json.dumps(_as_json(measurement), indent=2, allow_nan=False))
        else:
            _print(measurement)
        if self.write:
            with self._writing():
                write_loop(self.hardware, measurement.loop(), measurement.latencies_s)
            cameras = "".join(f"cameras.{name}.latency_s, " for name in measurement.latencies_s)
            print_to_stderr(f"written to {self.hardware}: {cameras}[loop]")
        return 0

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise ConfigurationError(
                f"config: expected a file that can be written, got {self.hardware}: "
                f"{error.strerror}"
            ) from error


def _as_json(measurement: "LoopMeasurement") -> dict[str, object]:
    return {
        "rows": measurement.rows(),
        "untold": measurement.undetermined(),
        "doubts": measurement.misfits(),
    }


def _print(measurement: "LoopMeasurement") -> None:
    rows = [
        [
            row["eye"],
            row["actuator"],
            row["what"],
            _number(row["value"]),
            "" if row["sigma"] is None else f"+- {_number(row['sigma'])}",
            row["unit"],
        ]
        for row in measurement.rows()
    ]
    print_table(["eye", "actuator", "", "value", "", "unit"], rows)
    for line in measurement.undetermined():
        print(f"not determined: {line}")
    for line in measurement.misfits():
        print(f"doubtful: {line}")


def _number(value: float | None) -> str:
    return "not determined" if value is None else f"{value:.3g}"
