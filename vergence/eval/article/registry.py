"""Names of the experiments; to list them, a command imports no more than this module."""

from typing import Final

EXPERIMENTS: Final[dict[str, str]] = {
    "simulated-static": "vergence.eval.article.simulated_static.experiment:EXPERIMENT",
    "simulated-moving": "vergence.eval.article.simulated_moving.experiment:EXPERIMENT",
    "physical-static": "vergence.eval.article.physical_static.experiment:EXPERIMENT",
    "physical-moving": "vergence.eval.article.physical_moving.experiment:EXPERIMENT",
    "fixed-pair": "vergence.eval.article.fixed_pair.experiment:EXPERIMENT",
    "gain-sweep": "vergence.eval.article.gain_sweep.experiment:EXPERIMENT",
    "time-response": "vergence.eval.article.time_response.experiment:EXPERIMENT",
    "uncertainty": "vergence.eval.article.uncertainty.experiment:EXPERIMENT",
    "head-eye": "vergence.eval.article.head_eye.experiment:EXPERIMENT",
}
"""Entry points, `module:attribute`, of the experiments by name, in the article's order."""
