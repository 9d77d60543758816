"""What identifies a head: SHA-256 over its numbers, in a form that outlasts changes of the code.

Bundles of networks and tuned options name the head they are for by its digest, so the same head
must keep it. The form, version 1: part by part of `HeadModel` without its name, and in each part
field by field in alphabetical order, the ASCII text `part.field(shape)` and then the numbers as
little-endian float64. Fields have the names they had first, so a field that is renamed is
translated here; a field that came later has a default, and is left out where it has that value.
Whatever else would change the digest of a head needs a next version, and both at once. Names, of
heads, joints and actuators, are not part of it; other words stand as Python writes their tuple.

Poses of a head by its axes follow from origins, axes and angles of its file by sines and roots,
whose last bits differ from machine to machine: they are rounded to 1e-12 (m, or elements of a
rotation), below what any two heads differ by.

Translated: `timing.latency_s` is `timing.latency_frames`, control periods, where it is a whole
number of them. Two Brown-Conrady cameras with images of one size have `cameras.width` and
`cameras.height`; others have `cameras.size`, and `cameras.lens` by the numbers of `_LENSES`.
Responses of cameras stand as Python writes their tuple.
"""

import dataclasses
import hashlib
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from vergence.models.cameras import BROWN_CONRADY, Cameras
from vergence.models.joint_axes import JointAxes
from vergence.models.parts import LoopTiming, is_names

FORM_VERSION: Final = 1
_LENSES: Final = {BROWN_CONRADY: 1, "rational": 2, "fisheye": 3}
_WHOLE: Final = 1e-9
_POSES: Final = ("links", "head_eye")
_DECIMALS: Final = 12
_WORDS: Final = ("name", "names", "assumptions", "calibration")
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
    by_axes = isinstance(getattr(head, "links", None), JointAxes)
    for part in dataclasses.fields(head):
        if part.name in _WORDS or _is_later(part, getattr(head, part.name)):
            continue
        for field, value in _numbers(getattr(head, part.name)):
            if is_names(value) or isinstance(value, str):
                sha.update(f"{part.name}.{field}{value}".encode())
                continue
            array = np.asarray(value, dtype="<f8")
            if by_axes and part.name in _POSES:
                array = np.round(array, _DECIMALS) + 0.0  # without negative zeros
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
    values = {
        field.name: getattr(part, field.name)
        for field in dataclasses.fields(part)
        if field.name not in _WORDS and not _is_later(field, getattr(part, field.name))
    }
    if isinstance(part, LoopTiming):
        _translate_timing(part, values)
    elif isinstance(part, Cameras):
        _translate_cameras(part, values)
    yield from sorted(values.items())


def _translate_timing(timing: LoopTiming, values: dict[str, Any]) -> None:
    periods = timing.latency_s * timing.control_rate_hz
    if abs(periods - timing.latency_frames) < _WHOLE:
        del values["latency_s"]
        values["latency_frames"] = timing.latency_frames


def _translate_cameras(cameras: Cameras, values: dict[str, Any]) -> None:
    if "response" in values:
        values["response"] = str(cameras.response)
    left, right = cameras.size.tolist()
    if left == right and set(cameras.lens) == {BROWN_CONRADY}:
        del values["size"]
        values["width"], values["height"] = left
    else:
        values["lens"] = [_LENSES[lens] for lens in cameras.lens]
