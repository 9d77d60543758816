"""Effects of line faults on servos' answers: damaged, cut short, late, lost or doubled."""

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from vergence.hardware.emulator.fault import Fault
from vergence.hardware.emulator.line import TimedAnswer

_SHORT_ANSWER_BYTES: Final = 6
"""Bytes left of an answer that is cut short: header, id, and half of the length (chosen)."""
_CRC_FLIPPED: Final = 0x01
"""Bits of the checksum's last byte that are flipped (chosen)."""


def apply_line_faults(
    answers: Sequence[TimedAnswer], faults: Iterable[Fault], rng: np.random.Generator
) -> list[tuple[float, bytes]]:
    """Apply the faults of the line to the answers to one request.

    Args:
        answers: the answers, in their order.
        faults: active faults of the line; each is drawn separately for every answer of its servos,
            in this order.
        rng: random generator of the draws.

    Returns:
        Pairs of the delay beyond the faultless time, s, and the bytes, earliest first; bytes with
        the same delay are joined.
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


def _damaged(fault_name: str, data: bytes) -> bytes:
    if fault_name == "bad-crc":
        return data[:-1] + bytes(byte ^ _CRC_FLIPPED for byte in data[-1:])
    if fault_name == "short":
        return data[:_SHORT_ANSWER_BYTES]
    return data + data if fault_name == "doubled" else b""
