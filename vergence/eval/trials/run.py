"""Trials of one controller in one scenario, side by side, with all that metrics need.

```python
scenario = load_scenario("workspace")
head = scenario.model()
controller = make_controller("ibvs", head)
trials = run_trials(controller, scenario, episodes=1000)
headline(trials)                       # s: the median time to settle to 1 px
```

Trial i is trial `first_trial + i` of `scenario.seed(split, seed)`: the same target, the same noise
and the same hidden conditions whichever controller runs it, alone or among a thousand others.
"""

import time
from collections.abc import Callable
from contextlib import closing
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.envs.plants.imperfections import OWN, SCALARS
from vergence.envs.plants.simulation import Simulation
from vergence.envs.policy import Policy
from vergence.envs.rollout import rollout
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError
from vergence.eval.trials.bound import settle_bound
from vergence.eval.trials.goal import least_measured_error
from vergence.eval.trials.results import Trials, headline, join
from vergence.eval.trials.scenarios import Scenario, named
from vergence.eval.trials.settling import judged_bands
from vergence.models.head import HeadModel
from vergence.models.joints import EYES
from vergence.models.parts import FloatArray

__all__ = ["BATCH", "Trials", "headline", "run_trials"]

BATCH: Final = 1000
"""Trials that run side by side unless another number is given: more only cost memory."""


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
    batch: int | None = None,
    observed: int = 0,
    progress: Callable[[float], None] | None = None,
    clock_ns: Callable[[], int] = time.perf_counter_ns,
) -> Trials:
    """Run a controller on a scenario's trials.

    A trial lasts the scenario's time, also after a success or a lost target. On a plant without
    truth the errors are the measured ones at the time of their exposure; a trial then runs on for
    the image's latency, so that its last error is known too.

    Args:
        controller: anything with Stable-Baselines3's `predict`, with or without a state.
        scenario: what to run.
        episodes: how many trials.
        plant: what moves the heads.
        split: whose seeds: `train`, `validation` or `test`.
        seed: which of that split's.
        head: the head, for one other than the scenario's.
        first_trial: the number of the first trial.
        batch: how many run side by side; `BATCH` at most by default.
        observed: of how many trials, the first ones, to keep the observations.
        progress: called with the fraction of steps done.
        clock_ns: a clock in nanoseconds, to time `predict` by.

    Returns:
        The trials, in the order of their numbers.

    Raises:
        VergenceError: an argument cannot be, or an action has a wrong shape or is nan.
    """
    if episodes < 1:
        raise ConfigurationError(f"episodes: expected at least 1, got {episodes}")
    size = min(episodes, BATCH if batch is None else batch)
    if size < 1:
        raise ConfigurationError(f"batch: expected at least 1, got {batch}")
    keyed = scenario.seed(split, seed)
    parts = []
    for begin in range(0, episodes, size):
        num = min(size, episodes - begin)
        with closing(scenario.task(num, plant=plant, head=head)) as task:
            run = _Run(
                controller,
                scenario,
                task,
                observed=max(0, min(num, observed - begin)),
                progress=_share(progress, begin / episodes, num / episodes),
                clock_ns=clock_ns,
            )
            first = first_trial + begin
            with named(scenario.name):
                rollout(task, run, run.all_steps, run.record, seed=keyed, first_trial=first)
            parts.append(run.result(plant))
    return join(parts)


def _share(
    progress: Callable[[float], None] | None, begin: float, share: float
) -> Callable[[float], None]:
    if progress is None:
        return lambda _fraction: None
    return lambda fraction: progress(begin + share * fraction)


