"""Runs the article's experiments into one folder, resumably, and reports on them."""

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from vergence.eval.article.experiment import EXPERIMENTS, load_experiment, resolve_config
from vergence.eval.article.folder import INCLUDED, finish, open_folder, run_experiment
from vergence.eval.jobs import Mapper, Progress, RayMapper, local_mapper
from vergence.eval.reporting.report import Section
from vergence.eval.reporting.section import SECTION_FILE, include_section, read_section


@dataclass(frozen=True, kw_only=True)
class ReproduceConfig:
    """What to run, and how."""

    experiments: tuple[str, ...] = ()
    """Names of experiments; none for all."""
    out: Path = Path("runs/reproduce")
    """The run folder; what is finished there for the same config and seed is kept."""
    seed: int = 0
    """Seed of all experiments."""
    quick: bool = False
    """Fewer points, heads and repetitions, for a look in two minutes."""
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    """Processes on this machine."""
    cluster: str | None = None
    """Address of a Ray cluster to run on instead."""
    overrides: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Values by experiment and field, over the defaults."""
    include: tuple[Path, ...] = ()
    """Run folders of `vergence evaluate` whose results join the report, and stay in it."""


class Listener(Protocol):
    """Told how a run goes on."""

    def begin(self, name: str) -> Progress:
        """An experiment begins.

        Args:
            name: which.

        Returns:
            What to call with its progress.
        """

    def end(self, name: str, seconds: float | None) -> None:
        """An experiment has ended.

        Args:
            name: which.
            seconds: how long it took; None where its results were there already.
        """


class _Silent:
    def begin(self, name: str) -> Progress:
        del name
        return lambda _done, _total: None

    def end(self, name: str, seconds: float | None) -> None:
        del name, seconds


def reproduce(config: ReproduceConfig, listener: Listener | None = None) -> list[Section]:
    """Run experiments, or take up what is finished, and write tables, figures and report.

    Each experiment's files appear when it is finished; an interrupted run loses the one under
    way and a second call continues after it.

    Args:
        config: what to run.
        listener: told how it goes on.

    Returns:
        The report's sections, in the article's order; those of earlier calls included.

    Raises:
        ConfigurationError: an option cannot be, or the folder holds something else.
    """
    listener = listener or _Silent()
    names = list(config.experiments or EXPERIMENTS)
    experiments = {name: load_experiment(name) for name in names}
    resolved = {
        name: resolve_config(experiment, config.overrides.get(name, {}), config.quick)
        for name, experiment in experiments.items()
    }
    for run in config.include:
        read_section(run / SECTION_FILE)
    folder = open_folder(config.out)
    for run in config.include:
        include_section(run, folder / INCLUDED)
    remote = RayMapper(config.cluster) if config.cluster else None
    try:
        for name in sorted(names, key=list(EXPERIMENTS).index):
            progress = listener.begin(name)
            begun = time.monotonic()
            mapper = _mapper(config, remote, progress)
            ran = run_experiment(folder, experiments[name], resolved[name], config.seed, mapper)
            listener.end(name, time.monotonic() - begun if ran else None)
    finally:
        if remote is not None:
            remote.close()
    return finish(folder)


def _mapper(config: ReproduceConfig, remote: RayMapper | None, progress: Progress) -> Mapper:
    if remote is not None:
        remote.progress = progress
        return remote
    return local_mapper(config.workers, progress)
