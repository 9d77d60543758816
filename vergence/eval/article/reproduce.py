"""Run the article's experiments into one folder, resumably, and report on them."""

import dataclasses
import hashlib
import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import Any, Final, Protocol

import tomli_w

from vergence.envs.streams import as_seed
from vergence.errors import ConfigurationError
from vergence.eval.article.config import EXPERIMENTS, ReproduceConfig
from vergence.eval.article.criterion import summarise_article
from vergence.eval.article.experiment import (
    Experiment,
    load_experiment,
    read_overrides,
    resolve_config,
)
from vergence.files import PARTIAL_PREFIX, atomic_files, hold_lock, remove_partial, write_atomic
from vergence.reporting.jobs import Mapper, Progress, SerialMapper
from vergence.reporting.report import (
    SECTION_FILE,
    ReportSection,
    include_run_folder,
    included_sections,
    read_section,
    write_report,
)
from vergence.reporting.runs import (
    describe_run_folder,
    package_versions,
    run_folder_command,
    toml_value,
)
from vergence.reporting.style import figure_style, save_figure
from vergence.reporting.text import render_text

INCLUDED: Final = "evaluations"
"""Name of the subfolder with the sections of other runs."""
_PARTS: Final = ("tables", "figures", "experiments")
_FILES: Final = ("report.html", "summary.json", "numbers.json", "config.toml")
_FORMAT: Final = 3
"""Version of the format of a finished experiment's marker file (numerical)."""


def open_run_folder(folder: Path) -> Path:
    """Make a run folder, or reuse the one of an earlier run; refuse any other folder."""
    ours = {*_PARTS, INCLUDED, *_FILES}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        names = sorted({path.name for path in folder.iterdir()} - ours)
        others = [name for name in names if not name.startswith(PARTIAL_PREFIX)]
        if others:
            what = f"a folder with {', '.join(others[:3])} in it"
            if run_folder_command(folder) != "reproduce":
                what = describe_run_folder(folder) or what
            raise ConfigurationError(
                f"out: expected a new folder or one of an earlier run, got {what}: {folder}"
            )
        for part in _PARTS:
            (folder / part).mkdir(exist_ok=True)
    except OSError as error:
        raise ConfigurationError(
            f"out: expected a folder that can be written, got {folder}: {error.strerror}"
        ) from error
    return folder


def remove_partial_files(folder: Path) -> None:
    """Remove partial files that killed processes have left; nobody else may be writing."""
    for place in (folder, *(folder / part for part in (*_PARTS, INCLUDED))):
        remove_partial(place)


def _identity(experiment: Experiment, config: Any, seed: int) -> dict[str, Any]:
    """All that a result depends on: equal identities give equal tables."""
    return {
        "name": experiment.name,
        "config": toml_value(dataclasses.asdict(config)),
        "seed": seed,
        "versions": package_versions(),
        "sources": _sources_digest(),
    }


def _sources_digest() -> str:
    """Digest of the package's sources and data; after an edit all experiments run again."""
    sha = hashlib.sha256()
    package = Path(__file__).resolve().parents[2]
    for path in sorted(package.rglob("*")):
        if path.suffix in (".py", ".toml", ".csv", ".jinja"):
            sha.update(path.relative_to(package).as_posix().encode())
            sha.update(path.read_bytes())
    return sha.hexdigest()[:16]


def reason_to_run(folder: Path, experiment: Experiment, config: Any, seed: int) -> str | None:
    """Reason to run an experiment, empty if it never ran there; None if finished there."""
    try:
        earlier = _finished(folder, experiment.name)
    except _NotFinishedError as error:
        return str(error)
    if earlier is None:
        return ""
    now = json.loads(json.dumps(_identity(experiment, config, seed)))
    different = [name for name, value in now.items() if earlier["identity"].get(name) != value]
    if not different:
        return None
    if different == ["sources"] or "versions" in different:
        return "what is there was made by another version of the package or of its libraries"
    return f"what is there was made with another {' and '.join(different)}"


