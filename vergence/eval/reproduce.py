"""Runs the article's experiments into one folder, resumably, and reports on them."""

import dataclasses
import hashlib
import json
import os
import time
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import pandas as pd
import tomli_w

from vergence.errors import ConfigurationError
from vergence.eval.experiment import EXPERIMENTS, Experiment, load_experiment, resolve_config
from vergence.eval.jobs import Mapper, ProcessMapper, Progress, RayMapper, SerialMapper
from vergence.eval.report import Section, write_report
from vergence.eval.runs import plain, versions
from vergence.eval.section_file import (
    SECTION_FILE,
    include_section,
    included_sections,
    read_section,
)
from vergence.eval.style import save_figure, styled


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
    folder = _open(config.out)
    for run in config.include:
        include_section(run, folder / _INCLUDED)
    remote = RayMapper(config.cluster) if config.cluster else None
    try:
        for name in sorted(names, key=list(EXPERIMENTS).index):
            progress = listener.begin(name)
            begun = time.monotonic()
            mapper = _mapper(config, remote, progress)
            ran = _run_one(folder, experiments[name], resolved[name], config.seed, mapper)
            listener.end(name, time.monotonic() - begun if ran else None)
    finally:
        if remote is not None:
            remote.close()
    return finish(folder)


def _mapper(config: ReproduceConfig, remote: RayMapper | None, progress: Progress) -> Mapper:
    if remote is not None:
        remote.progress = progress
        return remote
    if config.workers == 1:
        return SerialMapper(progress)
    return ProcessMapper(config.workers, progress)


_PARTS = ("tables", "figures", "experiments")
_INCLUDED = "evaluations"


def _open(folder: Path) -> Path:
    ours = {*_PARTS, _INCLUDED, "report.html", "summary.json", "config.toml"}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        others = sorted(path.name for path in folder.iterdir() if path.name not in ours)
        if others:
            raise ConfigurationError(
                f"out: expected a new folder or one of an earlier run, got {folder} with "
                f"{', '.join(others[:3])} in it"
            )
        for part in _PARTS:
            (folder / part).mkdir(exist_ok=True)
    except OSError as error:
        raise ConfigurationError(
            f"out: expected a folder that can be written, got {folder}: {error.strerror}"
        ) from error
    return folder


def _identity(experiment: Experiment, config: Any, seed: int) -> dict[str, Any]:
    """What a result depends on: the same identity, the same table."""
    return {
        "name": experiment.name,
        "config": plain(dataclasses.asdict(config)),
        "seed": seed,
        "versions": versions(),
        "sources": _sources_digest(),
    }


def _sources_digest() -> str:
    """A digest of the package's sources and data: an edited package runs anew."""
    sha = hashlib.sha256()
    package = Path(__file__).resolve().parents[1]
    for path in sorted(package.rglob("*")):
        if path.suffix in (".py", ".toml", ".csv"):
            sha.update(path.relative_to(package).as_posix().encode())
            sha.update(path.read_bytes())
    return sha.hexdigest()[:16]


def _run_one(folder: Path, experiment: Experiment, config: Any, seed: int, mapper: Mapper) -> bool:
    marker = folder / "experiments" / f"{experiment.name}.json"
    identity = _identity(experiment, config, seed)
    if marker.exists():
        earlier = json.loads(marker.read_text(encoding="utf-8"))
        if earlier["identity"] == json.loads(json.dumps(identity)):
            return False
        marker.unlink()
    table = experiment.run(config, seed, mapper)
    with styled():
        figures = experiment.draw(table, config)
        stems = []
        for name, figure in figures.items():
            save_figure(figure, folder / "figures" / name)
            stems.append(name)
    _write_table(table, folder / "tables" / experiment.name)
    content = {
        "identity": identity,
        "figures": stems,
        "rows": len(table),
        "summary": [dataclasses.asdict(row) for row in experiment.summarise(table, config)],
        "conclusion": experiment.conclude(table, config),
    }
    # the marker is written last and at once: with it the experiment is finished
    partial = marker.with_suffix(".partial")
    partial.write_text(json.dumps(content, indent=2, allow_nan=False), encoding="utf-8")
    partial.replace(marker)
    return True


def _write_table(table: pd.DataFrame, stem: Path) -> None:
    for suffix, write in (
        (".parquet", lambda path: table.to_parquet(path, index=False)),
        (".csv", lambda path: table.to_csv(path, index=False)),
    ):
        partial = stem.with_suffix(f".partial{suffix}")
        _write: Callable[[Path], Any] = write
        _write(partial)
        partial.replace(stem.with_suffix(suffix))


def finish(folder: Path) -> list[Section]:
    """Write the summary, the config and the report of everything finished in a folder.

    Args:
        folder: the run folder.

    Returns:
        The report's sections, in the article's order; those of included runs come last.
    """
    sections, configs = [], {}
    for name in EXPERIMENTS:
        marker = folder / "experiments" / f"{name}.json"
        if not marker.exists():
            continue
        content = json.loads(marker.read_text(encoding="utf-8"))
        experiment = load_experiment(name)
        sections.append(
            Section(
                name=name,
                title=experiment.title,
                article=experiment.article,
                what=experiment.what,
                conclusion=content["conclusion"],
                summary=content["summary"],
                figures=[folder / "figures" / f"{stem}.svg" for stem in content["figures"]],
                rows=content["rows"],
                config=content["identity"]["config"],
                seed=content["identity"]["seed"],
            )
        )
        configs[name] = {"seed": content["identity"]["seed"], **content["identity"]["config"]}
    sections += included_sections(folder / _INCLUDED)
    summary = [row for section in sections for row in section.summary]
    _replace(folder / "summary.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")
    resolved = {"versions": versions(), "experiments": configs}
    _replace(folder / "config.toml", tomli_w.dumps(resolved))
    write_report(folder / "report.html", sections)
    return sections


def _replace(path: Path, text: str) -> None:
    partial = path.with_name(f"{path.name}.partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)
