"""How good a controller in training is: on validation trials, beside the best fixed laws."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from vergence.controllers.controller import Controller, make_controller
from vergence.controllers.tuned import find_tuned, is_for
from vergence.eval.trials.run import Trials, headline, run_trials
from vergence.eval.trials.scenarios import Scenario
from vergence.models.head import HeadModel

BASELINES: Final = ("ibvs-tuned", "state-feedback", "saccade")
"""What a learned controller is compared with while it learns: the article's law with the best
constant gain, and the laws that have the same predictor as its inputs."""
OF_MOVING: Final = ("ibvs-tuned", "pursuit")
"""The same where targets move."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """What an evaluation found."""

    headline: float
    """Median settle time to the leading band, s, a failure counting as the whole trial; or for a
    moving target the median tracking RMS, px."""
    mean: float
    """The same on average."""
    settled_fraction: float
    """Share of the trials that settle, or of the moving targets that are not lost."""

    @classmethod
    def of(cls, trials: Trials) -> "Score":
        """The score of some trials."""
        if trials.moving:
            values, good = trials.tracking_px, ~trials.lost
        else:
            band_px = trials.band_px
            values = trials.settle_or_trial_s(band_px)
            good = np.isfinite(trials.settle_s(band_px))
        return cls(
            headline=headline(trials),
            mean=float(np.mean(values)),
            settled_fraction=float(np.mean(good)),
        )

    def rank(self, baseline: "Score") -> tuple[float, float, float]:
        """Smaller is better: more failures than the baseline's first, then the metric.

        Median settle times come in whole control periods; the mean tells equal ones apart.
        """
        excess = max(0.0, baseline.settled_fraction - self.settled_fraction)
        return excess, self.headline, self.mean


class Validation:
    """Evaluates controllers on the same validation trials, again and again.

    Args:
        scenario: whose trials.
        head: the head.
        plant: what moves the heads.
        seed: which of the validation trials.
        episodes: how many.

    Attributes:
        baselines: scores by name; the name says so where the options of the tuned controller
            were found for another head.
    """

    def __init__(
        self, scenario: Scenario, head: HeadModel, plant: str, seed: int, episodes: int
    ) -> None:
        self.unit = "px" if scenario.moving else "s"
        self._run: dict[str, Any] = {
            "scenario": scenario,
            "head": head,
            "plant": plant,
            "seed": seed,
            "episodes": episodes,
            "split": "validation",
        }
        self.baselines: dict[str, Score] = {}
        for name in OF_MOVING if scenario.moving else BASELINES:
            entry = find_tuned(name, scenario.name, head)
            if entry is not None:
                label = name if is_for(entry, head) else f"{name} (untuned for this head)"
                self.baselines[label] = self.score(make_controller(name, head, **entry.options))
            else:  # with options of its own; the article's law for one that needs a tuned gain
                name = "ibvs" if name == "ibvs-tuned" else name
                self.baselines[name] = self.score(make_controller(name, head))

    @property
    def best_baseline(self) -> Score:
        """The baseline to beat."""
        return min(self.baselines.values(), key=lambda score: score.headline)

    def score(self, controller: Controller) -> Score:
        """Evaluate a controller."""
        return Score.of(run_trials(controller, **self._run))