def run_experiment(
    folder: Path, experiment: Experiment, config: Any, seed: int, mapper: Mapper, quick: bool
) -> None:
    """Run an experiment and write its table and figures; earlier ones stay until then."""
    table = experiment.run(config, seed, mapper)
    with figure_style():
        figures = experiment.draw(table, config)
    numbers = experiment.numbers(table, config)
    content = {
        "format": _FORMAT,
        "identity": _identity(experiment, config, seed),
        "quick": quick,
        "figures": list(figures),
        "rows": len(table),
        "summary": [dataclasses.asdict(row) for row in experiment.summarise(table, config)],
        "numbers": {name: float(n) if isfinite(n) else None for name, n in numbers.items()},
        "text": render_text(experiment.text, config=config, **numbers)._asdict(),
    }
    marker = _marker(folder, experiment.name)
    with _writing(folder, experiment.name):
        with atomic_files(folder / "figures") as drawn, atomic_files(folder / "tables") as tabled:
            for name, figure in figures.items():
                save_figure(figure, drawn / name)
            table.to_csv(tabled / f"{experiment.name}.csv", index=False)
            content["files"] = {
                f"{part}/{path.name}": _digest(path.read_bytes())
                for part, written in (("figures", drawn), ("tables", tabled))
                for path in sorted(written.iterdir())
            }
            marker.unlink(missing_ok=True)
            # a parquet file belongs to the earlier table
            (folder / "tables" / f"{experiment.name}.parquet").unlink(missing_ok=True)
        # the marker is written last and marks the experiment as finished
        write_atomic(marker, _json({**content, "digest": _digest(_json(content).encode())}))


@contextmanager
def _writing(folder: Path, what: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise ConfigurationError(
            f"out: {what} cannot be written to {folder}: {error.strerror or error} "
            "(what is finished there stays; the next call goes on)"
        ) from error


class _NotFinishedError(Exception):
    """The stored files of an experiment differ from those written; the message gives the reason."""


def _finished(folder: Path, name: str) -> dict[str, Any] | None:
    """Read the marker of a finished experiment; None if there is none, or in another format."""
    marker = _marker(folder, name)
    part = marker.relative_to(folder).as_posix()
    try:
        content: Any = json.loads(marker.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError):
        raise _NotFinishedError(f"{part} cannot be read") from None
    if not isinstance(content, dict):
        raise _NotFinishedError(f"{part} is damaged")
    if content.get("format") != _FORMAT:
        return None
    digest = content.pop("digest", None)
    if digest != _digest(_json(content).encode()):
        raise _NotFinishedError(f"{part} is damaged")
    for file, expected in content["files"].items():
        try:
            found = _digest((folder / file).read_bytes())
        except OSError as error:
            why = "is missing" if isinstance(error, FileNotFoundError) else "cannot be read"
            raise _NotFinishedError(f"{file} {why}") from None
        if found != expected:
            raise _NotFinishedError(f"{file} is not as it was written")
    return content


def _marker(folder: Path, name: str) -> Path:
    return folder / "experiments" / f"{name}.json"


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _json(content: Any) -> str:
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def write_folder_report(
    folder: Path, omit: Callable[[str, str], None] = lambda name, why: None
) -> list[ReportSection]:
    """Write summary, numbers, config and report of all finished experiments of a folder.

    `omit` is called with the name of each experiment left out as its files are damaged, and why.
    The sections returned are in the article's order, then those of included runs.
    """
    sections, numbers, configs = [], {}, {}
    for name in EXPERIMENTS:
        try:
            content = _finished(folder, name)
        except _NotFinishedError as error:
            omit(name, str(error))
            continue
        if content is None:
            continue
        experiment, identity = load_experiment(name), content["identity"]
        text, config = content["text"], identity["config"]
        full = toml_value(dataclasses.asdict(experiment.config()))
        section = ReportSection(
            name=name, title=experiment.title, article=experiment.article, what=text["what"],
            conclusion=text["found"], summary=content["summary"],
            figures=[folder / "figures" / f"{stem}.svg" for stem in content["figures"]],
            rows=content["rows"], config=config, seed=identity["seed"],
            headline=text["headline"], captions=text["captions"], quick=content["quick"],
            changed={field: value for field, value in config.items() if value != full.get(field)},
        )  # fmt: skip
        sections.append(section)
        numbers[name] = content["numbers"]
        configs[name] = {"seed": identity["seed"], **identity["config"]}
    sections += included_sections(folder / INCLUDED)
    summary = [row for section in sections for row in section.summary]
    resolved = {"versions": package_versions(), "experiments": configs}
    with _writing(folder, "the report"):
        write_atomic(folder / "summary.json", _json(summary))
        write_atomic(folder / "numbers.json", _json(numbers))
        write_atomic(folder / "config.toml", tomli_w.dumps(resolved))
        write_report(folder / "report.html", sections, article=summarise_article(sections))
    return sections


class ReproduceListener(Protocol):
    """Callbacks for the progress of a run."""

    def begin(self, name: str) -> Progress:
        """Called at the start of an experiment; returns the callback for its progress."""
        return lambda _done, _total: None

    def warn(self, name: str, why: str) -> None:
        """Called for an experiment that runs again, or is left out of the report."""
        return

    def end(self, name: str, seconds: float | None) -> None:
        """Called at the end of an experiment; None if its results were there already."""
        return


class _Silent(ReproduceListener):
    """A run without callbacks."""


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
