"""Run trials of one controller in one scenario, in batches, and record all that metrics need.

```python
scenario = load_scenario("workspace")
head = scenario.model()
controller = make_controller("ibvs", head)
trials = run_trials(controller, scenario, episodes=1000)
headline_metric(trials)                # s: the median time to settle to the leading band
```

Trial i is trial `first_trial + i` of `scenario.seed(split, seed)`: it has the same target, noise
and hidden conditions whichever controller runs it, alone or in a batch of a thousand.
"""

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.networks.learned import NetworkController
from vergence.envs.plant import Simulation, plant_type
from vergence.envs.reading import Reading
from vergence.envs.task import GazeTask, Policy, rollout
from vergence.errors import ConfigurationError
from vergence.eval.trials.bound import settle_bound
from vergence.eval.trials.goal import least_reachable_error
from vergence.eval.trials.recorded import trials_from_record
from vergence.eval.trials.results import Trials, headline_metric, join_trials
from vergence.eval.trials.scenarios import BaseScenario, Scenario, explaining_target_errors
from vergence.eval.trials.settling import bands_with_bound
from vergence.models.head import HeadModel
from vergence.recording import Recorder

__all__ = ["BATCH", "Trials", "headline_metric", "run_trials"]

BATCH: Final = 1000
"""Default number of trials in a batch; more only cost memory (chosen)."""
_SIMULATED_READING_FIELDS: Final = ("visible", "positions", "command")
"""Fields of readings to record in simulated trials: few, as there are many trials and errors come
from the ground truth."""
_TRUTH_FIELDS: Final = ("pixel_error", "target", "motors")


def run_trials(
    controller: Policy,
    scenario: Scenario,
    *,
    episodes: int,
    plant: str = "kinematic",
    split: str = "test",
    seed: int = 0,
    head: str | HeadModel | None = None,
    first_trial: int = 0,
    batch_size: int | None = None,
    observed_trials: int = 0,
    progress: Callable[[float], None] | None = None,
    clock_ns: Callable[[], int] = time.perf_counter_ns,
) -> Trials:
    """Run a controller on a scenario's trials.

    A trial lasts the scenario's duration, even after a success or a lost target. On a plant without
    ground truth the errors are measured ones, at the times of their exposures; a trial then runs on
    for the latency of an image, so that its last error is known too.

    Args:
        controller: any object with Stable-Baselines3's `predict`, with or without a state.
        scenario: the scenario to run.
        episodes: number of trials.
        plant: name of the plant that moves the heads.
        split: seed split: `train`, `validation` or `test`.
        seed: index of the seed within the split.
        head: a head other than the scenario's; None for the scenario's.
        first_trial: the number of the first trial.
        batch_size: trials in a batch; by default `BATCH` or the plant's limit, if that is lower.
        observed_trials: number of trials, from the first, whose observations are kept.
        progress: callback with the fraction of steps done.
        clock_ns: clock that times `predict`, in nanoseconds.

    Returns:
        The trials, in the order of their numbers.

    Raises:
        VergenceError: an argument is invalid, or an action has a wrong shape or is nan.
    """
    if episodes < 1:
        raise ConfigurationError(f"episodes: expected at least 1, got {episodes}")
    size = min(episodes, BATCH if batch_size is None else batch_size)
    if (most := plant_type(plant).max_num) is not None:
        size = min(size, most)
    if size < 1:
        raise ConfigurationError(f"batch_size: expected at least 1, got {batch_size}")
    keyed = scenario.seed(split, seed)
    parts = []
    for begin in range(0, episodes, size):
        num = min(size, episodes - begin)
        with closing(scenario.task(num, plant=plant, head=head)) as task:
            timed = InstrumentedController(
                controller, max(0, min(num, observed_trials - begin)), clock_ns
            )
            part = run_trial_batch(
                task,
                timed,
                scenario,
                plant=plant,
                seed=keyed,
                first_trial=first_trial + begin,
                progress=_share(progress, begin / episodes, num / episodes),
            )
        parts.append(part)
    return join_trials(parts)


def _share(
    progress: Callable[[float], None] | None, begin: float, share: float
) -> Callable[[float], None]:
    if progress is None:
        return lambda _fraction: None
    return lambda fraction: progress(begin + share * fraction)


