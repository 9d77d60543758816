"""Uncertainty: propagated, by Monte Carlo, of the closed loop, and its least."""

from typing import Final

from vergence.eval.article.experiment import Experiment
from vergence.eval.article.uncertainty.figures import draw
from vergence.eval.article.uncertainty.findings import conclude, summarise
from vergence.eval.article.uncertainty.trials import NAME, UncertaintyConfig, run

EXPERIMENT: Final = Experiment(
    name=NAME,
    title="Uncertainty",
    article="Section 4, Eqs. 25 to 36",
    what=(
        "Three questions about the simulated rig's uncertainty. (a) Do Eqs. 27 to 36 say what "
        "detections of the real detector in drawn images scatter by? The eyes stay fixed on each "
        "of Table 3's points, and on some to the side; each image's detection gives the angles "
        "that the eyes would turn to, or the two rays. (b) How much of that noise do the eyes "
        "follow? The loop is closed at several gains, with white noise and with images, beside "
        "the variance that the loop's transfer function from pixel to axis predicts.\n\n"
        "(c) What is the least error that n frames allow? The Cramer-Rao bound of the corner's "
        "pixel follows from the images' derivatives, once from the window that the detector uses, "
        "all else known, and once from the whole board, its pose unknown. Beside it stand means of "
        "n detections, of a still target anywhere within a pixel and of one dithered over a pixel."
    ),
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
    draw=draw,
    conclude=conclude,
)
