"""Draw the learning curves of several training runs, to compare seeds.

Run ``python benchmarks/learning_curves.py RUN... --out docs/images/learning_curves``, with the run
folders of ``vergence train``. Runs of the same kind share a panel. It also prints the
validation results of the best checkpoint of each run. See ``docs/learning.md``.
"""

import argparse
import sys
import tomllib
from itertools import cycle
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table

from vergence.reporting.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    figure_style,
    new_figure,
    save_figure,
)

STYLES = ((BLUE, "-"), (ORANGE, "--"), (GREEN, "-."), (PURPLE, ":"))


def read_run(folder: Path) -> tuple[dict[str, Any], pd.DataFrame]:
    """Read the configuration and the learning curve of a run folder."""
    content = tomllib.loads((folder / "config.toml").read_text(encoding="utf-8"))
    return content["config"], pd.read_csv(folder / "curve.csv")


def main(arguments: list[str] | None = None) -> int:
    """Draw the figure and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path, help="run folders of vergence train")
    parser.add_argument("--out", type=Path, required=True, help="figure, without its suffix")
    options = parser.parse_args(arguments)
    try:
        runs = [read_run(folder) for folder in options.runs]
    except (OSError, tomllib.TOMLDecodeError) as error:
        print(f"expected run folders of vergence train, got {error}", file=sys.stderr)
        return 2
    kinds = list(dict.fromkeys(config["kind"] for config, _curve in runs))
    table = Table("run", "seed", "steps", "best at", "median (s)", "settled", "faster")
    with figure_style():
        figure = new_figure(4.8 * len(kinds), 4.4)
        panels = figure.subplots(1, len(kinds), squeeze=False, sharey=True)[0]
        for panel, kind in zip(panels, kinds, strict=True):
            own = [(config, curve) for config, curve in runs if config["kind"] == kind]
            for (config, curve), (colour, dash) in zip(own, cycle(STYLES), strict=False):
                panel.plot(curve["step"] / 1e6, curve["headline"], color=colour, linestyle=dash,
                           label=f"seed {config['seed']}")  # fmt: skip
            panel.axhline(own[0][1]["baseline"].iloc[0], color=GREY, linestyle=(0, (1, 1)),
                          label="best fixed law")  # fmt: skip
            panel.set_yscale("log")
            ticks = [0.2, 0.3, 0.5, 1.0, 2.0]
            panel.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
            panel.minorticks_off()
            panel.set(xlabel="million control steps", title=kind.replace("-", " "))
            panel.legend()
        panels[0].set_ylabel("validation: median settle time (s)")
    for config, curve in runs:
        best = curve[curve["best"].astype(bool)].iloc[-1]
        table.add_row(
            config["kind"], str(config["seed"]), f"{config['steps']:,}", f"{int(best['step']):,}",
            f"{best['headline']:.3f}", f"{best['settled_fraction']:.1%}", f"{best['gain']:.2f}",
        )  # fmt: skip
    Console(highlight=False).print(table)
    save_figure(figure, options.out)
    options.out.with_suffix(".svg").unlink()  # documents show the PNG
    return 0


if __name__ == "__main__":
    sys.exit(main())