class InstrumentedController:
    """Wrapper of a controller that records durations of `predict` and the first observations.

    Args:
        controller: the controller.
        observed_trials: number of trials, from the first, whose observations are kept.
        clock_ns: a clock in nanoseconds.
    """

    def __init__(
        self,
        controller: Policy,
        observed_trials: int,
        clock_ns: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        self._controller = controller
        self._observed = observed_trials
        self._clock_ns = clock_ns
        self.spent_ns: list[int] = []
        self._last_state: Any = None
        self.observations: list[NDArray[np.float32]] = []

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], Any]:
        """Call the controller's `predict` and record its duration."""
        self.observations.append(observation[: self._observed].copy())
        began = self._clock_ns()
        answer = self._controller.predict(
            observation, state=state, episode_start=episode_start, deterministic=deterministic
        )
        self.spent_ns.append(self._clock_ns() - began)
        self._last_state = answer[1]
        return answer

    def linear_law_fraction(self, steps: int) -> float:
        """Fraction of a trial's steps in which a linear law acted; nan without a network."""
        if not isinstance(self._controller, NetworkController):
            return np.nan
        return float(self._controller.linear_periods(self._last_state).mean() / steps)


def evaluated_and_run_periods(
    scenario: BaseScenario, head: HeadModel, *, simulated: bool
) -> tuple[int, int]:
    """Control periods of a trial, evaluated and run.

    Args:
        scenario: the trial's assignment.
        head: the head that runs it.
        simulated: True on a simulated plant.

    Returns:
        Number of periods to evaluate, and number to run: without a simulation more are run, as the
        last error is known only after the latency of its image.
    """
    steps = max(1, round(scenario.duration_s * head.timing.control_rate_hz))
    return steps, steps + (0 if simulated else head.timing.latency_frames)


def run_trial_batch(
    task: GazeTask,
    controller: InstrumentedController,
    scenario: BaseScenario,
    *,
    plant: str,
    seed: int = 0,
    first_trial: int = 0,
    progress: Callable[[float], None] = lambda _fraction: None,
) -> Trials:
    """Run one batch of trials in a task, which the rollout then closes.

    Args:
        task: the task, one head per trial.
        controller: the controller.
        scenario: the scenario to run.
        plant: name of the plant.
        seed: seed of the trials' random streams.
        first_trial: the number of the first trial.
        progress: callback with the fraction of steps done.

    Returns:
        The trials; without bounds if the plant is no simulation.
    """
    simulated = isinstance(task.plant, Simulation)
    steps, all_steps = evaluated_and_run_periods(scenario, task.head, simulated=simulated)
    record = Recorder(
        task,
        all_steps,
        reading=_SIMULATED_READING_FIELDS if simulated else Reading._fields,
        truth=_TRUTH_FIELDS,
    )
    known: dict[str, Any] = {}

    def keep(step: int) -> None:
        record(step)
        if step > 0:
            progress(step / all_steps)
        elif isinstance(task.plant, Simulation):
            known.update(_known_at_the_start(task, task.plant, scenario))

    with explaining_target_errors(scenario.name):
        rollout(task, controller, all_steps, keep, seed=seed, first_trial=first_trial)
    trials = trials_from_record(
        task,
        record,
        steps,
        scenario=scenario.name,
        plant=plant,
        target_moves=scenario.target_moves,
        band_px=scenario.band_px,
        catch_up_s=scenario.catch_up_s,
    )
    # a robot's rollout calls `predict` once before the first step
    first = len(controller.spent_ns) - all_steps
    asked = slice(first, first + steps)
    return replace(
        trials,
        observation=np.stack(controller.observations[asked]),
        predict_us=float(np.median(controller.spent_ns[asked])) / 1e3 / task.num,
        linear_law_fraction=controller.linear_law_fraction(all_steps),
        **known,
    )


def _known_at_the_start(
    task: GazeTask, plant: Simulation, scenario: BaseScenario
) -> dict[str, Any]:
    """Onsets, bounds and residuals of simulated trials that have just begun."""
    known: dict[str, Any] = {"onset_s": plant.onset_s()}
    if not scenario.target_moves:
        bands = bands_with_bound(scenario.band_px)
        known["bounds_s"] = {band.px: settle_bound(task, band.px) for band in bands}
        known["residual"] = least_reachable_error(task, plant.truth_at_rest().target)
    return known
