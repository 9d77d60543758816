"""Search for the servos of an unknown line at each baud rate.

By default a broadcast ping asks all ids at once: each servo waits for its turn, at most 3 ms an id.
For adapters and servos that cannot handle this, ids are pinged one by one. A servo counts only at
the rate of its own BAUD_RATE register, as an emulated line answers at any rate.
"""

import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

from vergence.errors import HardwareError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import REQUESTS, Bus
from vergence.hardware.dynamixel.control_table import (
    REGISTER_SPANS,
    ServoMemory,
    describe_fault_bits,
    model_name,
)
from vergence.hardware.dynamixel.packets import (
    BROADCAST,
    MOST_ID,
    Instruction,
    PacketParser,
    instruction_packet,
)

ALL_BAUD_RATES: Final = (57_600, 1_000_000, *(set(table.BAUD_RATES) - {57_600, 1_000_000}))
"""All baud rates, first the factory default and the usual one (physical: Dynamixel X series)."""
_WAIT_PER_ID_S: Final = 3e-3
"""Longest wait of a servo per lower id, s (physical: ROBOTIS's SDK)."""
_STATUS_BYTES: Final = 14
"""Length of the answer to a ping, bytes (physical: Protocol 2.0)."""
_MODES: Final = {
    0: "current",
    1: "velocity",
    3: "position",
    4: "extended position",
    5: "current-based position",
    16: "PWM",
}
"""Names of the values of OPERATING_MODE."""


@dataclass(frozen=True, kw_only=True)
class FoundServo:
    """A servo that answered."""

    id: int
    """Id on the line."""
    baud_rate: int
    """Baud rate at which it answered, bit/s."""
    model_number: int
    """MODEL_NUMBER."""
    memory: ServoMemory | None
    """Its registers; None if it does not return them, or its model is not supported."""

    def row(self) -> list[str]:
        """Id, model, firmware, baud rate, mode, torque, volts, Celsius, position and faults."""
        known = [str(self.id), model_name(self.model_number)]
        if self.memory is None:
            return [*known, "", str(self.baud_rate), "", "", "", "", "", ""]
        get = self.memory.get
        mode = get(table.OPERATING_MODE)
        return [
            *known,
            str(get(table.FIRMWARE_VERSION)),
            str(self.baud_rate),
            _MODES.get(mode, str(mode)),
            "on" if get(table.TORQUE_ENABLE) else "off",
            f"{0.1 * get(table.PRESENT_INPUT_VOLTAGE):.1f}",
            str(get(table.PRESENT_TEMPERATURE)),
            str(get(table.PRESENT_POSITION)),
            describe_fault_bits(get(table.HARDWARE_ERROR_STATUS)) or "-",
        ]


@dataclass(frozen=True, kw_only=True)
class ScanResult:
    """Result of a search at all baud rates."""

    servos: list[FoundServo] = field(default_factory=list)
    """Servos by rate, then by id."""
    unsupported_rates: dict[int, str] = field(default_factory=dict)
    """Rates that this system cannot set, with the reason."""
    equal_ids: list[tuple[int, int]] = field(default_factory=list)
    """Ids that several servos have, each with its baud rate, bit/s."""
    damaged_packets: int = 0
    """Number of damaged packets: from two servos with one id, or noise."""


def scan_for_servos(
    port: str,
    *,
    baud_rates: Sequence[int] = ALL_BAUD_RATES,
    single_ping_ids: Iterable[int] | None = None,
    broadcast_wait_per_id_s: float = _WAIT_PER_ID_S,
    progress: Callable[[float], None] = lambda _done: None,
) -> ScanResult:
    """Ping for servos at each baud rate."""
    found: list[FoundServo] = []
    left_out: dict[int, str] = {}
    equal: list[tuple[int, int]] = []
    damaged = 0
    asked = None if single_ping_ids is None else list(single_ping_ids)
    for place, rate in enumerate(baud_rates):
        progress(place / len(baud_rates))
        try:
            bus = Bus(port, rate)
        except HardwareError as error:
            left_out[rate] = str(error)
            continue
        try:
            answered = asked or []
            if asked is None:
                answered, rejected = _everybody(bus, broadcast_wait_per_id_s)
                damaged += rejected
            for ident in answered:
                before = bus.damaged_packets
                servo = _found(bus, ident, rate)
                if servo is not None:
                    found.append(servo)
                # where nothing answers at this rate nothing is damaged either
                unread = servo is None or servo.memory is None
                if unread and bus.damaged_packets - before >= REQUESTS:
                    equal.append((ident, rate))
            damaged += bus.damaged_packets
        finally:
            bus.close()
    return ScanResult(
        servos=found, unsupported_rates=left_out, equal_ids=equal, damaged_packets=damaged
    )


def _everybody(bus: Bus, wait_per_id_s: float) -> tuple[list[int], int]:
    """Ids that answer a broadcast ping, and the number of damaged answers."""
    bus.line.drain()
    bus.line.send(instruction_packet(BROADCAST, Instruction.PING))
    wait_s = (MOST_ID + 1) * (wait_per_id_s + bus.line.wire_s(_STATUS_BYTES))
    until_s = time.monotonic() + wait_s
    parser = PacketParser()
    ids: set[int] = set()
    while data := bus.line.receive(until_s):
        ids |= {packet.id for packet in parser.feed(data) if packet.status is not None}
    return sorted(ids), parser.rejected


def _found(bus: Bus, ident: int, rate: int) -> FoundServo | None:
    model = bus.ping(ident, REQUESTS)
    if model is None:
        return None
    memory = None
    if model in table.MODELS:
        with suppress(HardwareError):  # it answers pings only
            memory = bus.read_memory(ident, REGISTER_SPANS[:1])
            if not _has_rate(memory, rate):
                return None
            memory = None  # servos of one id may agree in this span alone
            memory = bus.read_memory(ident)
    return FoundServo(id=ident, baud_rate=rate, model_number=model, memory=memory)


def _has_rate(memory: ServoMemory, rate: int) -> bool:
    number = memory.get(table.BAUD_RATE)
    return number >= len(table.BAUD_RATES) or table.BAUD_RATES[number] == rate
