"""Score a controller in training on validation trials, and compare it with the best fixed laws."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from vergence.controllers.controller import Controller, make_controller
from vergence.controllers.tuned import find_tuned_or_fallback, is_tuned_for
from vergence.eval.trials.run import Trials, headline_metric, run_trials
from vergence.eval.trials.scenarios import Scenario
from vergence.models.head import HeadModel

BASELINES: Final = ("ibvs-tuned", "state-feedback", "saccade")
"""Controllers that a learned one is compared with during training: the article's law with the best
constant gain, and the laws that use the predictor of the learned one's inputs."""
MOVING_TARGET_BASELINES: Final = ("ibvs-tuned", "pursuit")
"""Controllers for this comparison if targets move."""


@dataclass(frozen=True, kw_only=True)
class ValidationScore:
    """Result of an evaluation."""

    headline: float
    """Median settling time to the leading band, s, with the whole trial's duration for a failure;
    for moving targets the median tracking RMS, px."""
    mean: float
    """Mean of this metric."""
    settled_fraction: float
    """Fraction of the trials that settle, or of the moving targets that are not lost."""

    @classmethod
    def of(cls, trials: Trials) -> "ValidationScore":
        """Score of a set of trials."""
        if trials.target_moves:
            values, good = trials.tracking_px, ~trials.lost
        else:
            band_px = trials.band_px
            values = trials.settle_or_trial_s(band_px)
            good = np.isfinite(trials.settle_s(band_px))
        return cls(
            headline=headline_metric(trials),
            mean=float(np.mean(values)),
            settled_fraction=float(np.mean(good)),
        )

    def rank(self, baseline: "ValidationScore") -> tuple[float, float, float]:
        """Sort key, smaller is better: failures in excess of the baseline's, then the metric.

        Median settling times are multiples of the control period; the mean decides between equals.
        """
        excess = max(0.0, baseline.settled_fraction - self.settled_fraction)
        return excess, self.headline, self.mean


class Validation:
    """Evaluates controllers, always on the same validation trials.

    Args:
        scenario: scenario of the trials.
        head: the head.
        plant: plant that moves the heads.
        seed: seed that selects the validation trials.
        episodes: number of trials.

    Attributes:
        baselines: scores by name; the name says so if the controller's options were tuned for
            another head.
    """

    def __init__(
        self, scenario: Scenario, head: HeadModel, plant: str, seed: int, episodes: int
    ) -> None:
        self.unit = "px" if scenario.target_moves else "s"
        self._run: dict[str, Any] = {
            "scenario": scenario,
            "head": head,
            "plant": plant,
            "seed": seed,
            "episodes": episodes,
            "split": "validation",
        }
        self.baselines: dict[str, ValidationScore] = {}
        for name in MOVING_TARGET_BASELINES if scenario.target_moves else BASELINES:
            entry = find_tuned_or_fallback(name, scenario.name, head)
            if entry is not None:
                label = name if is_tuned_for(entry, head) else f"{name} (untuned for this head)"
                self.baselines[label] = self.score(make_controller(name, head, **entry.options))
            else:  # default options; the plain article's law in place of one with a tuned gain
                name = "ibvs" if name == "ibvs-tuned" else name
                self.baselines[name] = self.score(make_controller(name, head))

    @property
    def best_baseline_score(self) -> ValidationScore:
        """Baseline with the best headline metric."""
        return min(self.baselines.values(), key=lambda score: score.headline)

    def score(self, controller: Controller) -> ValidationScore:
        """Evaluate a controller."""
        return ValidationScore.of(run_trials(controller, **self._run))
