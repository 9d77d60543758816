"""The values behind the keys of a head's `[assumptions]`, in units that people use."""

from collections.abc import Iterable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.head_file import document_of_head

_UNITS: Final[tuple[tuple[str, float, str], ...]] = (
    ("_rad_s2", 1.0, "rad/s^2"),
    ("_rad_s", 180.0 / np.pi, "deg/s"),
    ("_rad", 180.0 / np.pi, "deg"),
    ("_hz", 1.0, "Hz"),
    ("_px", 1.0, "px"),
    ("_s", 1e3, "ms"),
    ("_m", 1e3, "mm"),
)
"""Suffix of a key, factor from its SI unit to the unit shown, and the name of the unit shown."""
_MAX_SHOWN_VALUES: Final = 3
"""Most different values of several tables that are written out (chosen: keeps the text short)."""


class AssumedValue(NamedTuple):
    """A value that a head file assumes rather than measures."""

    keys: tuple[str, ...]
    """Keys that share the value and the reason."""
    value: str
    """Value with its unit; empty if the file has no such key."""
    reason: str
    """Reason for the assumption."""


def assumed_values(head: HeadModel) -> list[AssumedValue]:
    """List the assumptions of a head with their values."""
    document = document_of_head(head)
    found: dict[tuple[str, str], list[str]] = {}
    for key, why in head.assumptions.items():
        found.setdefault((_value(document, key), why), []).append(key)
    return [AssumedValue(tuple(keys), value, why) for (value, why), keys in found.items()]


def _value(document: dict[str, Any], key: str) -> str:
    """Text of the value at a dotted key; several values if several tables have the field."""
    values: list[Any] = [document]
    parts = key.split(".")
    if parts[-1] == "origin_m":  # its axes are the written form's, not the user's
        return ""
    for part in parts:
        values = [found for value in values for found in _step(value, part)]
    if not values and len(parts) == 1:  # a field of no table in particular
        tables = [
            table for value in document.values() if isinstance(value, list) for table in value
        ]
        values = list(_step(tables, key))
    texts = list(dict.fromkeys(_text(parts[-1], value) for value in values))
    if len(texts) > _MAX_SHOWN_VALUES:
        return f"{'; '.join(texts[:_MAX_SHOWN_VALUES])}; ..."
    return "; ".join(texts)


def _step(value: Any, part: str) -> Iterable[Any]:
    """Values at a part of a dotted key: a field, a table by its name, or a field of all tables."""
    if isinstance(value, dict):
        return [value[part]] if part in value else []
    if isinstance(value, list) and all(isinstance(table, dict) for table in value):
        named = [table for table in value if table.get("name") == part]
        return named or [table[part] for table in value if part in table]
    return []


def _text(key: str, value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(
            f"{label_without_unit(field)} {_text(field, own)}" for field, own in value.items()
        )
    factor, unit = next(((f, u) for end, f, u in _UNITS if key.endswith(end)), (1.0, ""))
    numbers = _flat_numbers(value)
    if not numbers:
        return str(value)
    return f"{', '.join(f'{factor * number:.4g}' for number in numbers)} {unit}".rstrip()


def label_without_unit(field: str) -> str:
    """A key without its unit suffix, underscores replaced by spaces."""
    end = next((end for end, _, _ in _UNITS if field.endswith(end)), "")
    return field.removesuffix(end).replace("_", " ")


def _flat_numbers(value: Any) -> Sequence[float]:
    if isinstance(value, list):
        return [number for part in value for number in _flat_numbers(part)]
    return [value] if isinstance(value, int | float) else []
