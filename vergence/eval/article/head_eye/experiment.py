"""The article's future work as an experiment: its head calibrated from its own movements."""

from typing import Final

from vergence.eval.article.experiment import Experiment
from vergence.eval.article.head_eye.figures import draw
from vergence.eval.article.head_eye.findings import numbers, summarise
from vergence.eval.article.head_eye.trials import HeadEyeConfig, run
from vergence.reporting.text import read_template

EXPERIMENT: Final = Experiment(
    name="head-eye",
    title="Physical twin, calibrated",
    article="Sections 5.1.2 and 6, Table 5, Figure 10",
    text=read_template(__package__),
    config=HeadEyeConfig,
    quick={"heads": 4, "poses": 20},
    run=run,
    summarise=summarise,
    numbers=numbers,
    draw=draw,
)
