"""The folder of a run of experiments: what is finished there, and the report on it."""

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any, Final

import tomli_w

from vergence.errors import ConfigurationError
from vergence.eval.article.experiment import EXPERIMENTS, Experiment, load_experiment
from vergence.eval.jobs import Mapper
from vergence.eval.reporting.report import Section, write_report
from vergence.eval.reporting.runs import plain, versions
from vergence.eval.reporting.section import included_sections
from vergence.eval.reporting.style import save_figure, styled
from vergence.eval.reporting.text import render_text
from vergence.files import PARTIAL, whole_files, write_whole

INCLUDED: Final = "evaluations"
"""The part that holds the sections of other runs."""
_PARTS: Final = ("tables", "figures", "experiments")
_FILES: Final = ("report.html", "summary.json", "numbers.json", "config.toml")
_FORMAT: Final = 3
"""Of what is kept of a finished experiment."""


def open_folder(folder: Path) -> Path:
    """Make the folder of a run, or take up that of an earlier one.

    Raises:
        ConfigurationError: it holds something else, or cannot be written.
    """
    ours = {*_PARTS, INCLUDED, *_FILES}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        names = sorted(path.name for path in folder.iterdir())
        # another process may be writing; what a killed one left does no harm
        others = [name for name in names if name not in ours and not name.startswith(PARTIAL)]
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
        if path.suffix in (".py", ".toml", ".csv", ".jinja"):
            sha.update(path.relative_to(package).as_posix().encode())
            sha.update(path.read_bytes())
    return sha.hexdigest()[:16]


def run_experiment(
    folder: Path,
    experiment: Experiment,
    config: Any,
    seed: int,
    mapper: Mapper,
    quick: bool = False,
) -> bool:
    """Run an experiment and write its table and figures, unless they are there already.

    Args:
        folder: the run folder, see `open_folder`.
        experiment: what to run.
        config: its configuration.
        seed: its seed.
        mapper: runs its jobs.
        quick: whether the configuration is that of `--quick`, for the report to say so.

    Returns:
        Whether it ran.
    """
    marker = folder / "experiments" / f"{experiment.name}.json"
    identity = _identity(experiment, config, seed)
    earlier = _read_marker(marker)
    if earlier is not None and earlier["identity"] == json.loads(json.dumps(identity)):
        return False
    marker.unlink(missing_ok=True)
    table = experiment.run(config, seed, mapper)
    with styled():
        figures = experiment.draw(table, config)
    with whole_files(folder / "figures") as beside:
        for name, figure in figures.items():
            save_figure(figure, beside / name)
    with whole_files(folder / "tables") as beside:
        table.to_parquet(beside / f"{experiment.name}.parquet", index=False)
        table.to_csv(beside / f"{experiment.name}.csv", index=False)
    numbers = experiment.numbers(table, config)
    content = {
        "format": _FORMAT,
        "identity": identity,
        "quick": quick,
        "figures": list(figures),
        "rows": len(table),
        "summary": [dataclasses.asdict(row) for row in experiment.summarise(table, config)],
        "numbers": {name: float(n) if isfinite(n) else None for name, n in numbers.items()},
        "text": render_text(experiment.text, config=config, **numbers)._asdict(),
    }
    # the marker is written last: with it the experiment is finished
    write_whole(marker, _json(content))
    return True


def _read_marker(path: Path) -> dict[str, Any] | None:
    """What is kept of a finished experiment; None if it is not, or by another version."""
    if not path.exists():
        return None
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content if content.get("format") == _FORMAT else None


def _changed(experiment: Experiment, config: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a configuration that are not those of a full run."""
    full = plain(dataclasses.asdict(experiment.config()))
    return {name: value for name, value in config.items() if value != full.get(name)}


def _json(content: Any) -> str:
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def finish(folder: Path) -> list[Section]:
    """Write the summary, the numbers, the config and the report of everything finished in a folder.

    Args:
        folder: the run folder.

    Returns:
        The report's sections, in the article's order; those of included runs come last.
    """
    sections, numbers, configs = [], {}, {}
    for name in EXPERIMENTS:
        content = _read_marker(folder / "experiments" / f"{name}.json")
        if content is None:
            continue
        experiment, identity = load_experiment(name), content["identity"]
        text, config = content["text"], identity["config"]
        sections.append(
            Section(
                name=name,
                title=experiment.title,
                article=experiment.article,
                what=text["what"],
                conclusion=text["found"],
                summary=content["summary"],
                figures=[folder / "figures" / f"{stem}.svg" for stem in content["figures"]],
                rows=content["rows"],
                config=config,
                seed=identity["seed"],
                headline=text["headline"],
                captions=text["captions"],
                quick=content["quick"],
                changed=_changed(experiment, config),
            )
        )
        numbers[name] = content["numbers"]
        configs[name] = {"seed": identity["seed"], **identity["config"]}
    sections += included_sections(folder / INCLUDED)
    summary = [row for section in sections for row in section.summary]
    resolved = {"versions": versions(), "experiments": configs}
    write_whole(folder / "summary.json", _json(summary))
    write_whole(folder / "numbers.json", _json(numbers))
    write_whole(folder / "config.toml", tomli_w.dumps(resolved))
    write_report(folder / "report.html", sections)
    return sections
