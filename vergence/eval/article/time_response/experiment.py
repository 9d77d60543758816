"""The physical time response: settling time of a gaze shift from the article's initial pixels."""

from typing import Final

from vergence.eval.article.experiment import Experiment
from vergence.eval.article.time_response.figures import draw
from vergence.eval.article.time_response.findings import numbers, summarise
from vergence.eval.article.time_response.trials import TimeResponseConfig, run
from vergence.reporting.text import read_template

EXPERIMENT: Final = Experiment(
    name="time-response",
    title="Physical time response",
    article="Section 5.3.2",
    text=read_template(__package__),
    config=TimeResponseConfig,
    quick={"trials": 20, "delays_frames": (0, 2, 4, 6, 8, 10, 12)},
    run=run,
    summarise=summarise,
    numbers=numbers,
    draw=draw,
)
