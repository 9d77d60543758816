"""Options of controllers: tuned for the head, tuned for another head, or given in a file.

```toml
[pid]                   # in every scenario
kp = 6.5
[pid.robust]            # in this scenario, over the former
kp = 6.8
["mine.py:Gentle"]      # passed to the class beside head= and layout=
softness = 0.5
```
"""

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vergence.controllers.controller import CONTROLLERS
from vergence.controllers.tuned import find_tuned_or_fallback, is_tuned_for, name_in_tuned_table
from vergence.errors import ConfigurationError
from vergence.eval.trials.scenarios import SCENARIOS
from vergence.eval.tuning.spaces import SEARCH_SPACES
from vergence.models.head import HeadModel

UNTUNED = "untuned for this head"
"""Mark for options that were tuned for another head, or never."""


@dataclass(frozen=True, kw_only=True)
class ResolvedOptions:
    """A controller's options and their source."""

    options: dict[str, Any]
    tuned: bool | None = None
    """True if they were tuned for this head; None if there is nothing to tune or they were
    given."""
    tuned_for: str | None = None
    """Name of the head for which they were tuned, if any."""
    given_names: tuple[str, ...] = ()
    """Names of the user-given options."""


def resolve_options(
    name: str, head: HeadModel, scenario: str, given: Mapping[str, Any]
) -> ResolvedOptions:
    """Resolve the options of a registry controller.

    Args:
        name: the controller.
        head: the head.
        scenario: the scenario's name.
        given: user-given options, which override tuned ones.

    Raises:
        ConfigurationError: the user's table of tuned options cannot be read.
    """
    space = {} if name == "ibvs" else SEARCH_SPACES.get(name_in_tuned_table(name), {})
    entry = find_tuned_or_fallback(name, scenario, head)
    tuned = is_tuned_for(entry, head) if space else None
    # A given value replaces a tuned one, so options tuned for this head count as tuned no longer.
    # Remaining options that were tuned for another head stay marked as untuned.
    if space.keys() <= given.keys() or (tuned and space.keys() & given.keys()):
        entry, tuned = (None if space.keys() <= given.keys() else entry), None
    return ResolvedOptions(
        options={**({} if entry is None else entry.options), **given},
        tuned=tuned,
        tuned_for=None if entry is None or tuned is None else entry.head,
        given_names=tuple(given),
    )


class GivenOptions:
    """User-given options by controller, and by controller and scenario.

    Args:
        content: options by controller; a nested table holds the options of one scenario.
        where: name of the source in messages, such as the file's path.

    Raises:
        ConfigurationError: a controller has no table.
    """

    def __init__(self, content: Mapping[str, Any] | None = None, where: str = "options") -> None:
        self.where = where
        self._content = dict(content or {})
        for name, options in self._content.items():
            if not isinstance(options, Mapping):
                raise ConfigurationError(
                    f"{where}: {name}: expected a table [controller], got {options!r:.60}"
                )

    @classmethod
    def read(cls, path: Path) -> "GivenOptions":
        """Read the options from a TOML file.

        Raises:
            ConfigurationError: the file cannot be read or is not a TOML file of options.
        """
        try:
            return cls(tomllib.loads(path.read_text(encoding="utf-8")), str(path))
        except OSError as error:
            raise ConfigurationError(
                f"options: expected a file that can be read, got {path}: {error.strerror}"
            ) from error
        except UnicodeDecodeError as error:
            raise ConfigurationError(f"{path}: expected a TOML file, got a binary one") from error
        except tomllib.TOMLDecodeError as error:
            raise ConfigurationError(f"{path}: expected a TOML file, got {error}") from error

    def check_names(self, known: Iterable[str]) -> list[str]:
        """Reject options of unknown controllers.

        Args:
            known: names of the controllers that take part.

        Returns:
            A note for each controller that has options but does not take part.

        Raises:
            ConfigurationError: a name is not that of a controller.
        """
        taking_part = list(known)
        notes = []
        for name in self._content:
            if name in taking_part:
                continue
            if name not in CONTROLLERS:
                names = ", ".join(dict.fromkeys([*CONTROLLERS, *taking_part]))
                raise ConfigurationError(f"{self.where}: {name}: expected a controller of {names}")
            notes.append(f"options of {name} in {self.where} are not used: it does not take part")
        return notes

    def for_controller(self, names: Iterable[str], scenario: str) -> dict[str, Any]:
        """The options of one controller in one scenario.

        Args:
            names: the controller's names.
            scenario: the scenario's name.

        Raises:
            ConfigurationError: a nested table has an unknown scenario's name.
        """
        found: dict[str, Any] = {}
        special: dict[str, Any] = {}
        for name in dict.fromkeys(names):
            for key, value in self._content.get(name, {}).items():
                if not isinstance(value, Mapping):
                    found[key] = value
                elif key not in SCENARIOS:
                    raise ConfigurationError(
                        f"{self.where}: {name}.{key}: expected an option's value, or a scenario "
                        f"of {', '.join(SCENARIOS)}"
                    )
                elif key == scenario:
                    special.update(value)
        return {**found, **special}
