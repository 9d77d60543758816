"""config.toml of a run: what ran, on which heads and with which options, and what did not."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol

import tomli_w

from vergence.eval.comparison.config import EvaluateConfig
from vergence.eval.reporting.runs import plain, versions
from vergence.models.files.head_file import save_head
from vergence.models.head import HeadModel


class Ran(Protocol):
    """One controller in one scenario."""

    @property
    def scenario(self) -> str:
        """The scenario's name."""

    @property
    def controller(self) -> str:
        """The controller's label."""

    @property
    def head(self) -> HeadModel:
        """The head that it knew."""

    @property
    def options(self) -> dict[str, Any]:
        """The options that it ran with."""

    @property
    def tuned(self) -> bool | None:
        """Whether they were tuned for the head, see `Fitted`."""


def what_ran(
    config: EvaluateConfig, notes: Sequence[str], failures: Sequence[str]
) -> dict[str, Any]:
    """The configuration, and what was left out of it, as plain values.

    Args:
        config: what was asked for.
        notes: what was left out, and why.
        failures: what went wrong.
    """
    found: dict[str, Any] = plain(
        {**config.resolved(), "notes": list(notes), "failures": list(failures)}
    )
    return found


def write_ran(
    folder: Path,
    config: EvaluateConfig,
    notes: Sequence[str],
    failures: Sequence[str],
    outcomes: Iterable[Ran],
) -> None:
    """Write config.toml, and a file of the head of each scenario.

    Args:
        folder: the run folder.
        config: see `what_ran`, as are the following two.
        notes: what was left out, and why.
        failures: what went wrong.
        outcomes: what ran.
    """
    heads: dict[str, Any] = {}
    ran: dict[str, dict[str, Any]] = {}
    tuned: dict[str, dict[str, bool]] = {}
    for one in outcomes:
        if one.scenario not in heads:
            file = f"head-{one.scenario}.toml"
            save_head(one.head, folder / file)
            heads[one.scenario] = {"name": one.head.name, "digest": one.head.digest, "file": file}
        ran.setdefault(one.controller, {})[one.scenario] = plain(one.options)
        if one.tuned is not None:
            tuned.setdefault(one.controller, {})[one.scenario] = one.tuned
    content = {
        "config": plain(config.resolved()),
        "notes": list(notes),
        "failures": list(failures),
        "heads": heads,
        "controllers": ran,
        "tuned": tuned,
        "versions": versions(),
    }
    (folder / "config.toml").write_text(tomli_w.dumps(content), encoding="utf-8")
