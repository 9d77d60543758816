"""Tables for terminals of any width: text wraps between words, numbers are never cut."""

from collections.abc import Sequence
from textwrap import wrap
from typing import Final

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

Row = Sequence[str]
_NAME_END_LENGTH: Final = 12
"""Characters kept of the end of a long name, usually enough to tell names apart (chosen: width
of the table against clarity)."""


def print_table(
    columns: Row,
    rows: Sequence[Row],
    *,
    title: str = "",
    wrapped: Sequence[int] = (0,),
    shortenable: Sequence[int] = (),
    console: Console | None = None,
) -> None:
    """Print rows, as cards on a narrow terminal; wrapped and shortenable are columns' indices."""
    console = console or Console(highlight=False)
    for cells in (rows, _with_short(rows, shortenable)):
        for stacked_heads, padding in ((False, 2), (True, 2), (True, 1)):
            table = _table(columns, cells, title, wrapped, padding, stacked_heads)
            if min_table_width(table) <= console.width:
                _fit(table, cells, console.width)
                console.print(table)
                return
    print_cards(columns, rows, title=title, console=console)


def print_cards(
    columns: Row, rows: Sequence[Row], *, title: str = "", console: Console | None = None
) -> None:
    """Print each row as a card: its first cell, and below it a line for each other cell."""
    console = console or Console(highlight=False)
    lines = _fitted(title, console.width, "")
    for first, *others in rows:
        lines += _fitted(" ".join(first.split()), console.width, "")
        for head, cell in zip(columns[1:], others, strict=True):
            if cell:
                lines += _fitted(f"{head}: {', '.join(cell.splitlines())}", console.width, "  ")
    for line in lines:
        console.print(line, markup=False, soft_wrap=True)


def _with_short(rows: Sequence[Row], shortenable: Sequence[int]) -> Sequence[Row]:
    """Rows with long names shortened to their ends, if these are still distinct."""
    out = [list(row) for row in rows]
    for place in shortenable:
        for length in (_NAME_END_LENGTH, 2 * _NAME_END_LENGTH):
            short = {row[place]: _end(row[place], length) for row in rows}
            if len(set(short.values())) == len(short):
                for row in out:
                    row[place] = short[row[place]]
                break
    return out


def _end(name: str, length: int) -> str:
    return name if len(name) <= length else f"…{name[1 - length :]}"


def min_table_width(table: Table) -> int:
    """Width that a table needs at least, characters; its columns must state their least width."""
    least = sum(column.min_width or 0 for column in table.columns)
    return least + len(table.columns) * (table.padding[1] + 1) - 1


def _fit(table: Table, rows: Sequence[Row], width: int) -> None:
    """Divide a terminal's spare width among the columns that wrap; rich alone would cut two."""
    spare = width - min_table_width(table)
    wanting = {
        place: max(len(row[place]) for row in rows) - (column.min_width or 0)
        for place, column in enumerate(table.columns)
        if rows and not column.no_wrap
    }
    for place, column in enumerate(table.columns):
        column.width = column.min_width
        if place in wanting:
            fair = spare // max(sum(more > 0 for more in wanting.values()), 1)
            given = min(max(wanting.pop(place), 0), fair)
            spare -= given
            column.width = (column.min_width or 0) + given


def _table(
    columns: Row,
    rows: Sequence[Row],
    title: str,
    wrapped: Sequence[int],
    padding: int,
    stacked_heads: bool,
) -> Table:
    """Table whose columns have a least width; stacked headings have one word per line."""
    table = Table(
        title=title or None, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, show_edge=False,
        padding=(0, padding, 0, 0),
    )  # fmt: skip
    for place, head in enumerate(columns):
        cells = [row[place] for row in rows]
        wraps = place in wrapped
        parts = [part for cell in cells for part in (cell.split() if wraps else cell.splitlines())]
        head_parts = head.split() if stacked_heads else [head]
        table.add_column(
            escape("\n".join(head_parts)),
            justify="left" if wraps else "right",
            no_wrap=not wraps,
            min_width=max(map(len, [*head_parts, *parts]), default=1),
        )
    for row in rows:
        table.add_row(*map(escape, row))
    return table


def _fitted(line: str, width: int, indent: str) -> list[str]:
    """Lines of a text wrapped between words, with a hanging indent; words are never broken."""
    return wrap(
        line, max(width, 10), initial_indent=indent, subsequent_indent=f"{indent}  ",
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip
