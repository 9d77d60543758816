"""The gain sweep (Fig. 15): settling time and overshoot of a step, and the implied loop delay."""

from typing import Final

from vergence.eval.article.experiment import Experiment
from vergence.eval.article.gain_sweep.figures import draw
from vergence.eval.article.gain_sweep.findings import numbers, summarise
from vergence.eval.article.gain_sweep.trials import GainSweepConfig, run
from vergence.reporting.text import read_template

EXPERIMENT: Final = Experiment(
    name="gain-sweep",
    title="Gain sweep",
    article="Section 5.3.1, Fig. 15",
    text=read_template(__package__),
    config=GainSweepConfig,
    quick={"gain_step": 0.25, "plane_step": 0.5, "lag_step_s": 0.005, "mujoco_gains": (1.0, 4.0)},
    run=run,
    summarise=summarise,
    numbers=numbers,
    draw=draw,
)
