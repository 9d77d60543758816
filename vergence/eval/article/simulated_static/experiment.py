"""Static targets on the simulated rig: Table 3, Figures 6 and 7."""

from typing import Final

from vergence.eval.article.experiment import Experiment
from vergence.eval.article.simulated_static.conclusion import conclude
from vergence.eval.article.simulated_static.figures import draw
from vergence.eval.article.simulated_static.summary import summarise
from vergence.eval.article.simulated_static.trials import NAME, SimulatedStaticConfig, run

EXPERIMENT: Final = Experiment(
    name=NAME,
    title="Static targets on the simulated rig",
    article="Section 5.1.1, Tables 2 and 3, Figures 6 and 7",
    what=(
        "The simulated head looks at the upper right corner of a checkerboard at each of Table 3's "
        "21 points, 0.5 to 2.5 m ahead. The eyes start at rest and the loop is closed over drawn "
        "images and a real detector, with the article's law at its gain of 4. Once settled, 1150 "
        "images are triangulated by gaze and, with the joint angles of their own exposure, from "
        "the two pixels (ITPC-style, reconstructed). The error is that of the mean, the standard "
        "deviation that of single fixes, and the uncertainty is the sample standard deviation of "
        "the detections (Eqs. 25 and 26) propagated by Eqs. 27 to 36.\n\n"
        "The model is exact; or has Table 2's principal point of (520.5, 430.5) where the images' "
        "centre is (519.5, 429.5); or differs from the true head by drawn errors of links, joints, "
        "head-eye transforms and intrinsics, for one head with images and for many without. A "
        "dithered fixation holds the target at a grid of places within a pixel around the "
        "principal point and averages the fixes, gaze corrected by what is left of the pixel error."
    ),
    config=SimulatedStaticConfig,
    quick={"samples": 60, "point_step": 10, "heads": 20},
    run=run,
    summarise=summarise,
    draw=draw,
    conclude=conclude,
)
