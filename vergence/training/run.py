"""Begin training runs, and resume those that were stopped or killed."""

import dataclasses
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from vergence.errors import ConfigurationError, TrainingDivergedError
from vergence.files import atomic_files, remove_partial
from vergence.models.head import HeadModel
from vergence.reporting.runs import write_config_and_head
from vergence.training.config import PACKAGES, TrainConfig, begin_run, check_empty, load_run
from vergence.training.curve import draw_curve, write_curve
from vergence.training.learner import Learner
from vergence.training.learner_state import learner_state_dict, running_episodes_state
from vergence.training.listener import Row, TrainingListener, TrainingResult
from vergence.training.logs import make_logger
from vergence.training.run_checkpoints import RunCheckpoints
from vergence.training.validation import Validation


def train(
    folder: Path,
    config: TrainConfig,
    head: HeadModel,
    listener: TrainingListener,
    clock: Callable[[], float] = time.perf_counter,
) -> TrainingResult:
    """Train in a new run folder.

    Args:
        folder: the run folder, new or empty.
        config: the run's configuration.
        head: the head.
        listener: receives the progress.
        clock: returns seconds, for the speed in the curve.

    Returns:
        The run's result.

    Raises:
        VergenceError: the folder is not empty, or an option is invalid.
    """
    check_empty(folder)
    learner = Learner(config, head)  # before the folder is made: this raises on invalid options
    try:
        begin_run(folder, config, head)
        with _writing(folder):
            return _Run(folder, learner, listener, clock, []).go_on()
    finally:
        learner.close()


