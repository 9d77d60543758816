"""How a study chooses its points: Optuna's samplers, keyed by the number of the attempt."""

from typing import Any

import numpy as np
import optuna


class PatientGrid(optuna.samplers.GridSampler):
    """Optuna's grid; it does not stop a loop that is not Optuna's own."""

    def after_trial(self, study: Any, trial: Any, state: Any, values: Any) -> None:
        """Nothing: the loop counts the points itself."""


class KeyedSampler(optuna.samplers.BaseSampler):
    """A TPE sampler that begins anew for each attempt, seeded by its number.

    A search that was stopped then goes on as if it had not been, and processes that share a study
    never draw the same numbers.

    Args:
        seed: of the search.
    """

    def __init__(self, seed: int) -> None:
        self._seed = seed

    def before_trial(self, study: Any, trial: Any) -> None:
        """See `optuna.samplers.BaseSampler`."""
        (word,) = np.random.SeedSequence([self._seed, trial.number]).generate_state(1)
        self._sampler = optuna.samplers.TPESampler(seed=int(word), multivariate=True)
        self._sampler.before_trial(study, trial)

    def infer_relative_search_space(self, study: Any, trial: Any) -> Any:
        """See `optuna.samplers.BaseSampler`."""
        return self._sampler.infer_relative_search_space(study, trial)

    def sample_relative(self, study: Any, trial: Any, search_space: Any) -> Any:
        """See `optuna.samplers.BaseSampler`."""
        return self._sampler.sample_relative(study, trial, search_space)

    def sample_independent(self, study: Any, trial: Any, name: str, distribution: Any) -> Any:
        """See `optuna.samplers.BaseSampler`."""
        return self._sampler.sample_independent(study, trial, name, distribution)
