"""Read rows of named numbers from a JSON, CSV or TOML file."""

import csv
import io
import json
import tomllib
from pathlib import Path
from typing import Any, Final

from vergence.errors import ConfigurationError, UnreadableFileError

Row = dict[str, Any]
"""Values by their names."""
PAIR: Final = "pair"
"""Column that holds the name of a row's pair."""
_FORMATS: Final = "JSON, CSV or TOML (by its ending)"


def read_table_rows(path: Path) -> list[Row]:
    """Rows, at least one, of JSON or TOML (table, list, or tables by pair) or CSV (strings)."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UnreadableFileError(str(path), error.strerror or error, _FORMATS) from error
    except UnicodeDecodeError as error:
        raise UnreadableFileError(str(path), "no text in UTF-8", _FORMATS) from error
    kind = path.suffix.lower()
    rows: list[Any]
    try:
        if kind == ".csv":
            rows = _of_csv(text)
        elif kind in (".json", ".toml"):
            rows = _of_tables(json.loads(text) if kind == ".json" else tomllib.loads(text))
        else:
            raise ConfigurationError(f"{path}: expected {_FORMATS}, got the ending {kind!r}")
    except (ValueError, RecursionError, csv.Error) as error:
        raise ConfigurationError(
            f"{path}: expected {kind[1:].upper()}, got what cannot be read: {error!s:.200}"
        ) from error
    if not rows or not all(isinstance(row, dict) and row for row in rows):
        raise ConfigurationError(
            f"{path}: expected a row of joint angles for all pairs, or one for each with its "
            f"name as {PAIR!r}, got {'none' if not rows else 'something else'}"
        )
    return rows


def _of_csv(text: str) -> list[Row]:
    rows: list[Row] = []
    for row in csv.DictReader(io.StringIO(text), skipinitialspace=True):
        if None in row or None in row.values():
            raise ValueError(f"row {len(rows) + 1} has another number of values than the head")
        rows.append({name.strip(): value.strip() for name, value in row.items()})
    return rows


def _of_tables(content: Any) -> list[Any]:
    if isinstance(content, list):
        return content
    if not isinstance(content, dict):
        return []
    values = list(content.values())
    if len(values) == 1 and isinstance(values[0], list):
        return values[0]
    if values and all(isinstance(value, dict) for value in values):
        return [{PAIR: name, **value} for name, value in content.items()]
    return [content]
