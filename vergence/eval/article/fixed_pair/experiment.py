"""Comparison of the head with a fixed pair of cameras: Tables 6 and 7, Figure 14."""

from typing import Final

from vergence.eval.article.experiment import Experiment
from vergence.eval.article.fixed_pair.figures import draw
from vergence.eval.article.fixed_pair.findings import numbers, summarise
from vergence.eval.article.fixed_pair.trials import FixedPairConfig, run
from vergence.reporting.text import read_template

EXPERIMENT: Final = Experiment(
    name="fixed-pair",
    title="Against a fixed stereo pair",
    article="Section 5.2, Tables 6 and 7, Figure 14",
    text=read_template(__package__),
    config=FixedPairConfig,
    quick={"heads": 40, "samples": 60, "noise_poses": 2, "noise_frames": 10},
    run=run,
    summarise=summarise,
    numbers=numbers,
    draw=draw,
)
