"""Keep the numbers quoted by README and docs from run folders, and fill them into documents.

    python -m benchmarks.quoted RUN... --out docs/results/evaluate.csv
    python -m benchmarks.quoted --fill README.md docs/*.md

The first command extracts the quoted rows and columns of a table from run folders of `vergence
evaluate`, to six digits. Several folders make one table; rows with the same name must agree.
`NAME=RUN` renames the head of a run, for example of a head file that is no preset. `--keep` keeps
rows of the output file that no folder has. Quoted numbers that are missing are listed on stderr.

The second command rewrites the cells of tables by the comments below them, see `benchmarks.marks`,
and the rows generated from the code, see `benchmarks.made`. It lists the numbers of the text that
disagree and returns 1 if there are any.
"""

import argparse
import sys
from collections.abc import Hashable, Iterable
from pathlib import Path

import pandas as pd

from benchmarks.kept import KEPT, ROOT, Kept, numbers_of, tables
from benchmarks.made import made
from benchmarks.marks import Tables, filled, stated_numbers

DOCUMENTS = ("README.md", "docs/*.md")


class QuotedError(Exception):
    """Raised if run folders do not give one table."""


def documents(root: Path = ROOT) -> list[Path]:
    """Paths of README and docs."""
    return [path for pattern in DOCUMENTS for path in sorted(root.glob(pattern))]


def quoted_keys(name: str, files: Iterable[Path]) -> list[str]:
    """Keys of a table's numbers that documents quote, each once."""
    stated = (one for file in files for one in stated_numbers(file.read_text(encoding="utf-8")))
    return list(dict.fromkeys(one.key.strip("/") for one in stated if one.table == name))


def kept_of(sources: Iterable[tuple[str, Path]], kept: Kept, keys: Iterable[str]) -> pd.DataFrame:
    """Table of the quoted rows and columns of run folders.

    Args:
        sources: (name, folder) pairs; the name replaces that of the head unless it is empty.
        kept: description of the table.
        keys: keys of the quoted numbers.

    Returns:
        Table with the quoted rows that exist, in the order of the folders.

    Raises:
        QuotedError: two folders disagree on a row, or there is no such folder.
    """
    names = [key.rpartition("/") for key in keys]
    rows = {row for row, _, _ in names}
    columns = dict.fromkeys((*kept.always, *(column for _, _, column in names)))
    found: dict[str, dict[str, str]] = {}
    whence: dict[str, tuple[str, Path]] = {}
    for head, source in sources:
        for record in _records(source, kept, head):
            name = "/".join(str(record[column]) for column in kept.columns)
            if name not in rows:
                continue
            row = {column: _rounded(record.get(column)) for column in (*kept.columns, *columns)}
            other = found.setdefault(name, row)
            own = _rounded(record.get("head"))
            whose, before = whence.setdefault(name, (own, source))
            for what, one, another in (
                (f"{name}: head", whose, own or whose),  # a kept table may lack the head
                *((f"{name}/{column}", other[column], row[column]) for column in columns),
            ):
                if one != another:
                    raise QuotedError(
                        f"{what}: expected one, got {one or 'none'} in {before} and "
                        f"{another or 'none'} in {source}"
                    )
    table = pd.DataFrame(list(found.values()), columns=[*kept.columns, *columns], dtype=object)
    return table.loc[:, (table != "").any()] if len(table) else table


def _records(source: Path, kept: Kept, head: str) -> list[dict[Hashable, object]]:
    try:
        table = pd.read_csv(source / kept.source if source.is_dir() else source)
    except (OSError, ValueError) as error:
        raise QuotedError(f"{source}: expected a run folder with {kept.source}: {error}") from error
    lacking = set(kept.columns) - {*table.columns, *(["head"] if head else [])}
    if lacking:
        raise QuotedError(f"{source}: expected columns {', '.join(sorted(lacking))}, got none")
    if head:
        table["head"] = head
    return table.to_dict("records")


def _rounded(value: object) -> str:
    """Value as text in the table; numbers have six digits, none is empty."""
    if value is None or value != value:
        return ""
    return f"{value:.6g}" if isinstance(value, int | float) else str(value)


def refill(file: Path, numbers: Tables) -> list[str]:
    """Rewrite the cells of a document's tables.

    Args:
        file: the document.
        numbers: look-up functions from keys to numbers, by table.

    Returns:
        Messages on numbers that disagree: place, number and source.
    """
    before = file.read_text(encoding="utf-8")
    try:
        after = made(filled(before, numbers))
        stated = list(stated_numbers(after))
    except AssertionError as error:
        raise QuotedError(f"{file}: {error}") from error
    if after != before:
        file.write_text(after, encoding="utf-8")
    found = []
    for one in stated:
        line = after.count("\n", 0, one.begin) + 1
        try:
            value = one.value(numbers)
        except KeyError:
            found.append(f"{file}:{line}: {one.text}, but there is no {one.key}")
            continue
        if not one.agrees_with(value):
            found.append(f"{file}:{line}: {one.wrong(value)}")
    return found


def keep(sources: list[str], out: Path, *, keep_others: bool) -> list[str]:
    """Write the table of a result file from the numbers that README and docs quote of it.

    Returns:
        Messages on quoted numbers that the table lacks.

    Raises:
        QuotedError: the folders do not give the table.
    """
    kept = KEPT.get(out.stem)
    if kept is None or not kept.source:
        known = ", ".join(f"{name}.csv" for name, one in KEPT.items() if one.source)
        raise QuotedError(f"--out: expected one of {known}, got {out.name}")
    keys = quoted_keys(out.stem, documents())
    if not keys:
        raise QuotedError(f"--out: expected a table that README or docs quote, got {out.name}")
    named = [source.rpartition("=") for source in sources]
    table = kept_of([(head, Path(folder)) for head, _, folder in named], kept, keys)
    if keep_others and out.exists():
        table = _beside(table, kept_of([("", out)], kept, keys), list(kept.columns))
    out.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(out, index=False)
    print(f"{out}: {len(table)} rows, {len(table.columns)} columns")
    there = numbers_of(out, kept.columns)
    return [f"{out}: no {key}" for key in keys if key not in there]


def _beside(table: pd.DataFrame, before: pd.DataFrame, columns: list[str]) -> pd.DataFrame:
    """Table with the additional rows of another one appended."""
    new = set(map(tuple, table[columns].to_numpy().tolist()))
    old = [tuple(row) not in new for row in before[columns].to_numpy().tolist()]
    return pd.concat([table, before[old]], ignore_index=True)


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("runs", nargs="*", metavar="[NAME=]RUN", help="run folders, or tables kept")
    parser.add_argument("--out", type=Path, metavar="FILE", help="the table to make of them")
    parser.add_argument("--keep", action="store_true", help="keep rows of it that no run has")
    parser.add_argument("--fill", type=Path, nargs="+", metavar="FILE", help="documents to fill")
    options = parser.parse_args(arguments)
    if (options.out is None) != (not options.runs) or not (options.runs or options.fill):
        parser.error("expected run folders with --out, or --fill")
    try:
        missing = keep(options.runs, options.out, keep_others=options.keep) if options.runs else []
        wrong = [line for file in options.fill or () for line in refill(file, tables())]
    except (QuotedError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    for line in (*missing, *wrong):
        print(line, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
