"""Run the article's experiments into one folder, resumably, and report on them."""

import time
from typing import Protocol

from vergence.envs.streams import as_seed
from vergence.eval.article.config import ReproduceConfig
from vergence.eval.article.experiment import load_experiment, resolve_config
from vergence.eval.article.folder import (
    INCLUDED,
    open_run_folder,
    reason_to_run,
    remove_partial_files,
    run_experiment,
    write_folder_report,
)
from vergence.eval.article.overrides import read_overrides
from vergence.eval.article.registry import EXPERIMENTS
from vergence.files import hold_lock
from vergence.reporting.jobs import Mapper, Progress, SerialMapper
from vergence.reporting.report import (
    SECTION_FILE,
    ReportSection,
    include_run_folder,
    included_sections,
    read_section,
)


class ReproduceListener(Protocol):
    """Callbacks for the progress of a run."""

    def begin(self, name: str) -> Progress:
        """Called at the start of an experiment.

        Args:
            name: the experiment.

        Returns:
            The callback for its progress.
        """

    def warn(self, name: str, why: str) -> None:
        """Called for an experiment that runs again, or is left out of the report.

        Args:
            name: the experiment.
            why: the warning with its reason.
        """

    def end(self, name: str, seconds: float | None) -> None:
        """Called at the end of an experiment.

        Args:
            name: the experiment.
            seconds: its duration, s; None if its results were there already.
        """


class _Silent:
    def begin(self, name: str) -> Progress:
        del name
        return lambda _done, _total: None

    def warn(self, name: str, why: str) -> None:
        del name, why

    def end(self, name: str, seconds: float | None) -> None:
        del name, seconds


def reproduce(
    config: ReproduceConfig, listener: ReproduceListener | None = None, mapper: Mapper | None = None
) -> list[ReportSection]:
    """Run the experiments that are not finished yet, and write tables, figures and report.

    Each experiment's files appear once it is finished. An interrupted run loses only the experiment
    under way; the next call resumes with that one.

    Args:
        config: the experiments and their settings.
        listener: callbacks for the progress.
        mapper: runs the jobs; this process by default.

    Returns:
        The report's sections, in the article's order, with those of earlier calls.

    Raises:
        ConfigurationError: an option is not allowed, the folder holds something else or cannot be
            written, or another process is writing to it.
    """
    listener, mapper = listener or _Silent(), mapper or SerialMapper()
    seed, overrides = as_seed(config.seed), read_overrides(config.config, config.set)
    experiments = {name: load_experiment(name) for name in config.experiments or EXPERIMENTS}
    resolved = {
        name: resolve_config(experiment, overrides.get(name, {}), config.quick)
        for name, experiment in experiments.items()
    }
    for run in config.include:
        read_section(run / SECTION_FILE)
    with hold_lock(config.folder) as alone:
        folder = open_run_folder(config.folder)
        if alone:
            remove_partial_files(folder)
        for run in config.include:
            include_run_folder(run, folder / INCLUDED)
        included_sections(folder / INCLUDED)  # refuse a damaged one before the work
        for name in sorted(experiments, key=list(EXPERIMENTS).index):
            experiment, own = experiments[name], resolved[name]
            mapper.progress = listener.begin(name)
            begun = time.monotonic()
            reason = reason_to_run(folder, experiment, own, seed)
            if reason:
                listener.warn(name, f"runs anew: {reason}")
            if reason is not None:
                run_experiment(folder, experiment, own, seed, mapper, config.quick)
            listener.end(name, None if reason is None else time.monotonic() - begun)
        return write_folder_report(
            folder, lambda name, why: listener.warn(name, f"is not in the report: {why}")
        )
