"""User values that override the defaults of the experiments' configurations."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vergence.errors import ConfigurationError, did_you_mean
from vergence.eval.article.registry import EXPERIMENTS

Overrides = dict[str, dict[str, Any]]
"""Values by experiment and field; nested by field for a field that is a dataclass."""


def read_overrides(path: Path | None, settings: Sequence[str]) -> Overrides:
    """Read overrides from a TOML file and from `EXPERIMENT.FIELD=VALUE` words.

    Args:
        path: a TOML file with a table per experiment, or None.
        settings: words that override the file; values are written as in TOML, text also unquoted.

    Returns:
        Values by experiment and field.

    Raises:
        ConfigurationError: the file or a word cannot be read, or names no experiment.
    """
    overrides = {} if path is None else _read_file(path)
    for word in settings:
        key, equals, text = word.partition("=")
        name, *fields = (part.strip() for part in key.split("."))
        if not (equals and name and fields and all(fields)):
            raise ConfigurationError(f"set: expected EXPERIMENT.FIELD=VALUE, got {word!r}")
        place: Any = overrides.setdefault(name, {})
        for field in fields[:-1]:
            place = place.setdefault(field.replace("-", "_"), {})
            if not isinstance(place, dict):
                raise ConfigurationError(
                    f"set: expected a field with fields of its own for {word!r}, got {place!r}"
                )
        place[fields[-1].replace("-", "_")] = _read_value(text)
    for name in overrides:
        if name not in EXPERIMENTS:
            raise ConfigurationError(
                f"config: expected one of {', '.join(EXPERIMENTS)}, got {name!r}"
                f"{did_you_mean(name, EXPERIMENTS)}"
            )
    return overrides


def _read_file(path: Path) -> Overrides:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigurationError(
            f"config: expected a readable TOML file, got {path}: {error}"
        ) from error
    for name, values in content.items():
        if not isinstance(values, dict):
            raise ConfigurationError(
                f"config: expected tables named after experiments, got {name} = {values!r}"
            )
    return content


def _read_value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text.strip()
