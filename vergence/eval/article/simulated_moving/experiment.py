"""A moving target on the simulated rig: Figure 8."""

from typing import Final

from vergence.eval.article.experiment import Experiment
from vergence.eval.article.simulated_moving.figures import draw
from vergence.eval.article.simulated_moving.findings import numbers, summarise
from vergence.eval.article.simulated_moving.trials import NAME, SimulatedMovingConfig, run
from vergence.reporting.text import read_template

EXPERIMENT: Final = Experiment(
    name=NAME,
    title="A moving target on the simulated rig",
    article="Section 5.1.1, Figure 8",
    text=read_template(__package__),
    config=SimulatedMovingConfig,
    quick={"samples": 420},
    run=run,
    summarise=summarise,
    numbers=numbers,
    draw=draw,
)
