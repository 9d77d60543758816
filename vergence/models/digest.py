"""Digest of a head: SHA-256 over its numbers, in a form that is stable across code changes.

Bundles of networks and tuned options name their head by its digest, so a head must keep its digest.
The form, version 1: for each part of `HeadModel`, and for each field of the part in alphabetical
order, the ASCII text `part.field(shape)`, then the numbers as little-endian float64. Fields keep
their first names here, so a renamed field is translated. A field added later has a default, and is
left out if it has the default value. Any other change of the digest needs a new version of the
form, and support for both versions at once. Names (of heads, joints and actuators), assumptions
and the calibration record are left out. Other strings are hashed as Python prints their tuple.

The poses of a `JointAxes` head are computed from the origins, axes and angles of its file by sines
and square roots, whose last bits differ between machines. They are rounded to 1e-12 (m, or elements
of a rotation), less than any two heads differ by.

Translations: `timing.latency_s` becomes `timing.latency_frames`, in control periods, if it is a
whole number of them. Two Brown-Conrady cameras with equal image sizes have `cameras.width` and
`cameras.height`; other pairs have `cameras.size`, and `cameras.lens` as the numbers in `_LENSES`.
Responses of cameras are hashed as Python prints their tuple.
"""

import dataclasses
import hashlib
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from vergence.models.cameras import BROWN_CONRADY, Cameras
from vergence.models.joint_axes import JointAxes
from vergence.models.parts import LoopTiming, is_name_tuple

FORM_VERSION: Final = 1
"""Version of the form described above (numerical)."""
_LENSES: Final = {BROWN_CONRADY: 1, "rational": 2, "fisheye": 3}
_WHOLE_PERIODS_TOLERANCE: Final = 1e-9
"""Tolerance for a whole number of control periods (numerical)."""
_ROUNDED_PARTS: Final = ("links", "head_eye")
_POSE_DECIMALS: Final = 12
"""Decimals that rounding keeps of a `JointAxes` head's poses (numerical)."""
_EXCLUDED: Final = ("name", "names", "assumptions", "calibration")
"""Fields for human readers, left out of the digest."""


def digest_of(head: Any) -> str:
    """64 hexadecimal digits for a dataclass of the head's name and its parts."""
    sha = hashlib.sha256()
    by_axes = isinstance(getattr(head, "links", None), JointAxes)
    for part in dataclasses.fields(head):
        if part.name in _EXCLUDED or _is_later(part, getattr(head, part.name)):
            continue
        for field, value in _hashed_numbers(getattr(head, part.name)):
            if is_name_tuple(value) or isinstance(value, str):
                sha.update(f"{part.name}.{field}{value}".encode())
                continue
            array = np.asarray(value, dtype="<f8")
            if by_axes and part.name in _ROUNDED_PARTS:
                array = np.round(array, _POSE_DECIMALS) + 0.0  # without negative zeros
            sha.update(f"{part.name}.{field}{array.shape}".encode())
            sha.update(array.tobytes())
    return sha.hexdigest()


def _is_later(field: "dataclasses.Field[Any]", value: Any) -> bool:
    """True if a field was added after version 1 and has its default value."""
    return field.default is not dataclasses.MISSING and np.array_equal(value, field.default)


def _hashed_numbers(part: Any) -> Iterator[tuple[str, Any]]:
    """Names and numbers of a part in the form of version 1."""
    if not dataclasses.is_dataclass(part):
        yield "", part
        return
    values = {
        field.name: getattr(part, field.name)
        for field in dataclasses.fields(part)
        if field.name not in _EXCLUDED and not _is_later(field, getattr(part, field.name))
    }
    if isinstance(part, LoopTiming):
        _translate_timing(part, values)
    elif isinstance(part, Cameras):
        _translate_cameras(part, values)
    yield from sorted(values.items())


def _translate_timing(timing: LoopTiming, values: dict[str, Any]) -> None:
    periods = timing.latency_s * timing.control_rate_hz
    if abs(periods - timing.latency_frames) < _WHOLE_PERIODS_TOLERANCE:
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
