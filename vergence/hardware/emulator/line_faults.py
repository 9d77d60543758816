"""What faults of the line make of servos' answers: damaged, cut short, late, lost or doubled."""

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from vergence.hardware.emulator.fault import Fault
from vergence.hardware.emulator.line import Answer

_KEPT: Final = 6
"""Bytes of an answer that is cut short: header, id, and half of the length."""
_CRC_FLIPPED: Final = 0x01
"""Bits of the checksum's last byte that are turned over."""


def damage(
    answers: Sequence[Answer], faults: Iterable[Fault], rng: np.random.Generator
) -> list[tuple[float, bytes]]:
    """What comes of answers.

    Args:
        answers: of one question, in their order.
        faults: those of the line that are on; each meets every answer of its servos by its own
            draw, in this order.
        rng: draws.

    Returns:
        By how much later than without a fault what is sent, in s, earliest first; what is sent at
        the same time is in one piece.
    """
    sent: dict[float, bytes] = {}
    faults = list(faults)
    for answer in answers:
        late_s, data = 0.0, answer.data
        for fault in faults:
            if answer.id not in fault.ids or rng.random() >= fault.probability:
                continue
            if fault.what == "late":
                late_s += fault.value
            else:
                data = _damaged(fault.what, data)
        if data:
            sent[late_s] = sent.get(late_s, b"") + data
    return sorted(sent.items())


def _damaged(what: str, data: bytes) -> bytes:
    if what == "bad-crc":
        return data[:-1] + bytes(byte ^ _CRC_FLIPPED for byte in data[-1:])
    if what == "short":
        return data[:_KEPT]
    return data + data if what == "doubled" else b""
