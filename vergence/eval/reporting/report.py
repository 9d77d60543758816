"""The report: one self-contained HTML file, for a phone, a screen and paper."""

import math
import re
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2

from vergence.eval.article.reported import reported_results
from vergence.eval.reporting.runs import versions


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
    conclusion: str
    summary: list[dict[str, Any]]
    """Rows as `SummaryRow` has them."""
    figures: list[Path]
    """SVG files."""
    rows: int
    """Rows of the table."""
    config: dict[str, Any]
    seed: int
    data: str = ""
    """Where the table is, from the report's folder; `tables/NAME.parquet` by default."""
    tables: list[ReportTable] = field(default_factory=list)
    """What it found where there is no article to compare with; shown first."""


def write_report(path: Path, sections: list[Section], title: str = "") -> None:
    """Write the report.

    Args:
        path: the file; it is replaced whole.
        sections: the experiments, in order.
        title: of a report that is not about the article.
    """
    template = resources.files("vergence.eval.reporting") / "report.html.jinja"
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.filters["number"] = format_number
    environment.filters["span"] = format_range
    text = environment.from_string(template.read_text(encoding="utf-8")).render(
        sections=sections,
        title=title,
        versions=versions(),
        figure=_inline,
        headlines=headlines(sections),
        pairs=lambda section: [(section.name, row) for row in section.summary],
        ratio=_ratio,
    )
    partial = path.with_name(f"{path.name}.partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)


def headlines(sections: list[Section]) -> list[tuple[str, dict[str, Any]]]:
    """What a summary shows: each result that the article reports, once.

    Args:
        sections: the experiments, in order.

    Returns:
        Pairs of a section's name and a row as `SummaryRow` has it.
    """
    keys = ("experiment", "quantity", "method", "axis")
    reported = {tuple(getattr(row, key) for key in keys) for row in reported_results()}
    tabled = {key[0] for key in reported}
    return [
        (section.name, row)
        for section in sections
        for row in section.summary
        if tuple(row[key] for key in keys) in reported
        or (row["experiment"] not in tabled and row["article_low"] is not None)
    ]


def format_number(value: float) -> str:
    """Three significant digits, never with an exponent."""
    if value == 0.0:
        return "0"
    decimals = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{float(f'{value:.3g}'):.{decimals}f}"


def format_range(low: float | None, high: float | None) -> str:
    """A range, a single number, or a dash where there is none."""
    if low is None and high is None:
        return "–"
    if low is None or high is None or low == high:
        return format_number(high if low is None else low)  # type: ignore[arg-type]
    return f"{format_number(low)} to {format_number(high)}"


def _ratio(row: dict[str, Any]) -> str:
    """Ours by the article's, at the upper end."""
    theirs = row["article_high"] if row["article_high"] is not None else row["article_low"]
    ours = row["ours_high"] if row["article_high"] is not None else row["ours_low"]
    if not theirs:
        return "–"
    return f"{format_number(ours / theirs)}"


def _inline(path: Path, prefix: str) -> str:
    """An SVG file as markup whose ids are its own in a page with others."""
    text = path.read_text(encoding="utf-8")
    text = text[text.index("<svg") :]
    text = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", text)
    text = re.sub(r'href="#([^"]+)"', rf'href="#{prefix}-\1"', text)
    # the page decides how wide it is; the viewBox keeps its proportions
    head, rest = text.split(">", 1)
    head = re.sub(r'\s(width|height)="[^"]+"', "", head)
    label = path.stem.replace("-", " ")
    return f'{head} role="img" aria-label="{label}">{rest}'
