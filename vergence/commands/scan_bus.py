"""`vergence scan-bus`: find the servos on a serial line, at any baud rate."""

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final

import tyro

from vergence.commands.console import print_to_stderr, progress_bar
from vergence.commands.tables import print_table
from vergence.errors import ConfigurationError

if TYPE_CHECKING:
    from vergence.hardware.dynamixel.scan import ScanResult

_COLUMNS: Final = (
    *("id", "model", "firmware", "baud", "mode", "torque", "V", "C", "position"),
    "latched fault",
)
_NO_ANSWER_REASONS: Final = (
    "is the servos' power switched on? The adapter's USB does not feed them",
    "is the data cable in, and the ground of supply and adapter the same?",
    "is it an adapter for these servos: TTL (3 wires) or RS-485 (4 wires)?",
    "do they speak Protocol 2.0? AX and MX from the factory speak 1.0, which ROBOTIS's Dynamixel "
    "Wizard can change in MX",
)
_MAX_SERVO_ID: Final = 252
"""Largest id of a servo (physical: Dynamixel Protocol 2.0)."""


@dataclass(frozen=True, kw_only=True)
class ScanBus:
    """Find the servos on a serial line: ping at every baud rate and list those that answer."""

    port: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="PORT")]
    """Device of the line, such as /dev/ttyUSB0."""
    ids: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="A-B")] = None
    """Ids to ping one by one, such as 0-20 or 7; by default one broadcast ping."""

    def run(self) -> int:
        """Run the command."""
        ids = _ids(self.ids)
        from vergence.hardware.dynamixel.checks import check_latency_timer, open_bus
        from vergence.hardware.dynamixel.scan import scan_for_servos

        # reports a port that cannot be opened once, not for each rate
        open_bus(self.port, 57_600).close()
        with progress_bar("scan-bus") as report:
            found = scan_for_servos(self.port, single_ping_ids=ids, progress=report)
        for rate, why in found.unsupported_rates.items():
            print_to_stderr(f"{rate} baud was left out: {why}")
        latency = check_latency_timer(self.port)
        if latency is not None:
            print_to_stderr(f"warning: {latency}")
        if not found.servos:
            _say_nobody(self.port, found)
            return 1
        print_table(_COLUMNS, [servo.row() for servo in found.servos], wrapped=(1, 4, 9))
        for ident, rate in found.equal_ids:
            print_to_stderr(
                f"error: id {ident}: expected one servo at {rate} baud, got two or more, whose "
                "answers damage each other: plug in one alone and give it another id"
            )
        return int(bool(found.equal_ids))


def _ids(text: str | None) -> range | None:
    if text is None:
        return None
    ends = re.fullmatch(r"(\d{1,3})(?:-(\d{1,3}))?", text)
    if ends is not None:
        ids = range(int(ends[1]), int(ends[2] or ends[1]) + 1)
        if ids and ids[-1] <= _MAX_SERVO_ID:
            return ids
    raise ConfigurationError(
        f"ids: expected A-B or A within 0 to {_MAX_SERVO_ID}, got {text!r:.80}"
    )


def _say_nobody(port: str, found: "ScanResult") -> None:
    if found.damaged_packets:
        print_to_stderr(
            f"error: {port}: expected servos, got {found.damaged_packets} damaged answers: "
            "servos with "
            "one id talk at once (plug in one alone and give it another id), or the cable is bad"
        )
        return
    print_to_stderr(f"error: {port}: expected servos, got no answer at any baud rate")
    for reason in _NO_ANSWER_REASONS:
        print_to_stderr(f"error: {reason}")
