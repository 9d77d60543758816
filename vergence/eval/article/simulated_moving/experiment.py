"""A moving target on the simulated rig: Figure 8."""

from typing import Final

from vergence.eval.article.experiment import Experiment
from vergence.eval.article.simulated_moving.figures import draw
from vergence.eval.article.simulated_moving.findings import conclude, summarise
from vergence.eval.article.simulated_moving.trials import NAME, SimulatedMovingConfig, run

EXPERIMENT: Final = Experiment(
    name=NAME,
    title="A moving target on the simulated rig",
    article="Section 5.1.1, Figure 8",
    what=(
        "The corner of the checkerboard moves along a circle of 100 mm radius, 1 m ahead, once in "
        "62.8 s, which is 10 mm/s. The loop is closed over drawn images with the article's law at "
        "its gain of 4, and each second control step of 1/120 s gives a sample, 3780 in all. Gaze "
        "is triangulated from the present joint angles and compared with where the target is at "
        "present; ITPC from the pixels of the newest image and the joint angles of its exposure, "
        "and compared with where the target was then. What ITPC is off by when it is taken for "
        "the present is in the table too.\n\n"
        "The cases are those of the static targets. Runs without images take the errors apart: "
        "each case without noise, for what lag and the model's errors do, and the exact model with "
        "white noise of the detector's size, for what the loop's noise bandwidth does."
    ),
    config=SimulatedMovingConfig,
    quick={"samples": 420},
    run=run,
    summarise=summarise,
    draw=draw,
    conclude=conclude,
)
