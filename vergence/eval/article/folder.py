"""The folder of a run of experiments: what is finished there, and the report on it."""

import dataclasses
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import pandas as pd
import tomli_w

from vergence.errors import ConfigurationError
from vergence.eval.article.experiment import EXPERIMENTS, Experiment, load_experiment
from vergence.eval.jobs import Mapper
from vergence.eval.reporting.report import Section, write_report
from vergence.eval.reporting.runs import plain, versions
from vergence.eval.reporting.section import included_sections
from vergence.eval.reporting.style import save_figure, styled

_PARTS: Final = ("tables", "figures", "experiments")
INCLUDED: Final = "evaluations"
"""The part that holds the sections of other runs."""


def open_folder(folder: Path) -> Path:
    """Make the folder of a run, or take up that of an earlier one.

    Raises:
        ConfigurationError: it holds something else, or cannot be written.
    """
    ours = {*_PARTS, INCLUDED, "report.html", "summary.json", "config.toml"}
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
    package = Path(__file__).resolve().parents[2]
    for path in sorted(package.rglob("*")):
        if path.suffix in (".py", ".toml", ".csv"):
            sha.update(path.relative_to(package).as_posix().encode())
            sha.update(path.read_bytes())
    return sha.hexdigest()[:16]


def run_experiment(
    folder: Path, experiment: Experiment, config: Any, seed: int, mapper: Mapper
) -> bool:
    """Run an experiment and write its table and figures, unless they are there already.

    Args:
        folder: the run folder, see `open_folder`.
        experiment: what to run.
        config: its configuration.
        seed: its seed.
        mapper: runs its jobs.

    Returns:
        Whether it ran.
    """
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
    sections += included_sections(folder / INCLUDED)
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
