"""Check and fill numbers of the docs from the tables that they come from.

A comment below a paragraph or a table of a document names the source of its numbers. `TABLE` is a
name of `benchmarks.kept`, `KEY` a number of that table, which may be scaled: `KEY*1000`.

    <!-- numbers TABLE: 183 = KEY; 1.04 = KEY -->

names numbers one by one. Below a Markdown table, rows and columns name its cells: each `*` of a
column stands for the name of the row, in the order of the table; `-` names nothing. A row may be
scaled too. A cell without a number states that the table has none.

    <!-- cells TABLE
    columns: workspace/kinematic/*/settle_1px_median_s*1000; workspace/kinematic/*/faster
    rows: ibvs; saccade
    -->

A cell with a range has two numbers, `0.4 to 1.6`, and its column names both ends:

    columns: workspace/saccade/*/settles_low..settles_high
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

Tables = Mapping[str, Callable[[str], float]]
"""Look-up functions from keys to numbers, by table."""

_MARK = re.compile(r"<!-- (numbers|cells) (\S+?)[:\s]\s*(.*?)\s*-->", re.DOTALL)
_NUMBER = re.compile(r"(?<![\w.,])-?\d[\d,]*(?:\.\d+)?")
_CELL = re.compile(r"(?<=\|)[^|\n]*(?=\|)")
_SCALED = re.compile(r"(.*)\*([\d.]+)")
_ROUND = 1e-9
_DIGITS = 3
"""Significant digits of a number that is filled into a cell without one."""


class Stated(NamedTuple):
    """A number in a document, and its source."""

    text: str
    """Empty for a cell without a number."""
    table: str
    key: str
    """Key of the number in the table."""
    scale: float
    begin: int
    """Start of the text, as an index into the document."""
    cell: bool
    """True for a number in a table of the document."""

    @property
    def end(self) -> int:
        """End of the text, as an index into the document."""
        return self.begin + len(self.text)

    def value(self, tables: Tables) -> float:
        """Scaled number of the source table; nan if neither the cell nor the table has one."""
        try:
            return self.scale * tables[self.table](self.key)
        except KeyError:
            if self.text:
                raise
            return math.nan

    def agrees_with(self, value: float) -> bool:
        """True if the text is this value, rounded to the printed digits.

        Args:
            value: scaled number of the source table.
        """
        if not self.text:
            return not math.isfinite(value)
        # half a unit of the last digit, and the rounding of binary fractions
        return abs(_plain(self.text) - value) <= 0.5 * 10.0 ** -_decimals(self.text) * (1.0 + 1e-9)

    def wrong(self, value: float) -> str:
        """Message on a wrong number, with the table's number."""
        return f"{self.text or 'no number'}, but {self.key} is {value:.6g}"


class Cell(NamedTuple):
    """A cell of a document's table."""

    text: str
    begin: int
    """Start of the text, as an index into the document."""
    numbers: tuple[Stated, ...]
    """The number, or both ends of a range."""


def stated_numbers(document: str) -> Iterator[Stated]:
    """Numbers of a document whose source is named.

    Raises:
        AssertionError: a mark and the text above it do not fit.
    """
    for mark in _MARK.finditer(document):
        if mark[1] == "numbers":
            yield from _one_by_one(document, mark)
        else:
            for cell in _cells(document, mark):
                yield from cell.numbers


def disagreements(document: str, tables: Tables) -> list[str]:
    """Messages on all numbers of a document that differ from their table.

    Args:
        document: text of the document.
        tables: see `Tables`.
    """
    values = ((stated, stated.value(tables)) for stated in stated_numbers(document))
    return [stated.wrong(value) for stated, value in values if not stated.agrees_with(value)]


def filled(document: str, tables: Tables) -> str:
    """Document with its cells filled from their tables.

    A number keeps its decimals and the text around it. A number in a cell without one has three
    significant digits, or all digits before its point if these are more, or fewer if it is round.
    A cell becomes `-` if the table has no number for it.

    Args:
        document: text of the document.
        tables: see `Tables`.
    """
    pieces, done = [], 0
    for mark in _MARK.finditer(document):
        for cell in _cells(document, mark) if mark[1] == "cells" else ():
            pieces += [document[done : cell.begin], _refilled(cell, tables)]
            done = cell.begin + len(cell.text)
    return "".join([*pieces, document[done:]])


