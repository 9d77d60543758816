"""The criterion by which a result of the article counts as reproduced.

The two factors were fixed before any verdict was computed with them. The people who fixed them had
seen earlier tables of our results beside the article's. No verdict is a reason to change them.
"""

from collections import Counter
from math import isfinite, sqrt
from typing import Any, Final

from vergence.eval.article.reported import reported_results
from vergence.reporting.report import ArticleSummary, ReportSection
from vergence.reporting.text import NONE, format_number

REPRODUCED_FACTOR: Final = 1.25
"""Largest factor, in either direction, between our figure and the article's that counts as
reproduced.

A quarter either way (chosen: a round number, as the article does not report the repeatability of
its figures).
"""
SAME_ORDER_FACTOR: Final = sqrt(10.0)
"""Largest factor between figures of the same order: half a decade, so that they round to one order
of magnitude (chosen)."""

REPRODUCED: Final = "reproduced"
SAME_ORDER: Final = "same order"
DIFFERS: Final = "differs"
BY_CONSTRUCTION: Final = "by construction"
NO_FIGURE: Final = "none"

VERDICTS: Final[dict[str, str]] = {
    REPRODUCED: f"Ours and the article's figures are within a factor of {REPRODUCED_FACTOR:g}, at "
    "both ends where the article reports a range. That ranges overlap is not enough.",
    SAME_ORDER: f"Not reproduced, but within a factor of {SAME_ORDER_FACTOR:.1f} at every end.",
    DIFFERS: "Farther apart than that at one end at least.",
    BY_CONSTRUCTION: "A parameter of ours was chosen so that this figure comes near the article's: "
    "no evidence.",
    NO_FIGURE: "We have no figure, such as the time of a trial that never settles.",
}
"""Meaning of each verdict on a result of the article, the best first."""
OTHER_VERDICTS: Final[dict[str, str]] = {
    "not reported": "The article has no such figure.",
    "inside, outside": "Whether a figure lies in the range it is compared with: the article's "
    "among the middle 80 % of our heads, or ours in a range that the article gives.",
    "target met, target missed": "Whether our own target is met.",
    "agrees, differs": "Whether two ways to one figure of ours give the same, within chance.",
    "ITPC worse, ITPC better, alike": "The method's depth error beside that of gaze.",
    "head nearer, pair nearer": "Which of the two rigs is nearer to the truth.",
}
"""Meaning of the other words in a column of verdicts."""


def verdict_of_ranges(
    ours_low: float, ours_high: float, article_low: float | None, article_high: float | None
) -> str:
    """Judge a result by the factor between its figures and the article's; nan is none of ours.

    Each end of a range that the article reports is compared with the same end of ours. The worse
    end decides; an overlap does not count. If the article has one number, `article_low ==
    article_high`, both ends of ours are compared with it; None is an end that it does not report.
    """
    if not (isfinite(ours_low) and isfinite(ours_high)):
        return NO_FIGURE
    apart = ratio_above_one(*most_different_ends(ours_low, ours_high, article_low, article_high))
    if apart <= REPRODUCED_FACTOR:
        return REPRODUCED
    return SAME_ORDER if apart <= SAME_ORDER_FACTOR else DIFFERS


def most_different_ends(
    ours_low: float, ours_high: float, article_low: float | None, article_high: float | None
) -> tuple[float, float]:
    """Our figure and the article's at the end of the range where they differ most."""
    ends = ((ours_low, article_low), (ours_high, article_high))
    pairs = [(ours, article) for ours, article in ends if article is not None]
    return max(pairs, key=lambda pair: ratio_above_one(*pair))


def ratio_above_one(ours: float, article: float) -> float:
    """Ratio of two figures, inverted if below 1; inf if they differ in sign or only one is zero."""
    if ours == article:
        return 1.0
    if ours * article <= 0.0:
        return float("inf")
    ratio = ours / article
    return max(ratio, 1.0 / ratio)


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
        rows=article_summary_rows(sections), tally=count_verdicts(sections),
        reported=len(reported_results()), phrases=_VERDICT_PHRASES, verdicts=VERDICTS,
        other_verdicts=OTHER_VERDICTS, ratio=_ratio,
    )  # fmt: skip


def article_summary_rows(sections: list[ReportSection]) -> list[tuple[str, dict[str, Any]]]:
    """Pairs of a section's name and a row of its summary: each result of the article, once."""
    keys = ("experiment", "quantity", "method", "axis")
    reported = {tuple(getattr(row, key) for key in keys) for row in reported_results()}
    return [
        (section.name, row)
        for section in sections
        for row in section.summary
        if tuple(row[key] for key in keys) in reported
    ]


def count_verdicts(sections: list[ReportSection]) -> dict[str, int]:
    """Count the article's results by verdict, the best verdict first, without zeros."""
    counts = Counter(row["verdict"] for _name, row in article_summary_rows(sections))
    return {verdict: counts[verdict] for verdict in VERDICTS if counts[verdict]}


def _ratio(row: dict[str, Any]) -> str:
    """Ratio of our value to the article's, at the end of the range where they differ most."""
    article = row["article_low"], row["article_high"]
    if row["ours_low"] is None or row["ours_high"] is None or article == (None, None):
        return NONE
    ours, theirs = most_different_ends(row["ours_low"], row["ours_high"], *article)
    return format_number(ours / theirs) if theirs else NONE
