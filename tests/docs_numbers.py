"""Numbers of the docs beside the tables that they come from.

A comment below a paragraph or a table of a document says where its numbers come from. `TABLE` is a
name that the test knows, `KEY` a number of that table, which may be scaled: `KEY*1000`.

    <!-- numbers TABLE: 183 = KEY; 1.04 = KEY -->

names numbers one by one. Below a Markdown table, rows and columns name its cells: each `*` of a
column stands for what the row says, in the order of the table; `-` names nothing.

    <!-- cells TABLE
    columns: workspace/kinematic/*/settle_1px_median_s*1000; workspace/kinematic/*/faster
    rows: ibvs; saccade
    -->
"""

import re
from collections.abc import Callable, Iterator
from typing import NamedTuple

_MARK = re.compile(r"<!-- (numbers|cells) (\S+?)[:\s]\s*(.*?)\s*-->", re.DOTALL)
_NUMBER = re.compile(r"(?<![\w.,])-?\d[\d,]*(?:\.\d+)?")


class Stated(NamedTuple):
    """A number as a document has it, and where it comes from."""

    text: str
    table: str
    key: str
    """Of the number in the table."""
    scale: float

    def agrees_with(self, value: float) -> bool:
        """Whether it is the table's number, rounded to as many digits as are printed."""
        decimals = len(self.text.partition(".")[2])
        said = float(self.text.replace(",", ""))
        # half a unit of the last digit, and what binary fractions are off by
        return abs(said - self.scale * value) <= 0.5 * 10.0**-decimals * (1.0 + 1e-9)


def stated_numbers(document: str) -> Iterator[Stated]:
    """The numbers of a document whose source is named.

    Raises:
        AssertionError: a mark and the text above it do not fit.
    """
    for mark in _MARK.finditer(document):
        kind, table, said = mark.groups()
        above = document[: mark.start()].rstrip().rpartition("\n\n")[2]
        pairs = _one_by_one(said, above) if kind == "numbers" else _cells(said, above)
        for text, key in pairs:
            name, _, scale = key.rpartition("*") if re.search(r"\*[\d.]+$", key) else (key, "", "1")
            yield Stated(text, table, name, float(scale))


def disagreements(document: str, tables: dict[str, Callable[[str], float]]) -> list[str]:
    """Each number of a document that is not its table's, with what the table has.

    Args:
        document: its text.
        tables: by name, what gives the number of a key.
    """
    found = []
    for stated in stated_numbers(document):
        value = tables[stated.table](stated.key)
        if not stated.agrees_with(value):
            found.append(f"{stated.text}, but {stated.key} is {stated.scale * value:.6g}")
    return found


def _one_by_one(said: str, above: str) -> Iterator[tuple[str, str]]:
    there = _NUMBER.findall(above)
    for pair in filter(None, re.split(r"\s*;\s*", said)):
        text, _, key = pair.partition(" = ")
        assert text in there, f"{text} is not in the text above its mark"
        yield text, key.strip()


def _cells(said: str, above: str) -> Iterator[tuple[str, str]]:
    names = dict(line.split(":", 1) for line in said.splitlines())
    columns, rows = ([word.strip() for word in names[k].split(";")] for k in ("columns", "rows"))
    lines = [line.strip("|").split("|") for line in above.splitlines() if line.startswith("|")][2:]
    assert len(lines) == len(rows), f"{len(lines)} lines of a table, but {len(rows)} rows"
    for row, cells in zip(rows, lines, strict=True):
        for column, cell in zip(columns, cells[-len(columns) :], strict=True):
            text = _NUMBER.search(cell)
            if text and "-" not in (row, column):
                yield text.group(), column.replace("/*/", f"/{row}/")
