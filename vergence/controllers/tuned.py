"""Options found by `vergence tune`, stored by controller, scenario and digest of the head.

Two tables are read. The user's own comes first: `tuned.toml` in the user's data folder, or the file
that the environment variable `VERGENCE_TUNED` names. The other one ships with the package; it
covers each scenario's own head and the other presets. Options found on one plant serve on all.
"""

import dataclasses
import math
import os
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import platformdirs
import tomli_w

from vergence.errors import ConfigurationError
from vergence.files import atomic_file, hold_lock, write_atomic
from vergence.models.head import HeadModel

TUNED_FILE: Final = Path(__file__).with_name("tuned.toml")
"""Table that ships with the package."""
_SCENARIO_HEADS: Final = ("simulated", "physical")
"""Heads of the scenarios; their options are starting values for other heads."""
TUNED_VARIABLE: Final = "VERGENCE_TUNED"
"""Environment variable that names another file for the user's table."""

_HEADER: Final = """\
# Options of controllers, by controller, scenario and the digest of the head that they were found
# for, with the command and the seed that found them. Written by `vergence tune --write`;
# `provisional` marks an entry that has not come out of a whole run of `vergence tune` yet.
"""


class TunedKey(NamedTuple):
    """Lookup key of an entry; `digest` is the head's."""

    controller: str
    scenario: str
    digest: str


@dataclass(frozen=True, kw_only=True)
class TunedEntry:
    """Options tuned for a controller, scenario and head (its name and digest).

    The plant, the command and its random seed are those of the run that found them; `provisional`
    says that no complete run of `vergence tune` has yet.
    """

    controller: str
    scenario: str
    head: str
    digest: str
    plant: str = "kinematic"
    command: str
    seed: int
    provisional: bool = False
    options: dict[str, Any]

    @property
    def key(self) -> TunedKey:
        """Key under which tables hold the entry."""
        return TunedKey(self.controller, self.scenario, self.digest)


Table = dict[TunedKey, TunedEntry]
"""Entries by their keys."""


def name_in_tuned_table(controller: str) -> str:
    """Return the name under which tables store a controller's options: `ibvs` for `ibvs-tuned`."""
    return "ibvs" if controller == "ibvs-tuned" else controller


def name_for_evaluation(controller: str) -> str:
    """Return the name of the controller that uses tuned options: `ibvs-tuned` for `ibvs`."""
    return "ibvs-tuned" if controller == "ibvs" else controller


def user_table_path() -> Path:
    """Path of the user's table, whether it exists yet or not."""
    named = os.environ.get(TUNED_VARIABLE)
    if named:
        return Path(named)
    return platformdirs.user_data_path("vergence", appauthor=False) / "tuned.toml"


def load_tuned(path: Path = TUNED_FILE) -> Table:
    """Load the table of tuned options in a TOML file; `ConfigurationError` if it is none."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        said = f"expected a table of tuned options: {error.strerror}"
        raise ConfigurationError(f"{path}: {said}") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        said = f"expected a TOML file of tuned options, got {error}"
        raise ConfigurationError(f"{path}: {said}") from error
    entries = content.pop("tuned", [])
    if content or not isinstance(entries, list):
        wrong = next(iter(content), "tuned")
        raise ConfigurationError(f"{path}: {wrong}: expected entries [[tuned]] and nothing else")
    found = [_entry(f"{path}: entry {n}", fields) for n, fields in enumerate(entries, 1)]
    return {entry.key: entry for entry in found}


def _entry(where: str, fields: Any) -> TunedEntry:
    known = {field.name: field for field in dataclasses.fields(TunedEntry)}
    if not isinstance(fields, dict):
        raise ConfigurationError(f"{where}: expected a table, got {fields!r}")
    for name, field in known.items():
        if name not in fields and field.default is dataclasses.MISSING:
            raise ConfigurationError(f"{where}: expected {name}, got none")
    for name, value in fields.items():
        if name not in known:
            raise ConfigurationError(f"{where}: expected {', '.join(known)}, got {name!r}")
        kind = {"options": dict, "seed": int, "provisional": bool}.get(name, str)
        if type(value) is not kind:
            raise ConfigurationError(f"{where}: {name}: expected {kind.__name__}, got {value!r}")
    return TunedEntry(**fields)


@cache
def shipped_table() -> Table:
    """Load the table that ships with the package."""
    return load_tuned()


def user_table() -> Table:
    """Load the user's table; empty if there is none yet."""
    path = user_table_path()
    return load_tuned(path) if os.path.lexists(path) else {}


