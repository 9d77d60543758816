"""The physical twin on static targets: Table 5, Figures 10 and 11."""

from typing import Final

from vergence.eval.article.experiment import Experiment
from vergence.eval.article.physical_static.figures import draw
from vergence.eval.article.physical_static.findings import numbers, summarise
from vergence.eval.article.physical_static.trials import PhysicalStaticConfig, run
from vergence.reporting.text import read_template

EXPERIMENT: Final = Experiment(
    name="physical-static",
    title="Physical twin, static targets",
    article="Section 5.1.2, Table 5, Figures 10 and 11",
    text=read_template(__package__),
    config=PhysicalStaticConfig,
    quick={
        "heads": 40,
        "imaged_every": 5,
        "samples": 60,
        "noise_poses": 2,
        "noise_frames": 10,
        "offsets_px": (0.0, 100.0, 200.0, 300.0),
    },
    run=run,
    summarise=summarise,
    numbers=numbers,
    draw=draw,
)