class _Run:
    """Trials that run side by side in one task: what they were, and how long `predict` took."""

    def __init__(
        self,
        controller: Policy,
        scenario: Scenario,
        task: GazeTask,
        *,
        observed: int,
        progress: Callable[[float], None],
        clock_ns: Callable[[], int],
    ) -> None:
        self.task = task
        self._controller = controller
        self._scenario = scenario
        self._progress = progress
        self._clock_ns = clock_ns
        self._simulated = isinstance(task.plant, Simulation)
        timing = task.head.timing
        self.steps = steps = max(1, round(scenario.duration_s * timing.control_rate_hz))
        self.all_steps = steps + (0 if self._simulated else timing.latency_frames)
        n = task.num
        self._error = np.full((steps + 1, n, 2, 2), np.nan)
        self._target = np.full((steps + 1, n, 3), np.nan)
        self._positions = np.empty((steps + 1, n, 7))
        self._driven = np.empty((steps + 1, n, 4))
        self._visible = np.empty((steps + 1, n, 2), dtype=np.bool_)
        self._command = np.empty((steps, n, 4))
        self._observation = np.empty((steps, observed, task.layout.size), "f4")
        self._lost = np.zeros(n, dtype=np.bool_)
        bands = judged_bands(scenario.band_px)
        self._bounds = {band.px: np.full(n, np.nan) for band in bands}
        self._onset = np.zeros(n)
        self._residual = np.zeros((n, 2, 2))
        self._spent_ns: list[int] = []

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], Any]:
        """Let the controller choose, and time it."""
        began = self._clock_ns()
        answer = self._controller.predict(
            observation, state=state, episode_start=episode_start, deterministic=deterministic
        )
        self._spent_ns.append(self._clock_ns() - began)
        return answer

    def record(self, step: int) -> None:
        """Keep the present."""
        task = self.task
        truth = task.truth()
        if truth is None:
            self._record_measured()
        if step <= self.steps:
            self._lost |= task.lost
            self._visible[step] = task.reading.visible
            self._positions[step] = task.reading.positions
            if truth is None:
                self._driven[step] = task.reading.positions[:, EYES]
            else:
                self._error[step] = truth.pixel_error
                self._target[step] = truth.target
                # where the joints would be without play, in which they may rest while gears wear
                self._driven[step] = task.head.actuation.joints_of(truth.motors)[:, EYES]
        if step < self.steps:
            self._observation[step] = task.observation[: self._observation.shape[1]]
        if 0 < step <= self.steps:
            self._command[step - 1] = task.reading.command[:, EYES]
        if step == 0 and isinstance(task.plant, Simulation):
            self._onset = task.plant.onset_s()
            if not self._scenario.moving:
                self._bounds = {px: settle_bound(task, px) for px in self._bounds}
                truth = task.plant.truth_at_rest()
                self._residual = least_measured_error(task, truth.target)
        if step > 0:
            self._progress(step / self.all_steps)

    def result(self, plant: str) -> Trials:
        """What they were."""
        task, steps = self.task, self.steps
        if not self._simulated:
            _carry_on(self._error)
            if not (self._scenario.moving or task.head.actuation.direct):
                self._residual = task.head.least_error(task.fixes()[1].point)
        return Trials(
            scenario=self._scenario.name,
            plant=plant,
            moving=self._scenario.moving,
            band_px=self._scenario.band_px,
            catch_up_s=self._scenario.catch_up_s,
            head=task.head,
            onset_s=self._onset,
            time_s=np.arange(steps + 1, dtype=np.float64) * float(task.head.timing.period_s),
            error=self._error,
            residual=self._residual,
            command=self._command,
            visible=self._visible,
            lost=self._lost,
            positions=self._positions,
            speed=np.diff(self._driven, axis=0) / float(task.head.timing.period_s),
            target=self._target,
            bounds_s=self._bounds,
            conditions=_conditions(task),
            observation=self._observation,
            predict_us=float(np.median(self._spent_ns[:steps])) / 1e3 / task.num,
        )

    def _record_measured(self) -> None:
        """Put the measured errors where their images were exposed."""
        task = self.task
        exposed = task.reading.exposure_s * task.head.timing.control_rate_hz
        known = np.isfinite(exposed) & (exposed > -0.5)
        step = np.rint(np.where(known, exposed, 0.0)).astype(np.int64)
        places = np.flatnonzero(known & (step <= self.steps))
        # what was not seen has no error, and no earlier one stands for it
        error = np.where(np.isnan(task.pixel_error), np.inf, task.pixel_error)
        self._error[step[places], places] = error[places]


def _carry_on(error: FloatArray) -> None:
    """Fill the periods without an image from the one before; before the first, from that one."""
    for step in range(1, len(error)):
        gap = np.isnan(error[step])
        error[step][gap] = error[step - 1][gap]
    for step in range(len(error) - 2, -1, -1):
        gap = np.isnan(error[step])
        error[step][gap] = error[step + 1][gap]
    error[np.isinf(error)] = np.nan


def _conditions(task: GazeTask) -> dict[str, FloatArray]:
    """What the trials run with, by name; nothing where the plant cannot tell.

    What each actuator of the eyes has of its own is a number a trial for each of them.
    """
    if not isinstance(task.plant, Simulation):
        return {}
    conditions = task.plant.conditions
    found = {name: getattr(conditions, name).copy() for name in SCALARS}
    for name in OWN:
        of_eyes = getattr(conditions, name)[:, EYES]
        for j, actuator in enumerate(task.head.actuation.names):
            found[f"{name}_{actuator}"] = of_eyes[:, j].copy()
    return found
