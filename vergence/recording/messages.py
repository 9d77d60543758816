"""Conversion of log messages to JSON and back; the JSON is untrusted."""

import base64
import json
import reprlib
from contextlib import suppress
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.recording.schema import Form, Topic, shape_text

_MAX_NUMBER: Final = 1e15
"""Largest absolute value of a number (chosen: above any measurement, and products stay finite)."""
_MAX_UNIX_TIME_S: Final = 2**33
"""Upper limit of times of day, s since 1970: some 270 years (chosen)."""


def encode_message(message: dict[str, Any]) -> bytes:
    """Encode a message of plain values and arrays as JSON."""
    return json.dumps({name: _json_value(value) for name, value in message.items()}).encode()


def _json_value(value: Any) -> Any:
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, float | np.ndarray | np.generic):
        array = np.asarray(value)
        if array.dtype.kind == "f":
            array = array.astype(object)
            array[~np.isfinite(np.asarray(value))] = None
        return array.ravel().tolist() if array.ndim else array.tolist()
    return value


def foxglove_time(time_ns: int) -> dict[str, int]:
    """A time of day, ns since 1970, in the form of Foxglove's schemas."""
    return {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}


def decode_message(topic: Topic, data: bytes) -> dict[str, Any]:
    """Decode the fields of a message.

    Args:
        topic: topic of the message.
        data: JSON.

    Returns:
        Values by field: arrays, numbers for arrays without axes, text, bytes, or ns since 1970.

    Raises:
        ConfigurationError: the data is no JSON object, or a field is missing or does not match its
            form.
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
    """Decode a field; None if the value does not match the form."""
    if isinstance(form, np.ndarray):
        return _array(form, value)
    if form is str:
        return escape_control_characters(value) if isinstance(value, str) else None
    if form is bytes:
        with suppress(TypeError, ValueError):
            return base64.b64decode(value, validate=True)
        return None
    sec, nsec = (value.get("sec"), value.get("nsec")) if isinstance(value, dict) else (None, None)
    if type(sec) is not int or type(nsec) is not int:
        return None
    return sec * 10**9 + nsec if abs(sec) < _MAX_UNIX_TIME_S and 0 <= nsec < 10**9 else None


def _array(form: NDArray[Any], value: Any) -> Any:
    items = value if isinstance(value, list) else [value]
    flat = isinstance(value, list) == bool(form.ndim)
    if flat and all(_is_of(form.dtype.kind, one) for one in items):
        with suppress(ValueError, OverflowError):  # wrong number of items, or integer out of range
            found = np.array(value, dtype=form.dtype)
            found = found.reshape((-1, *form.shape[1:]) if 0 in form.shape else form.shape)
            return found if form.ndim else found.item()
    return None


def _is_of(kind: str, value: Any) -> bool:
    """True if a JSON value fits an array's kind; booleans are not accepted as numbers."""
    if kind == "b" or isinstance(value, bool):
        return kind == "b" and isinstance(value, bool)
    if kind == "i":
        return isinstance(value, int)
    return value is None or (
        isinstance(value, int | float) and -_MAX_NUMBER <= value <= _MAX_NUMBER
    )


def _words(form: Form) -> str:
    """A form in words, for error messages."""
    if not isinstance(form, np.ndarray):
        return "a text" if form is str else "base64" if form is bytes else "a time of day"
    kind = {"b": "true or false", "i": "a whole number"}.get(
        form.dtype.kind, f"a number up to {_MAX_NUMBER:g} in size, or null"
    )
    return f"{kind}, in the shape {shape_text(form)}" if form.ndim else kind


def escape_control_characters(text: str) -> str:
    """Escape control characters, so that the text stays in one line."""
    return "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text)


def _shown(value: Any) -> str:
    """Abbreviate a value for an error message."""
    return f"{reprlib.repr(value):.80}"
