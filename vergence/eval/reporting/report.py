"""The report: one self-contained HTML file, for a phone, a screen and paper."""

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
    farthest,
)
from vergence.eval.article.criterion import NONE as NO_FIGURE
from vergence.eval.article.reported import reported_results
from vergence.eval.reporting.glossary import GLOSSARY
from vergence.eval.reporting.runs import versions
from vergence.eval.reporting.text import NONE, environment, format_number, read_template
from vergence.files import write_whole

_PHRASES: Final = {
    SAME_ORDER: "of the same order",
    DIFFERS: "farther apart",
    BY_CONSTRUCTION: "by construction",
    NO_FIGURE: "without a figure of ours",
}
"""The verdicts below `reproduced` in the headline's sentence."""


@dataclass(frozen=True, kw_only=True)
class ReportTable:
    """A table of text, a row an entry; on a phone each row is a card under its first column."""

    title: str
    columns: list[str]
    rows: list[list[str]]


@dataclass(frozen=True, kw_only=True)
class Section:
    """One experiment, or one evaluation, as the report shows it."""

    name: str
    title: str
    article: str
    what: str
    """What was done, and how; each line is a paragraph."""
    conclusion: str
    """What came out; the same."""
    summary: list[dict[str, Any]]
    """Rows as `SummaryRow` has them."""
    figures: list[Path]
    """SVG files."""
    rows: int
    """Rows of the table."""
    config: dict[str, Any]
    seed: int
    data: str = ""
    """Where the table is, from the report's folder; `tables/NAME.csv` by default."""
    tables: list[ReportTable] = field(default_factory=list)
    """What it found where there is no article to compare with; shown first."""
    headline: str = ""
    """One sentence of it for the top of the report."""
    captions: dict[str, str] = field(default_factory=dict)
    """What each figure shows and what to conclude, by the stem of its file."""
    quick: bool = False
    """Whether it ran with `--quick`."""
    changed: dict[str, Any] = field(default_factory=dict)
    """The configuration where it is not that of a full run."""


def write_report(path: Path, sections: list[Section], title: str = "") -> None:
    """Write the report.

    Args:
        path: the file; it is replaced whole.
        sections: the experiments, in order.
        title: of a report that is not about the article.
    """
    page = environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    template = page.from_string(read_template("vergence.eval.reporting", "report.html.jinja"))
    text = template.render(
        sections=sections,
        title=title,
        versions=versions(),
        style=read_template("vergence.eval.reporting", "page.css"),
        figure=_inline,
        headlines=headlines(sections),
        tally=tally(sections),
        reported=len(reported_results()),
        phrases=_PHRASES,
        verdicts=VERDICTS,
        other_verdicts=OTHER_VERDICTS,
        glossary=GLOSSARY,
        pairs=lambda section: [(section.name, row) for row in section.summary],
        ratio=_ratio,
    )
    write_whole(path, text)


def headlines(sections: list[Section]) -> list[tuple[str, dict[str, Any]]]:
    """What a summary shows: each result that the article reports, once.

    Args:
        sections: the experiments, in order.

    Returns:
        Pairs of a section's name and a row as `SummaryRow` has it.
    """
    keys = ("experiment", "quantity", "method", "axis")
    reported = {tuple(getattr(row, key) for key in keys) for row in reported_results()}
    return [
        (section.name, row)
        for section in sections
        for row in section.summary
        if tuple(row[key] for key in keys) in reported
    ]


def tally(sections: list[Section]) -> dict[str, int]:
    """How many of the article's results got which verdict, the best first.

    Args:
        sections: the experiments.

    Returns:
        Counts by verdict; verdicts that none got are left out.
    """
    counts = Counter(row["verdict"] for _name, row in headlines(sections))
    return {verdict: counts[verdict] for verdict in VERDICTS if counts[verdict]}


def _ratio(row: dict[str, Any]) -> str:
    """Ours by the article's, at the end where they are farthest apart."""
    article = row["article_low"], row["article_high"]
    if row["ours_low"] is None or row["ours_high"] is None or article == (None, None):
        return NONE
    ours, theirs = farthest(row["ours_low"], row["ours_high"], *article)
    return format_number(ours / theirs) if theirs else NONE


def _inline(path: Path, prefix: str) -> str:
    return inline_svg(path.read_text(encoding="utf-8"), prefix, path.stem.replace("-", " "))


def inline_svg(text: str, prefix: str, label: str) -> str:
    """An SVG file as markup whose ids are its own in a page with others.

    Args:
        text: of the file.
        prefix: of the ids.
        label: for those who cannot see the figure.
    """
    text = text[text.index("<svg") :]
    text = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", text)
    text = re.sub(r'href="#([^"]+)"', rf'href="#{prefix}-\1"', text)
    # the page decides how wide it is; the viewBox keeps its proportions
    head, rest = text.split(">", 1)
    head = re.sub(r'\s(width|height)="[^"]+"', "", head)
    return f'{head} role="img" aria-label="{label}">{rest}'
