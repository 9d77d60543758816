"""Values over the defaults of the experiments' configurations, as a user writes them."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vergence.errors import ConfigurationError
from vergence.eval.article.experiment import EXPERIMENTS


def read_overrides(path: Path | None, settings: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Overrides of configs from a TOML file and from `EXPERIMENT.FIELD=VALUE` words.

    Args:
        path: a TOML file with a table per experiment, or None.
        settings: words that go over it; a value is written as in TOML.

    Returns:
        Values by experiment and field.

    Raises:
        ConfigurationError: the file or a word cannot be read, or names no experiment.
    """
    overrides: dict[str, dict[str, Any]] = {}
    if path is not None:
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
            overrides[name] = dict(values)
    for word in settings:
        key, equals, text = word.partition("=")
        name, dot, option = key.strip().partition(".")
        if not (equals and dot and option):
            raise ConfigurationError(f"set: expected EXPERIMENT.FIELD=VALUE, got {word!r}")
        try:
            value = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            value = text.strip()
        overrides.setdefault(name, {})[option.replace("-", "_")] = value
    for name in overrides:
        if name not in EXPERIMENTS:
            raise ConfigurationError(
                f"config: expected one of {', '.join(EXPERIMENTS)}, got {name!r}"
            )
    return overrides
