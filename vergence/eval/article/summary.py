"""The article's results beside ours, each once: the rows, tally and ratios of a report's top."""

from collections import Counter
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
from vergence.reporting.report import ArticleSummary, ReportSection
from vergence.reporting.text import NONE, format_number

_VERDICT_PHRASES: Final = {
    SAME_ORDER: "of the same order",
    DIFFERS: "farther apart",
    BY_CONSTRUCTION: "by construction",
    NO_FIGURE: "without a figure of ours",
}
"""Words of the headline's sentence for the verdicts below `reproduced`."""


def summarise_article(sections: list[ReportSection]) -> ArticleSummary:
    """Summarise sections for `vergence.reporting.report.write_report`."""
    return ArticleSummary(
        rows=article_summary_rows(sections),
        tally=count_verdicts(sections),
        reported=len(reported_results()),
        phrases=_VERDICT_PHRASES,
        verdicts=VERDICTS,
        other_verdicts=OTHER_VERDICTS,
        ratio=_ratio,
    )


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
