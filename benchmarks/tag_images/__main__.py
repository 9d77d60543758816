"""Entry point of ``python -m benchmarks.tag_images``; see the package."""

import argparse
import json
import random
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import pandas as pd

from benchmarks.tag_images import __doc__ as about
from benchmarks.tag_images.catalogue import VARIATIONS
from benchmarks.tag_images.methods import METHODS, make_methods
from benchmarks.tag_images.photographs import read_photographs
from benchmarks.tag_images.scores import voted
from benchmarks.tag_images.table import TOTAL, run, summary, times_ms
from vergence.errors import VergenceError


def say(text: str) -> None:
    """Print a line of progress on stderr."""
    print(f"\r{text:<60}", end="" if sys.stderr.isatty() else "\n", file=sys.stderr, flush=True)


def tables(result: pd.DataFrame, times: dict[str, float]) -> str:
    """Summary as a Markdown table: a row per variation, rate and centre rms of each method."""
    methods = list(times)
    cells = {(row["variation"], row["method"]): row for row in result.to_dict(orient="records")}
    lines = [
        "Share found in percent / centre rms px; below, over all variations.",
        "",
        "| variation | tags | " + " | ".join(methods) + " |",
        "|---|---:|" + "---:|" * len(methods),
    ]
    for variation in dict.fromkeys(result["variation"]):
        each = [cells[variation, name] for name in methods]
        shown = [f"{100 * cell['rate']:.1f} / {cell['centre_rms_px']:.3f}" for cell in each]
        lines.append(f"| {variation} | {each[0]['tags']} | " + " | ".join(shown) + " |")
    totals = [cells[TOTAL, name] for name in methods]
    last = {
        "corner rms px": [f"{cell['corner_rms_px']:.3f}" for cell in totals],
        "centre rms px where all find it": [f"{c['shared_centre_rms_px']:.3f}" for c in totals],
        "corner rms px where all find it": [f"{c['shared_corner_rms_px']:.3f}" for c in totals],
        "ids known nowhere in the photograph": [str(cell["wrong"]) for cell in totals],
        "ids known elsewhere in it": [str(cell["stray"]) for cell in totals],
        "ms a whole photograph": [f"{times[name]:.1f}" for name in methods],
    }
    lines += [f"| {title} | | " + " | ".join(each) + " |" for title, each in last.items()]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.tag_images",
        description=about,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, help="photographs with text files of corners")
    parser.add_argument("--family", default="36h11", help="of the tags (default: 36h11)")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS, metavar="NAME")
    parser.add_argument("--quick", action="store_true", help="a third of the variations")
    parser.add_argument("--draws", type=int, default=1, help="of each random variation of a tag")
    parser.add_argument("--tags", type=int, help="vary so many, chosen at random but always alike")
    parser.add_argument("--repeats", type=int, default=5, help="of each timing")
    parser.add_argument("--json", type=Path, help="file for the table, times, wrong ids")
    parser.add_argument("--csv", type=Path, help="file for the table")
    given = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    try:
        photographs = read_photographs(given.folder)
    except VergenceError as error:
        parser.error(str(error))
    methods = make_methods(given.methods, given.family, lambda text: say(text + "\n"))
    if not methods:
        parser.error("none of the methods is installed")
    every = [
        (p, t) for p, photograph in enumerate(photographs) for t in range(len(photograph.tags))
    ]
    if given.tags is not None:
        every = random.Random(0).sample(every, min(given.tags, len(every)))
    placed, chosen = [], []
    for p in sorted({p for p, _ in every}):
        say(f"median of {photographs[p].name}")
        placed.append(voted(photographs[p], methods))
        chosen.append(sorted(t for q, t in every if q == p))
    variations = [one for one in VARIATIONS if one.quick or not given.quick]
    rows = run(placed, chosen, methods, variations, given.draws, say)
    result, times = summary(rows), times_ms(placed, methods, given.repeats)
    print(file=sys.stderr)
    print(tables(result, times))
    if given.csv is not None:
        result.round(5).to_csv(given.csv, index=False)
    if given.json is not None:
        false = rows.loc[
            rows["wrong"] > 0, ["photograph", "tag", "variation", "draw", "method", "wrong_ids"]
        ]
        kept_tables = {
            "folder": given.folder.name,
            "family": given.family,
            "photographs": len(placed),
            "varied_tags": len(every),
            "table": json.loads(result.round(5).to_json(orient="records")),
            "ms_a_photograph": {name: round(value, 3) for name, value in times.items()},
            "wrong_ids": false.to_dict(orient="records"),
        }
        given.json.write_text(json.dumps(kept_tables, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
