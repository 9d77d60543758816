"""The servos of an unknown line, found at each baud rate.

All ids are asked at once, by a ping to everybody: each servo waits for its turn, 3 ms an id at
most. Adapters and servos that do not take that well are asked id by id. A servo counts at the rate
that its own BAUD_RATE names, as an emulated line answers at any.
"""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

from vergence.errors import HardwareError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.dynamixel.packets import (
    BROADCAST,
    MOST_ID,
    Instruction,
    Parser,
    instruction_packet,
)
from vergence.hardware.servo_memory import ServoMemory, read_memory

RATES: Final = (57_600, 1_000_000, *(set(table.BAUD_RATES) - {57_600, 1_000_000}))
"""All rates, those of the factory and of most robots first."""
_TURN_S: Final = 3e-3
"""Most that a servo waits per id before its own, after ROBOTIS's SDK, s."""
_STATUS_BYTES: Final = 14
"""Bytes of the answer to a ping."""


@dataclass(frozen=True, kw_only=True)
class FoundServo:
    """A servo that answered."""

    id: int
    """On the line."""
    baud_rate: int
    """At which it answered, bit/s."""
    model: int
    """MODEL_NUMBER."""
    memory: ServoMemory | None
    """Its registers; None where it does not tell them, or is of another kind."""


@dataclass(frozen=True, kw_only=True)
class Scan:
    """The outcome at all baud rates."""

    servos: list[FoundServo] = field(default_factory=list)
    """By rate, then by id."""
    left_out: dict[int, str] = field(default_factory=dict)
    """Rates that this system cannot set, and why."""
    damaged: int = 0
    """Answers that were no packets: two servos with one id, or noise."""


def scan(
    port: str,
    *,
    rates: Sequence[int] = RATES,
    ids: Iterable[int] | None = None,
    turn_s: float = _TURN_S,
    report: Callable[[float], None] = lambda _done: None,
) -> Scan:
    """Ask for servos at each baud rate.

    Args:
        port: the line, which can be opened.
        rates: bit/s.
        ids: asked one by one; None asks all at once.
        turn_s: wait per id where all are asked at once, s.
        report: called with the share that is done.

    Raises:
        HardwareError: the line is gone.
    """
    found: list[FoundServo] = []
    left_out: dict[int, str] = {}
    damaged = 0
    asked = None if ids is None else list(ids)
    for place, rate in enumerate(rates):
        report(place / len(rates))
        try:
            bus = Bus(port, rate)
        except HardwareError as error:
            left_out[rate] = str(error)
            continue
        try:
            answered = asked or []
            if asked is None:
                answered, rejected = _everybody(bus, turn_s)
                damaged += rejected
            servos = [_found(bus, ident, rate) for ident in answered]
            found += [servo for servo in servos if servo is not None]
            damaged += bus.damaged
        finally:
            bus.close()
    return Scan(servos=found, left_out=left_out, damaged=damaged)


def _everybody(bus: Bus, turn_s: float) -> tuple[list[int], int]:
    """Ids that answer to a ping to all, and the number of damaged answers."""
    bus.line.drain()
    bus.line.send(instruction_packet(BROADCAST, Instruction.PING))
    wait_s = (MOST_ID + 1) * (turn_s + bus.line.wire_s(_STATUS_BYTES))
    until_s = time.monotonic() + wait_s
    parser = Parser()
    ids: set[int] = set()
    while data := bus.line.receive(until_s):
        ids |= {packet.id for packet in parser.feed(data) if packet.status is not None}
    return sorted(ids), parser.rejected


def _found(bus: Bus, ident: int, rate: int) -> FoundServo | None:
    model = bus.ping(ident)
    if model is None:
        return None
    memory = None
    if model in table.MODELS:
        try:
            memory = read_memory(bus, ident)
        except HardwareError:  # it answers to pings alone
            memory = None
    if memory is not None and not _has_rate(memory, rate):
        return None
    return FoundServo(id=ident, baud_rate=rate, model=model, memory=memory)


def _has_rate(memory: ServoMemory, rate: int) -> bool:
    number = memory.get(table.BAUD_RATE)
    return number >= len(table.BAUD_RATES) or table.BAUD_RATES[number] == rate
