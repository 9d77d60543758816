"""An experiment small enough for tests of everything around experiments."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from vergence.eval.article.experiment import Experiment, SummaryRow, job_rng
from vergence.models.perturbation import ModelErrors
from vergence.reporting.jobs import Mapper
from vergence.reporting.style import new_figure
from vergence.reporting.text import Numbers

NO_ERRORS = ModelErrors()


@dataclass(frozen=True, kw_only=True)
class ToyConfig:
    draws: int = 5
    scale: float = 2.0
    depths: tuple[float, ...] = (0.5, 1.0)
    errors: ModelErrors = NO_ERRORS
    log: str = ""
    """A file that gets a line whenever a job runs."""


def draw_one(seed: int, index: int, config: ToyConfig) -> dict[str, float]:
    if config.log:
        with Path(config.log).open("a") as log:
            log.write(f"{index}\n")
    value = config.scale * job_rng(seed, "toy", index).standard_normal()
    return {"index": index, "value_mm": float(value)}


def run(config: ToyConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    jobs = [partial(draw_one, seed, index, config) for index in range(config.draws)]
    return pd.DataFrame(mapper(jobs))


def summarise(table: pd.DataFrame, config: ToyConfig) -> list[SummaryRow]:
    return [
        SummaryRow(
            experiment="toy", quantity="value", method="both", axis="x", unit="mm", article_low=1.0,
            article_high=None, ours_low=float(table["value_mm"].min()),
            ours_high=float(table["value_mm"].max()), verdict="reproduced",
        )
    ]  # fmt: skip


def draw(table: pd.DataFrame, config: ToyConfig) -> dict[str, Figure]:
    figure = new_figure()
    axes = figure.add_subplot()
    axes.plot(table["index"], table["value_mm"], "o")
    # ticks take longer to draw than all else
    axes.set(xlabel="job", ylabel="value (mm)", title="a <title> & more", xticks=[], yticks=[])
    return {"toy-values": figure}


def numbers(table: pd.DataFrame, config: ToyConfig) -> Numbers:
    return {"count": len(table), "mean_mm": float(table["value_mm"].mean())}


TEXT = """
{% block what %}
It draws {{ config.draws }} numbers.

And writes
them down.
{% endblock %}
{% block found %}
The mean of {{ count | fixed }} values is {{ mean_mm | fixed(3) }} mm.
{% endblock %}
{% block headline %}
All {{ count | fixed }} numbers were drawn.
{% endblock %}
{% block caption_toy_values %}
Each of {{ config.draws }} values is a dot. They scatter.
{% endblock %}
"""

EXPERIMENT = Experiment(
    name="toy", title="A toy <experiment>", article="Section 0", text=TEXT, config=ToyConfig,
    quick={"draws": 2}, run=run, summarise=summarise, numbers=numbers, draw=draw,
)  # fmt: skip
