"""Generate rows of the docs' tables from the code.

A comment below a Markdown table names the generator: `<!-- rows imperfections -->`.
"""

import re
from collections.abc import Callable, Mapping
from math import inf
from typing import Final

from benchmarks.marks import text_above
from vergence.envs.plants.conditions import IMPERFECTIONS
from vergence.eval.margins.run import IMPERFECTION_RANGES

_MARK: Final = re.compile(r"<!-- rows (\w+) -->")


def imperfections() -> list[str]:
    """Rows of the imperfections: name, unit, range, default value, description."""
    rows = []
    for name, one in IMPERFECTIONS.items():
        below = "below " if one.unit == "s" else ""
        span = f"{one.least:g} to {below}{one.most:g}" if one.most < inf else f"from {one.least:g}"
        said = f"`{one.head_path}`" if one.head_path else f"{one.default:g}"
        rows.append(f"| `{name}` | {one.unit} | {span} | {said} | {one.description} |")
    return rows


def searched() -> list[str]:
    """Rows of the imperfections whose margins are searched: name, unit, range."""
    return [
        f"| `{name}` | {IMPERFECTIONS[name].unit} | {one.lowest:g} to {one.highest:g} |"
        for name, one in IMPERFECTION_RANGES.items()
    ]


ROWS: Final[Mapping[str, Callable[[], list[str]]]] = {
    "imperfections": imperfections,
    "searched": searched,
}


def made(document: str) -> str:
    """Document with the rows of its marked tables generated anew; their headings stay."""
    pieces, done = [], 0
    for mark in _MARK.finditer(document):
        begin, above = text_above(document, mark)
        head = above.splitlines()[:2]
        pieces += [document[done:begin], "\n".join([*head, *ROWS[mark[1]]()])]
        done = begin + len(above)
    return "".join([*pieces, document[done:]])
