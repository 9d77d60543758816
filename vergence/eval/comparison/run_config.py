"""config.toml of a run: controllers, heads and options that ran, and notes on those left out."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol

import tomli_w

from vergence.eval.comparison.config import EvaluateConfig
from vergence.files import write_atomic
from vergence.models.head import HeadModel
from vergence.models.head_file import head_to_toml
from vergence.reporting.runs import package_versions, toml_value


class ControllerRun(Protocol):
    """Result of one controller in one scenario."""

    @property
    def scenario(self) -> str:
        """The scenario's name."""

    @property
    def controller(self) -> str:
        """The controller's label."""

    @property
    def head(self) -> HeadModel:
        """The head that the controller knew."""

    @property
    def options(self) -> dict[str, Any]:
        """The controller's options."""

    @property
    def tuned(self) -> bool | None:
        """True if the options were tuned for the head, see `ResolvedOptions`."""


def config_with_notes(
    config: EvaluateConfig, notes: Sequence[str], failures: Sequence[str]
) -> dict[str, Any]:
    """The configuration with notes and failures, as plain values.

    Args:
        config: the configuration.
        notes: notes on controllers and plants that were left out.
        failures: errors of user-defined controllers.
    """
    found: dict[str, Any] = toml_value(
        {**config.resolved(), "notes": list(notes), "failures": list(failures)}
    )
    return found


def write_config_and_heads(
    folder: Path,
    config: EvaluateConfig,
    notes: Sequence[str],
    failures: Sequence[str],
    outcomes: Iterable[ControllerRun],
) -> None:
    """Write config.toml and a file for the head of each scenario.

    Args:
        folder: the run folder.
        config: the configuration.
        notes: notes on controllers and plants that were left out.
        failures: errors of user-defined controllers.
        outcomes: results of the controllers that ran.
    """
    heads: dict[str, Any] = {}
    ran: dict[str, dict[str, Any]] = {}
    tuned: dict[str, dict[str, bool]] = {}
    for one in outcomes:
        if one.scenario not in heads:
            file = f"head-{one.scenario}.toml"
            write_atomic(folder / file, head_to_toml(one.head))
            heads[one.scenario] = {"name": one.head.name, "digest": one.head.digest, "file": file}
        ran.setdefault(one.controller, {})[one.scenario] = toml_value(one.options)
        if one.tuned is not None:
            tuned.setdefault(one.controller, {})[one.scenario] = one.tuned
    content = {
        "config": toml_value(config.resolved()),
        "notes": list(notes),
        "failures": list(failures),
        "heads": heads,
        "controllers": ran,
        "tuned": tuned,
        "versions": package_versions(),
    }
    (folder / "config.toml").write_text(tomli_w.dumps(content), encoding="utf-8")
