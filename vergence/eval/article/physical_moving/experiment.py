"""The physical twin on a moving target: Figures 12 and 13."""

from typing import Final

from vergence.eval.article.experiment import Experiment
from vergence.eval.article.physical_moving.figures import draw
from vergence.eval.article.physical_moving.findings import numbers, summarise
from vergence.eval.article.physical_moving.trials import PhysicalMovingConfig, run
from vergence.reporting.text import read_template

EXPERIMENT: Final = Experiment(
    name="physical-moving",
    title="Physical twin, moving target",
    article="Section 5.1.2, Figures 12 and 13",
    text=read_template(__package__),
    config=PhysicalMovingConfig,
    quick={
        "heads": 40,
        "every": 4,
        "table_every": 10,
        "speed_m_s": 0.03,
        "noise_poses": 2,
        "noise_frames": 10,
    },
    run=run,
    summarise=summarise,
    numbers=numbers,
    draw=draw,
)
