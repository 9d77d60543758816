"""Uncertainty: propagated, by Monte Carlo, in the closed loop, and its lower bound."""

from typing import Final

from vergence.eval.article.experiment import Experiment
from vergence.eval.article.uncertainty.figures import draw
from vergence.eval.article.uncertainty.findings import numbers, summarise
from vergence.eval.article.uncertainty.trials import NAME, UncertaintyConfig, run
from vergence.reporting.text import read_template

EXPERIMENT: Final = Experiment(
    name=NAME,
    title="Uncertainty",
    article="Section 4, Eqs. 25 to 36",
    text=read_template(__package__),
    config=UncertaintyConfig,
    quick={
        "draws": 200,
        "point_step": 10,
        "gains": (1.0, 4.0),
        "heads": 40,
        "loop_samples": 600,
        "image_gains": (4.0,),
        "image_samples": 900,
        "reach_draws": 100,
        "averaging_depths_m": (1.5, 2.5),
        "frames": 256,
        "replicates": 6,
    },
    run=run,
    summarise=summarise,
    numbers=numbers,
    draw=draw,
)
