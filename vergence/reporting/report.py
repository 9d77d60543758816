"""The report: one self-contained HTML file for phones, screens and paper.

Sections are files too, so that another report can include the section of a run.
"""

import dataclasses
import json
import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from vergence.errors import ConfigurationError
from vergence.files import atomic_folder, write_atomic
from vergence.reporting.runs import package_versions
from vergence.reporting.text import GLOSSARY, jinja_environment, read_template


@dataclass(frozen=True, kw_only=True)
class ReportTable:
    """A table of text; on a phone each row is a card with its first column as the title."""

    title: str
    columns: list[str]
    rows: list[list[str]]


@dataclass(frozen=True, kw_only=True)
class ReportSection:
    """Section of the report for one experiment or one evaluation."""

    name: str
    title: str
    article: str
    what: str
    """Description of the work and its method; each line is a paragraph."""
    conclusion: str
    """Results; each line is a paragraph."""
    summary: list[dict[str, Any]]
    """Rows with the fields of `SummaryRow`."""
    figures: list[Path]
    """SVG files."""
    rows: int
    """Number of rows of the data file."""
    config: dict[str, Any]
    seed: int
    data: str = ""
    """Path of the data file, relative to the report's folder; `tables/NAME.csv` by default."""
    tables: list[ReportTable] = field(default_factory=list)
    """Tables of results for sections that do not compare with the article; shown first."""
    headline: str = ""
    """One sentence for the top of the report."""
    captions: dict[str, str] = field(default_factory=dict)
    """Captions, with the conclusions to draw, by the stem of each figure's file."""
    quick: bool = False
    """True if it ran with `--quick`."""
    changed: dict[str, Any] = field(default_factory=dict)
    """Configuration values that differ from a full run's."""


@dataclass(frozen=True, kw_only=True)
class ArticleSummary:
    """The article's part of a report: its results beside ours, and the meaning of verdicts."""

    rows: list[tuple[str, dict[str, Any]]]
    """Names of sections with rows of their summaries, each of the article's results once."""
    tally: dict[str, int]
    """Numbers of those rows by verdict, the best verdict first."""
    reported: int
    """Number of results that the article reports."""
    phrases: Mapping[str, str]
    """Words of the headline's sentence for the verdicts below the best."""
    verdicts: Mapping[str, str]
    """Meaning of each verdict on a result of the article."""
    other_verdicts: Mapping[str, str]
    """Meaning of the other verdicts."""
    ratio: Callable[[dict[str, Any]], str]
    """Ratio of our value to the article's in a row."""


def write_report(
    path: Path,
    sections: list[ReportSection],
    title: str = "",
    article: ArticleSummary | None = None,
) -> None:
    """Write the report atomically: about the article, or under a title of its own."""
    page = jinja_environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    template = page.from_string(read_template("vergence.reporting", "report.html.jinja"))
    text = template.render(
        sections=sections,
        title=title,
        versions=package_versions(),
        style=read_template("vergence.reporting", "page.css"),
        figure=_inline,
        article=article,
        glossary=GLOSSARY,
        pairs=lambda section: [(section.name, row) for row in section.summary],
    )
    write_atomic(path, text)


def _inline(path: Path, prefix: str) -> str:
    return inline_svg(path.read_text(encoding="utf-8"), prefix, path.stem.replace("-", " "))


def inline_svg(text: str, prefix: str, label: str) -> str:
    """Make markup to embed from SVG text, with ids that are unique on the page by a prefix."""
    text = text[text.index("<svg") :]
    text = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", text)
    text = re.sub(r'href="#([^"]+)"', rf'href="#{prefix}-\1"', text)
    # the page sets the width; the viewBox keeps the aspect ratio
    head, rest = text.split(">", 1)
    head = re.sub(r'\s(width|height)="[^"]+"', "", head)
    return f'{head} role="img" aria-label="{label}">{rest}'


SECTION_FILE: Final = "section.json"
_FORMAT_VERSION: Final = 1
"""Version of the file's format (numerical)."""


def write_section(path: Path, section: ReportSection) -> None:
    """Write a section; its figures must be in the file's folder or below it."""
    content = dataclasses.asdict(section)
    content["figures"] = [figure.relative_to(path.parent).as_posix() for figure in section.figures]
    text = json.dumps(
        {"format": _FORMAT_VERSION, **content}, indent=2, allow_nan=False, default=str
    )
    write_atomic(path, text + "\n")


def read_section(path: Path) -> ReportSection:
    """Read a section whose figures are whole SVG files of its folder; refuse any other file."""
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        form = content.pop("format")
        content["tables"] = [ReportTable(**table) for table in content["tables"]]
        content["figures"] = [path.parent / figure for figure in content["figures"]]
        section = ReportSection(**content)
        _check_plain(section)
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise ConfigurationError(
            f"include: expected the folder of a run of vergence evaluate, got {path.parent}: "
            f"no readable {path.name}"
        ) from error
    if form != _FORMAT_VERSION:
        raise ConfigurationError(
            f"include: expected format {_FORMAT_VERSION}, got {form!r} in {path}"
        )
    here = path.parent.resolve()
    for figure in section.figures:
        inside = figure.resolve().is_relative_to(here) and figure.suffix == ".svg"
        if not (inside and figure.is_file()):
            raise ConfigurationError(f"include: expected a figure of the run, got {figure}")
        if not re.search(rb"<svg[\s>].*</svg>\s*\Z", figure.read_bytes(), re.DOTALL):
            raise ConfigurationError(f"include: expected a whole SVG file, got {figure}")
    return section


def _check_plain(section: ReportSection) -> None:
    """Raise a TypeError for values of types that a report cannot show."""
    lines = [[table.title, *table.columns] for table in section.tables]
    lines += [row for table in section.tables for row in table.rows]
    lines += [[section.name, section.title, section.article, section.data]]
    lines += [[section.what, section.conclusion]]
    lines += [[row[key] for key in _TEXT_KEYS] for row in section.summary]
    if not all(isinstance(text, str) for line in lines for text in line):
        raise TypeError("expected text")
    numbers = [row[key] for row in section.summary for key in _NUMBER_KEYS]
    if not all(value is None or isinstance(value, int | float) for value in numbers):
        raise TypeError("expected numbers")
    if not all(type(number) is int for number in (section.rows, section.seed)):
        raise TypeError("expected whole numbers")
    if not isinstance(section.config, dict):
        raise TypeError("expected values by name")


_TEXT_KEYS: Final = ("experiment", "quantity", "method", "axis", "unit", "verdict")
_NUMBER_KEYS: Final = ("article_low", "article_high", "ours_low", "ours_high")


def include_run_folder(run: Path, folder: Path) -> Path:
    """Copy a run folder with a section into a folder of such copies, and return the copy."""
    read_section(run / SECTION_FILE)
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", run.resolve().name)
    with atomic_folder(folder / name, replace=True) as copy:
        shutil.copytree(run, copy, dirs_exist_ok=True)
    return folder / name


def included_sections(folder: Path) -> list[ReportSection]:
    """Read the sections of all copies in a folder, sorted by run and with unique names."""
    sections = []
    for path in sorted(folder.glob(f"[!.]*/{SECTION_FILE}")):
        section = read_section(path)
        run = path.parent.name
        sections.append(
            dataclasses.replace(
                section,
                name=f"{section.name}-{run}",
                title=f"{section.title} ({run})",
                data=f"{folder.name}/{run}/{section.data}",
            )
        )
    return sections