def _refilled(cell: Cell, tables: Tables) -> str:
    try:
        values = [stated.value(tables) for stated in cell.numbers]
    except KeyError:
        return cell.text  # the comment is wrong, or the table lacks the number: reported elsewhere
    if not all(math.isfinite(value) for value in values):
        return " - " if cell.numbers[0].text else cell.text
    if not cell.numbers[0].text:
        return f" {' to '.join(_shown(value, _fitting(value)) for value in values)} "
    text = cell.text
    for stated, value in reversed(list(zip(cell.numbers, values, strict=True))):
        begin, end = stated.begin - cell.begin, stated.end - cell.begin
        text = text[:begin] + _shown(value, _decimals(stated.text)) + text[end:]
    return text


def _shown(value: float, decimals: int) -> str:
    text = f"{value:,.{decimals}f}"
    return text.removeprefix("-") if float(text.replace(",", "")) == 0.0 else text


def _fitting(value: float) -> int:
    """Decimals of a number filled into a cell without one; fewer if it is round."""
    rounded = float(f"{value:.{_DIGITS - 1}e}")
    if rounded == 0.0:
        return 0
    most = max(0, _DIGITS - 1 - math.floor(math.log10(abs(rounded))))
    return next((n for n in range(most) if abs(round(value, n) - value) < _ROUND), most)


def _plain(text: str) -> float:
    return float(text.replace(",", ""))


def _decimals(text: str) -> int:
    return len(text.partition(".")[2])


def text_above(document: str, mark: re.Match[str]) -> tuple[int, str]:
    """Start and text of the paragraph or table above a mark, skipping other marks."""
    text = document[: mark.start()].rstrip()
    while text.endswith("-->"):
        text = text[: text.rindex("<!--")].rstrip()
    begin = text.rfind("\n\n") + 2 if "\n\n" in text else 0
    return begin, text[begin:]


def _scaled(key: str) -> tuple[str, float]:
    found = _SCALED.fullmatch(key)
    return (found[1], float(found[2])) if found else (key, 1.0)


def _one_by_one(document: str, mark: re.Match[str]) -> Iterator[Stated]:
    begin, above = text_above(document, mark)
    there = {found[0]: begin + found.start() for found in _NUMBER.finditer(above)}
    for pair in filter(None, re.split(r"\s*;\s*", mark[3])):
        text, _, key = pair.partition(" = ")
        assert text in there, f"{text} is not in the text above its mark"
        yield Stated(text, mark[2], *_scaled(key.strip()), begin=there[text], cell=False)


def _cells(document: str, mark: re.Match[str]) -> Iterator[Cell]:
    names = dict(line.split(":", 1) for line in mark[3].splitlines())
    columns, rows = ([word.strip() for word in names[k].split(";")] for k in ("columns", "rows"))
    begin, above = text_above(document, mark)
    lines = list(re.finditer(r"^\|.*\|$", above, re.MULTILINE))[2:]
    assert len(lines) == len(rows), f"{len(lines)} lines of a table, but {len(rows)} rows"
    for row, line in zip(rows, lines, strict=True):
        cells = list(_CELL.finditer(line[0]))[-len(columns) :]
        for column, cell in zip(columns, cells, strict=True):
            if "-" not in (row, column):
                at = begin + line.start() + cell.start()
                yield Cell(cell[0], at, _named(cell[0], at, mark[2], row, column))


def _named(text: str, at: int, table: str, row: str, column: str) -> tuple[Stated, ...]:
    """Numbers of a cell with the keys given by row and column."""
    (row, row_scale), (column, scale) = _scaled(row), _scaled(column)
    path, _, last = f"/{column}".replace("/*/", f"/{row}/")[1:].rpartition("/")
    keys = [f"{path}/{end}" if path else end for end in last.split("..")]
    found = [(one[0], at + one.start()) for one in _NUMBER.finditer(text)][: len(keys)]
    found = found or [("", at)] * len(keys)
    assert len(found) == len(keys), f"{len(keys)} numbers are named of a cell with {text.strip()}"
    return tuple(
        Stated(number, table, key, row_scale * scale, begin=begin, cell=True)
        for (number, begin), key in zip(found, keys, strict=True)
    )
