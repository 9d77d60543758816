"""Messages of a log as JSON and back, without trust in what comes."""

import base64
import json
import reprlib
from contextlib import suppress
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.recording.schema import Form, Topic, shape

_MOST: Final = 1e15
"""Numbers beyond this are nobody's measurements, and their products overflow."""
_LATEST_S: Final = 2**33
"""Times of day before this are believed, s since 1970: some 270 years."""


def encode(message: dict[str, Any]) -> bytes:
    """A message of plain values and arrays as JSON."""
    return json.dumps({name: _plain(value) for name, value in message.items()}).encode()


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, float | np.ndarray | np.generic):
        array = np.asarray(value)
        if array.dtype.kind == "f":
            array = array.astype(object)
            array[~np.isfinite(np.asarray(value))] = None
        return array.ravel().tolist() if array.ndim else array.tolist()
    return value


def stamp(time_ns: int) -> dict[str, int]:
    """A time of day as Foxglove's schemas have it."""
    return {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}


def decode(topic: Topic, data: bytes) -> dict[str, Any]:
    """The fields of a message.

    Args:
        topic: of the message.
        data: JSON.

    Returns:
        Arrays, numbers where these have no axis, text, bytes, and ns since 1970.

    Raises:
        ConfigurationError: it is no JSON, or a field is missing or another than its form.
    """
    try:
        found = json.loads(data)
    except (ValueError, RecursionError, MemoryError) as error:
        raise ConfigurationError(f"{topic.name}: expected JSON, got {data[:40]!r}") from error
    if not isinstance(found, dict):
        raise ConfigurationError(f"{topic.name}: expected an object, got {_shown(found)}")
    fields = {}
    for name, form in topic.fields.items():
        fields[name] = _decoded(form, found.get(name))
        if fields[name] is None:
            raise ConfigurationError(
                f"{topic.name}: {name}: expected {_words(form)}, got {_shown(found.get(name))}"
            )
    return fields


def _decoded(form: Form, value: Any) -> Any:
    """A field, or None where the value is no such one."""
    if isinstance(form, np.ndarray):
        return _array(form, value)
    if form is str:
        return printable(value) if isinstance(value, str) else None
    if form is bytes:
        with suppress(TypeError, ValueError):
            return base64.b64decode(value, validate=True)
        return None
    sec, nsec = (value.get("sec"), value.get("nsec")) if isinstance(value, dict) else (None, None)
    if type(sec) is not int or type(nsec) is not int:
        return None
    return sec * 10**9 + nsec if abs(sec) < _LATEST_S and 0 <= nsec < 10**9 else None


def _array(form: NDArray[Any], value: Any) -> Any:
    items = value if isinstance(value, list) else [value]
    flat = isinstance(value, list) == bool(form.ndim)
    if flat and all(_is_of(form.dtype.kind, one) for one in items):
        with suppress(ValueError, OverflowError):  # another count, or beyond an integer's range
            found = np.array(value, dtype=form.dtype)
            found = found.reshape((-1, *form.shape[1:]) if 0 in form.shape else form.shape)
            return found if form.ndim else found.item()
    return None


def _is_of(kind: str, value: Any) -> bool:
    """Tell if JSON has a value that an array of a kind holds: Python takes true for 1, too."""
    if kind == "b" or isinstance(value, bool):
        return kind == "b" and isinstance(value, bool)
    if kind == "i":
        return isinstance(value, int)
    return value is None or (isinstance(value, int | float) and -_MOST <= value <= _MOST)


def _words(form: Form) -> str:
    """A form in words."""
    if not isinstance(form, np.ndarray):
        return "a text" if form is str else "base64" if form is bytes else "a time of day"
    kind = {"b": "true or false", "i": "a whole number"}.get(
        form.dtype.kind, f"a number up to {_MOST:g} in size, or null"
    )
    return f"{kind}, in the shape {shape(form)}" if form.ndim else kind


def printable(text: str) -> str:
    """A text in one line, without control characters."""
    return "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text)


def _shown(value: Any) -> str:
    """A value in an error's message, however long and deep it is."""
    return f"{reprlib.repr(value):.80}"
