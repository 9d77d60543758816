"""The report: one self-contained HTML file for phones, screens and paper."""

import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from vergence.eval.article.criterion import (
    BY_CONSTRUCTION,
    DIFFERS,
    OTHER_VERDICTS,
    SAME_ORDER,
    VERDICTS,
    most_different_ends,
)
from vergence.eval.article.criterion import NONE as NO_FIGURE
from vergence.eval.article.reported import reported_results
from vergence.eval.reporting.glossary import GLOSSARY
from vergence.eval.reporting.runs import package_versions
from vergence.eval.reporting.text import NONE, format_number, jinja_environment, read_template
from vergence.files import write_atomic

_VERDICT_PHRASES: Final = {
    SAME_ORDER: "of the same order",
    DIFFERS: "farther apart",
    BY_CONSTRUCTION: "by construction",
    NO_FIGURE: "without a figure of ours",
}
"""Words of the headline's sentence for the verdicts below `reproduced`."""


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


def write_report(path: Path, sections: list[ReportSection], title: str = "") -> None:
    """Write the report.

    Args:
        path: the file, replaced atomically.
        sections: the sections, in order.
        title: title of a report that is not about the article.
    """
    page = jinja_environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    template = page.from_string(read_template("vergence.eval.reporting", "report.html.jinja"))
    text = template.render(
        sections=sections,
        title=title,
        versions=package_versions(),
        style=read_template("vergence.eval.reporting", "page.css"),
        figure=_inline,
        headlines=article_summary_rows(sections),
        tally=count_verdicts(sections),
        reported=len(reported_results()),
        phrases=_VERDICT_PHRASES,
        verdicts=VERDICTS,
        other_verdicts=OTHER_VERDICTS,
        glossary=GLOSSARY,
        pairs=lambda section: [(section.name, row) for row in section.summary],
        ratio=_ratio,
    )
    write_atomic(path, text)


def article_summary_rows(sections: list[ReportSection]) -> list[tuple[str, dict[str, Any]]]:
    """Rows of the report's summary: each result that the article reports, once.

    Args:
        sections: the sections, in order.

    Returns:
        Pairs of a section's name and a row with the fields of `SummaryRow`.
    """
    keys = ("experiment", "quantity", "method", "axis")
    reported = {tuple(getattr(row, key) for key in keys) for row in reported_results()}
    return [
        (section.name, row)
        for section in sections
        for row in section.summary
        if tuple(row[key] for key in keys) in reported
    ]


def count_verdicts(sections: list[ReportSection]) -> dict[str, int]:
    """Count the article's results by verdict, the best verdict first.

    Args:
        sections: the sections.

    Returns:
        Counts by verdict, without zeros.
    """
    counts = Counter(row["verdict"] for _name, row in article_summary_rows(sections))
    return {verdict: counts[verdict] for verdict in VERDICTS if counts[verdict]}


def _ratio(row: dict[str, Any]) -> str:
    """Ratio of our value to the article's, at the end of the range where they differ most."""
    article = row["article_low"], row["article_high"]
    if row["ours_low"] is None or row["ours_high"] is None or article == (None, None):
        return NONE
    ours, theirs = most_different_ends(row["ours_low"], row["ours_high"], *article)
    return format_number(ours / theirs) if theirs else NONE


def _inline(path: Path, prefix: str) -> str:
    return inline_svg(path.read_text(encoding="utf-8"), prefix, path.stem.replace("-", " "))


def inline_svg(text: str, prefix: str, label: str) -> str:
    """Make markup to embed from an SVG file, with ids that are unique on the page.

    Args:
        text: content of the file.
        prefix: prefix of the ids.
        label: text alternative for screen readers.
    """
    text = text[text.index("<svg") :]
    text = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", text)
    text = re.sub(r'href="#([^"]+)"', rf'href="#{prefix}-\1"', text)
    # the page sets the width; the viewBox keeps the aspect ratio
    head, rest = text.split(">", 1)
    head = re.sub(r'\s(width|height)="[^"]+"', "", head)
    return f'{head} role="img" aria-label="{label}">{rest}'