def resume(
    folder: Path,
    listener: TrainingListener,
    steps: int | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> TrainingResult:
    """Resume a run from its last checkpoint.

    The result is bit for bit the result without the interruption. If `steps` is given, a learning
    rate that falls over the run continues as in a run of that length, not of the original one.

    Args:
        folder: the run folder.
        listener: receives the progress.
        steps: new total number of steps; None for the configuration's.
        clock: returns seconds, for the speed in the curve.

    Returns:
        The run's result.

    Raises:
        ConfigurationError: the folder holds no run that can be resumed, or the run is finished.
    """
    config, head = load_run(folder)
    with _writing(folder):
        content = RunCheckpoints(folder, config, head).latest()
    done = 0 if content is None else int(content["steps"])
    if steps is not None:
        config = dataclasses.replace(config, steps=steps)
    # a finished run may have been stopped before its figure was drawn
    if done >= config.steps and (steps is not None or (folder / "curve.png").exists()):
        raise ConfigurationError(
            f"steps: expected more than the {done} steps that {folder} has learned from, "
            f"got {config.steps}"
        )
    for place in (folder, folder / "checkpoints"):
        remove_partial(place)
    learner = Learner(config, head)
    try:
        rows = []
        if content is not None:
            learner.restore(content)
            rows = list(content["curve"])
        listener.resumed(done)
        with _writing(folder):
            if steps is not None:
                with atomic_files(folder, moved_last="config.toml") as beside:
                    write_config_and_head(beside, config, head, PACKAGES)
            return _Run(folder, learner, listener, clock, rows).go_on()
    finally:
        learner.close()


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Convert an error of writing the run folder to a message on resuming the run.

    Raises:
        ConfigurationError: the folder cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise ConfigurationError(
            f"{folder}: expected a folder that can be written, got: {error.strerror or error}; "
            f"its checkpoints are as they were: vergence train --resume {folder} goes on"
        ) from error


class _Stopped(Exception):  # noqa: N818  not an error
    """Raised to stop the run at the listener's request, after it has been saved."""


class _Run(BaseCallback):
    """Evaluates and saves a learner between its rollouts."""

    def __init__(
        self,
        folder: Path,
        learner: Learner,
        listener: TrainingListener,
        clock: Callable[[], float],
        rows: list[Row],
    ) -> None:
        super().__init__()
        config = learner.config
        self._folder = folder
        self._learner = learner
        self._listener = listener
        self._clock = clock
        self._rows = rows
        self._every = max(1, config.steps // config.evaluations)
        self._validation = Validation(
            learner.scenario, learner.head, config.plant, config.seed, config.episodes
        )
        self._rewards: list[float] = []
        self._lengths: list[int] = []
        self._since = (0, 0.0)
        self._checkpoints = RunCheckpoints(folder, config, learner.head)

    def go_on(self) -> TrainingResult:
        """Train until the configuration's steps are done or the listener stops the run."""
        learner, model = self._learner, self._learner.model
        total = learner.config.steps
        listener = self._listener
        listener.begin(self._validation.baselines, self._validation.unit)
        done = model.num_timesteps
        logger = make_logger(self._folder / "tensorboard", done if self._rows else None)
        model.set_logger(logger)
        if not self._rows:
            learner.begin()
        write_curve(self._folder, self._rows)
        finished = True
        self._since = (done, self._clock())
        try:
            # `check_finite` reports numbers out of range
            with np.errstate(over="ignore", invalid="ignore"):
                if done < total:
                    self._learn(total - done)
        except _Stopped:
            finished = False
        except TrainingDivergedError as error:
            raise self._diverged(error) from error
        finally:
            logger.close()
        self._draw()
        return TrainingResult(
            folder=self._folder,
            rows=self._rows,
            baselines=self._validation.baselines,
            unit=self._validation.unit,
            steps=model.num_timesteps,
            finished=finished,
        )

    def _learn(self, steps: int) -> None:
        """Train for a number of steps, then evaluate and save."""
        self._learner.model.learn(
            steps,
            callback=self,
            reset_num_timesteps=not self._rows,
        )
        self._learner.check_finite()
        self._save()

    def _on_rollout_start(self) -> None:
        # save only here, where the networks have learned from all steps so far
        self._learner.check_finite()
        done = self.model.num_timesteps
        if not self._rows or done // self._every > self._rows[-1]["step"] // self._every:
            self._save()
        if self._listener.stopping():
            if done != self._rows[-1]["step"]:
                self._save()
            raise _Stopped

    def _on_step(self) -> bool:
        dones = self.locals["dones"]
        if dones.any():
            for i in np.flatnonzero(dones):
                episode = self.locals["infos"][i]["episode"]
                self._rewards.append(episode["r"])
                self._lengths.append(episode["l"])
        self._listener.step(self.num_timesteps, self._learner.config.steps)
        return True

    def _save(self) -> None:
        """Evaluate, and write the checkpoints and the curve."""
        model = self._learner.model
        now, (step, then) = self._clock(), self._since
        speed = (model.num_timesteps - step) / max(now - then, 1e-9)
        score = self._validation.score(self._learner.controller())
        baseline = self._validation.best_baseline_score
        rank = list(score.rank(baseline))
        best = not self._rows or rank < min(row["rank"] for row in self._rows)
        row = {
            "step": model.num_timesteps,
            "headline": score.headline,
            "settled_fraction": score.settled_fraction,
            "mean": score.mean,
            "baseline": baseline.headline,
            "gain": baseline.headline / score.headline,
            "reward": float(np.mean(self._rewards)) if self._rewards else None,
            "length": float(np.mean(self._lengths)) if self._lengths else None,
            "steps_per_s": round(speed),
            "best": best,
            "rank": rank,
        }
        self._rows.append(row)
        for name in ("headline", "settled_fraction", "mean", "baseline", "gain"):
            model.logger.record(f"validation/{name}", row[name])
        model.logger.dump(step=model.num_timesteps)
        normalisation = self._learner.normalisation
        content = {
            **learner_state_dict(model, normalisation),
            "curve": self._rows,
            "validation": dataclasses.asdict(score),
        }
        self._checkpoints.write(content, running_episodes_state(model, normalisation), best)
        write_curve(self._folder, self._rows)
        self._listener.row(row)
        self._rewards, self._lengths = [], []
        self._since = (model.num_timesteps, self._clock())

    def _diverged(self, error: TrainingDivergedError) -> TrainingDivergedError:
        rate = self._learner.config.algorithm.get("learning_rate")
        kept = f"{self._rows[-1]['step']} steps is kept" if self._rows else "0 steps was not saved"
        return TrainingDivergedError(
            f"training diverged: {error} after {self.model.num_timesteps} steps; the checkpoint "
            f"of {kept} in {self._folder}; begin a new run with a smaller --set "
            f"algorithm.learning_rate (here {rate}), as this one would end so again"
        )

    def _draw(self) -> None:
        config = self._learner.config
        draw_curve(
            self._folder,
            self._rows,
            {name: score.headline for name, score in self._validation.baselines.items()},
            f"{config.kind}, {config.scenario}, seed {config.seed}",
            self._validation.unit,
        )
