"""Reading protobuf messages by a schema that says all that may stand in them.

A network from somewhere else is untrusted input. This reader knows no field that its schema does
not name, takes no singular field twice (where libraries disagree about which one counts), and
makes nothing but numbers, text and bytes.
"""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

MAX_FIELDS: Final = 20_000
"""Fields that one file may have in all."""

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5


class WireError(ValueError):
    """Bytes that are not a message of the schema."""


@dataclass(frozen=True)
class Field:
    """One field of a message.

    Attributes:
        name: its name in the decoded message.
        kind: what it holds; a mapping is the schema of a nested message.
        repeated: whether it may come more than once; it decodes to a list then.
    """

    name: str
    kind: "Literal['int', 'float', 'text', 'bytes', 'skipped'] | Mapping[int, Field]"
    repeated: bool = False


Schema = Mapping[int, Field]


def decode(data: bytes, schema: Schema) -> dict[str, Any]:
    """Read one message.

    Args:
        data: the message.
        schema: its fields by number.

    Returns:
        Values by field name: missing singular fields are left out, missing repeated ones are
        empty lists, skipped ones never appear.

    Raises:
        WireError: the bytes are no such message.
    """
    return _message(memoryview(data), schema, _Budget())


class _Budget:
    """Counts fields over all messages of a file."""

    def __init__(self) -> None:
        self.left = MAX_FIELDS

    def spend(self) -> None:
        self.left -= 1
        if self.left < 0:
            raise WireError(f"expected at most {MAX_FIELDS} fields, got more")


def _message(data: memoryview, schema: Schema, budget: _Budget) -> dict[str, Any]:
    message: dict[str, Any] = {field.name: [] for field in schema.values() if field.repeated}
    for number, wire, raw in _fields(data, budget):
        field = schema.get(number)
        if field is None:
            raise WireError(f"expected the fields {_names(schema)}, got field number {number}")
        if field.kind == "skipped":
            continue
        if field.repeated:
            message[field.name].extend(_values(field, wire, raw, budget))
            continue
        if field.name in message:
            raise WireError(f"expected {field.name} once, got it twice")
        message[field.name] = _value(field, wire, raw, budget)
    return message


def _names(schema: Schema) -> str:
    return ", ".join(field.name for field in schema.values())


def _fields(data: memoryview, budget: _Budget) -> Iterator[tuple[int, int, Any]]:
    at = 0
    while at < len(data):
        budget.spend()
        key, at = _varint(data, at)
        number, wire = key >> 3, key & 7
        value: int | memoryview
        if wire == _VARINT:
            value, at = _varint(data, at)
        elif wire in (_FIXED32, _FIXED64):
            size = 4 if wire == _FIXED32 else 8
            value, at = _slice(data, at, size)
        elif wire == _BYTES:
            size, at = _varint(data, at)
            value, at = _slice(data, at, size)
        else:
            raise WireError(f"expected a wire type of protobuf 3, got {wire}")
        yield number, wire, value


def _slice(data: memoryview, at: int, size: int) -> tuple[memoryview, int]:
    if size > len(data) - at:
        raise WireError(f"expected {size} more bytes, got {len(data) - at}")
    return data[at : at + size], at + size


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(data):
            raise WireError("expected the rest of a number, got the end")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if not byte & 0x80:
            if value >= 2**64:
                break
            return value, at
    raise WireError("expected a number of at most 64 bits, got a longer one")


def _signed(value: int) -> int:
    return value - 2**64 if value >= 2**63 else value


def _values(field: Field, wire: int, raw: Any, budget: _Budget) -> list[Any]:
    if field.kind == "int" and wire == _BYTES:  # packed
        values, at = [], 0
        while at < len(raw):
            budget.spend()
            value, at = _varint(raw, at)
            values.append(_signed(value))
        return values
    if field.kind == "float" and wire == _BYTES:
        if len(raw) % 4:
            raise WireError(f"expected {field.name} of 4 bytes each, got {len(raw)} bytes")
        return list(struct.unpack(f"<{len(raw) // 4}f", raw))
    return [_value(field, wire, raw, budget)]


def _value(field: Field, wire: int, raw: Any, budget: _Budget) -> Any:
    kind = field.kind
    expected = {"int": _VARINT, "float": _FIXED32}.get(kind, _BYTES) if isinstance(kind, str) else 2
    if wire != expected:
        raise WireError(f"expected {field.name} with wire type {expected}, got {wire}")
    if not isinstance(kind, str):
        return _message(raw, kind, budget)
    if kind == "int":
        return _signed(raw)
    if kind == "float":
        return struct.unpack("<f", raw)[0]
    if kind == "text":
        try:
            return str(raw, "utf-8")
        except UnicodeDecodeError as error:
            raise WireError(f"expected {field.name} in UTF-8, got {bytes(raw[:16])!r}") from error
    return bytes(raw)
