"""Options found by `vergence tune`, kept as data by controller and scenario."""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import tomli_w

from vergence.errors import ConfigurationError
from vergence.files import write_whole

TUNED_FILE: Final = Path(__file__).with_name("tuned.toml")
"""The table that ships with the package."""

_HEADER: Final = """\
# Options of controllers by scenario, `[controller.scenario]`, with the command and the seed that
# found them. Written by `vergence.controllers.tuned.write_tuned`; `provisional` marks an entry
# that has not come out of a whole run of `vergence tune` yet.
"""


_SECTION: Final = {"ibvs-tuned": "ibvs"}


@dataclass(frozen=True, kw_only=True)
class Tuned:
    """One entry of the table."""

    options: dict[str, Any]
    """The controller's options."""
    command: str
    """The command that found them."""
    seed: int
    """Its seed."""
    provisional: bool = False
    """Whether they have not come out of a whole run of `vergence tune` yet."""


def load_tuned(path: Path = TUNED_FILE) -> dict[str, dict[str, Tuned]]:
    """A table of tuned options.

    Args:
        path: the TOML file.

    Returns:
        Entries by controller and scenario.

    Raises:
        ConfigurationError: the file is not such a table.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigurationError(
            f"{path}: expected a table of tuned options: {error.strerror}"
        ) from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigurationError(f"{path}: expected a TOML file, got {error}") from error
    table: dict[str, dict[str, Tuned]] = {}
    for controller, scenarios in content.items():
        if not isinstance(scenarios, dict):
            raise ConfigurationError(f"{path}: {controller}: expected scenarios, got {scenarios!r}")
        table[controller] = {
            scenario: _entry(f"{path}: {controller}.{scenario}", fields)
            for scenario, fields in scenarios.items()
        }
    return table


def _entry(key: str, fields: Any) -> Tuned:
    known: dict[str, type] = {"options": dict, "command": str, "seed": int, "provisional": bool}
    fields = {"provisional": False, **fields} if isinstance(fields, dict) else fields
    if (
        not isinstance(fields, dict)
        or fields.keys() != known.keys()
        or not all(type(fields[name]) is kind for name, kind in known.items())
    ):
        raise ConfigurationError(f"{key}: expected options, command and seed, got {fields!r}")
    return Tuned(**fields)


@cache
def shipped() -> dict[str, dict[str, Tuned]]:
    """The table that ships with the package: entries by controller and scenario."""
    return load_tuned()


def tuned_options(name: str, scenario: str) -> dict[str, Any]:
    """The options with which a controller does best in a scenario.

    Args:
        name: the controller. `ibvs` has none: it stands for the article's constant gain, and
            `ibvs-tuned` for the best one.
        scenario: the scenario.

    Returns:
        Options for `make_controller`; empty where nothing has been found.
    """
    if name == "ibvs":
        return {}
    entries = shipped().get(_SECTION.get(name, name), {})
    if scenario not in entries:
        return {}
    return {"scenario": scenario} if name in _SECTION else dict(entries[scenario].options)


def write_tuned(
    path: Path,
    controller: str,
    scenario: str,
    options: Mapping[str, Any],
    command: str,
    seed: int,
    *,
    provisional: bool = False,
) -> None:
    """Put one entry into a table; the file is made where there is none, and replaced whole.

    Args:
        path: the TOML file.
        controller: the controller's name; `ibvs-tuned` and `ibvs` share their entries.
        scenario: the scenario's name.
        options: numbers, lists of numbers and words, by option.
        command: the command that found them.
        seed: its seed.
        provisional: whether a whole run of `vergence tune` is still to come.

    Raises:
        ConfigurationError: an option is no such value, or the file cannot be read or written.
    """
    entry = Tuned(
        options={key: _plain(f"{controller}.{scenario}.{key}", v) for key, v in options.items()},
        command=command,
        seed=int(seed),
        provisional=provisional,
    )
    table = load_tuned(path) if path.exists() else {}
    table.setdefault(_SECTION.get(controller, controller), {})[scenario] = entry
    content = {
        name: {key: _fields(entry) for key, entry in sorted(entries.items())}
        for name, entries in sorted(table.items())
    }
    try:
        write_whole(path, _HEADER + "\n" + tomli_w.dumps(content))
    except OSError as error:
        raise ConfigurationError(
            f"{path}: expected a file that can be written: {error.strerror}"
        ) from error
    shipped.cache_clear()


def _fields(entry: Tuned) -> dict[str, Any]:
    return {name: value for name, value in vars(entry).items() if value is not False}


def _plain(key: str, value: Any) -> Any:
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(key, item) for item in value]
    if isinstance(value, str | bool | int) or (isinstance(value, float) and math.isfinite(value)):
        return value
    raise ConfigurationError(f"{key}: expected finite numbers, lists or words, got {value!r}")
