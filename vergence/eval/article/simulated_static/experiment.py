"""Static targets on the simulated rig: Table 3, Figures 6 and 7."""

from typing import Final

from vergence.eval.article.experiment import Experiment
from vergence.eval.article.simulated_static.figures import draw
from vergence.eval.article.simulated_static.findings import numbers, summarise
from vergence.eval.article.simulated_static.trials import NAME, SimulatedStaticConfig, run
from vergence.reporting.text import read_template

EXPERIMENT: Final = Experiment(
    name=NAME,
    title="Static targets on the simulated rig",
    article="Section 5.1.1, Tables 2 and 3, Figures 6 and 7",
    text=read_template(__package__),
    config=SimulatedStaticConfig,
    quick={"samples": 60, "point_step": 10, "heads": 20},
    run=run,
    summarise=summarise,
    numbers=numbers,
    draw=draw,
)
