"""What identifies a head: SHA-256 over its numbers, in a form that outlasts changes of the code.

Bundles of networks and tuned options name the head they are for by its digest, so the same head
must keep it. The form, version 1: part by part of `HeadModel` without its name, and in each part
field by field in alphabetical order, the ASCII text `part.field(shape)` and then the numbers as
little-endian float64. Fields have the names they had first, so a field that is renamed is
translated here; a field that came later has a default, and is left out where it has that value.
Whatever else would change the digest of a head needs a next version, and both at once. Names, of
heads, joints and actuators, are not part of it; other words stand as Python writes their tuple.

Translated: `timing.latency_s` is `timing.latency_frames`, control periods, where it is a whole
number of them.
"""

import dataclasses
import hashlib
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from vergence.models.parts import LoopTiming, is_names

FORM_VERSION: Final = 1
_WHOLE: Final = 1e-9
_WORDS: Final = ("name", "names", "assumptions")
"""What is for people to read."""


def digest_of(head: Any) -> str:
    """The digest of a head.

    Args:
        head: a dataclass whose fields are the head's name and its parts, each a dataclass of
            numbers or an array.

    Returns:
        64 hexadecimal digits.
    """
    sha = hashlib.sha256()
    for part in dataclasses.fields(head):
        if part.name in _WORDS or _is_later(part, getattr(head, part.name)):
            continue
        for field, value in _numbers(getattr(head, part.name)):
            if is_names(value):
                sha.update(f"{part.name}.{field}{value}".encode())
                continue
            array = np.asarray(value, dtype="<f8")
            sha.update(f"{part.name}.{field}{array.shape}".encode())
            sha.update(array.tobytes())
    return sha.hexdigest()


def _is_later(field: "dataclasses.Field[Any]", value: Any) -> bool:
    """Whether a field came after version 1 and has the value that a head had before it."""
    return field.default is not dataclasses.MISSING and np.array_equal(value, field.default)


def _numbers(part: Any) -> Iterator[tuple[str, Any]]:
    """Names and numbers of a part, as version 1 has them."""
    if not dataclasses.is_dataclass(part):
        yield "", part
        return
    for field in sorted(dataclasses.fields(part), key=lambda field: field.name):
        value = getattr(part, field.name)
        if field.name in _WORDS or _is_later(field, value):
            continue
        if isinstance(part, LoopTiming) and field.name == "latency_s":
            periods = part.latency_s * part.control_rate_hz
            if abs(periods - part.latency_frames) < _WHOLE:
                yield "latency_frames", part.latency_frames
                continue
        yield field.name, value