def check_table_writable(path: Path) -> None:
    """Refuse, before any work is done, a table that could not be written at the end."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path):
            pass  # nothing is written
    except OSError as error:
        raise _unwritable(path, error) from error


def _unwritable(path: Path, error: OSError) -> ConfigurationError:
    said = f"expected a file that can be written: {error.strerror or error}"
    return ConfigurationError(f"{path}: {said}")


def find_tuned_or_fallback(controller: str, scenario: str, head: HeadModel) -> TunedEntry | None:
    """Find the best known options of a controller in a scenario.

    Args:
        controller: the controller. `ibvs` has no entry: it stands for the article's constant gain,
            and `ibvs-tuned` for the best one.
        scenario: the scenario's name.
        head: the head.

    Returns:
        The entry of that head, from the user's table first, then the package's; otherwise the
        package's entry for another head, with values to start from (see `is_tuned_for`); None if
        there is none either.

    Raises:
        ConfigurationError: the user's table cannot be read.
    """
    if controller == "ibvs":
        return None
    key = TunedKey(name_in_tuned_table(controller), scenario, head.digest)
    own = user_table().get(key) or shipped_table().get(key)
    if own is not None:
        return own
    known = [one for one in shipped_table().values() if one.key[:2] == key[:2]]
    return min(known, key=lambda one: one.head not in _SCENARIO_HEADS, default=None)


def is_tuned_for(entry: TunedEntry | None, head: HeadModel) -> bool:
    """True if an entry was found for this head."""
    return entry is not None and entry.digest == head.digest


def tuned_or_fallback_options(controller: str, scenario: str, head: HeadModel) -> dict[str, Any]:
    """Return the options of `find_tuned_or_fallback` for `make_controller`; may be empty."""
    entry = find_tuned_or_fallback(controller, scenario, head)
    return {} if entry is None else dict(entry.options)


def write_tuned(path: Path, entry: TunedEntry) -> None:
    """Write one entry to a table, in place of one with the same key; processes may do so at once.

    Its options are numbers, lists of numbers and words. On a `ConfigurationError` the file stays as
    it was.
    """
    law = name_in_tuned_table(entry.controller)
    where = f"{law}.{entry.scenario}"
    options = {key: _toml_value(f"{where}.{key}", value) for key, value in entry.options.items()}
    entry = dataclasses.replace(entry, controller=law, seed=int(entry.seed), options=options)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with hold_lock(path, wait=True):
            table = load_tuned(path) if path.exists() else {}
            table[entry.key] = entry
            content = {"tuned": [_fields(table[key]) for key in sorted(table)]}
            write_atomic(path, _HEADER + "\n" + tomli_w.dumps(content))
    except OSError as error:
        raise _unwritable(path, error) from error
    shipped_table.cache_clear()


def _fields(entry: TunedEntry) -> dict[str, Any]:
    return {name: value for name, value in vars(entry).items() if value is not False}


def _toml_value(key: str, value: Any) -> Any:
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_toml_value(key, item) for item in value]
    if isinstance(value, str | bool | int) or (isinstance(value, float) and math.isfinite(value)):
        return value
    raise ConfigurationError(f"{key}: expected finite numbers, lists or words, got {value!r}")
