"""The Gymnasium vector environment of the gaze task: many heads in one batch."""

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from vergence.envs.reading import Image
from vergence.envs.saved_state import Arrays, SavedState, copy_arrays, restore_arrays
from vergence.envs.streams import as_seed
from vergence.envs.task import GazeTask
from vergence.envs.task_env import (
    TaskEnv,
    checked_arguments,
    checked_options,
    checked_render_mode,
    control_rate,
    reset_needed,
)
from vergence.envs.validation import check_count
from vergence.errors import ConfigurationError


class GazeVectorEnv(TaskEnv, VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """A vector environment of many heads: the task of `GazeEnv`, as one batch of one plant.

    Environment i of a vector that is reset with seed s runs the trials that `GazeEnv` runs
    with seed s + i.

    Args:
        num_envs: number of heads.
        max_episode_steps: steps after which an episode is truncated; None for never.
        autoreset_mode: `NextStep`, `SameStep` or `Disabled`, see `gymnasium.vector.AutoresetMode`.
        render_mode: None or `rgb_array`.
        **options: see `vergence.envs.task.GazeTask`.
    """

    metadata: dict[str, Any]
    task_type: ClassVar[type[GazeTask]] = GazeTask

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        self.num_envs = num_envs = check_count("num_envs", num_envs)
        self.max_episode_steps = max_episode_steps
        try:
            self._autoreset = AutoresetMode(autoreset_mode)
        except ValueError as error:
            known = ", ".join(mode.value for mode in AutoresetMode)
            raise ConfigurationError(
                f"autoreset_mode: expected one of {known}, got {autoreset_mode!r}"
            ) from error
        modes = ["rgb_array"]
        self.render_mode = checked_render_mode(render_mode, modes)
        self.task = self.task_type(num_envs, **checked_arguments(type(self), options))
        self.metadata = {
            "render_modes": modes,
            "render_fps": control_rate(self.task),
            "autoreset_mode": self._autoreset,
        }
        self.single_observation_space, self.single_action_space = self.task.spaces()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._seeds = np.zeros(num_envs, dtype=np.uint64)
        self._trials = np.zeros(num_envs, dtype=np.uint64)
        self._elapsed = np.zeros(num_envs, dtype=np.int64)
        self._done = np.zeros(num_envs, dtype=np.bool_)
        self._begun = self._staggered = False

    def stagger(self) -> None:
        """Shorten the first episodes of the next `reset`, each environment's by another length.

        The episodes of a vector begin together and, with a step limit, would end together forever.
        Staggering spreads their ends evenly, as a learner needs.
        """
        self._staggered = True

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin trials, of all heads or of some.

        Args:
            seed: s begins trial 0 of seeds s, s + 1, ...; a sequence gives a seed for each,
                None for those that go on to their next trial.
            options: `{"trial": k}` or a sequence begins these trials; `{"reset_mask": mask}`
                resets only where the mask of shape (num_envs,) is True.

        Returns:
            The observations of all heads, and the info.

        Raises:
            ConfigurationError: an option is unknown or invalid, or a seed is not a whole number.
        """
        options = checked_options(options, ("trial", "reset_mask"))
        mask = _reset_mask(options.get("reset_mask"), self.num_envs)
        trials = _requested_trials(options.get("trial"), self.num_envs)
        seeds = self._requested_seeds(seed)
        if not self._begun:
            first = self.np_random.integers(2**63, size=self.num_envs, dtype=np.uint64)
            self._seeds[:] = first
            self._trials[:] = np.uint64(2**64 - 1)  # the next trial is 0
            mask[:] = True
            self._begun = True
        self._trials[mask] += np.uint64(1)
        for i, given in enumerate(seeds):
            if given is not None and mask[i]:
                self._seeds[i], self._trials[i] = given, 0
        if trials is not None:
            self._trials[mask] = trials[mask]
        self._begin(np.flatnonzero(mask))
        if self._staggered and self.max_episode_steps is not None:
            self._elapsed[:] = np.arange(self.num_envs) * self.max_episode_steps // self.num_envs
            self._staggered = False
        return self.task.observation.copy(), self._info()

    def _info(self, has: NDArray[np.bool_] | None = None) -> dict[str, Any]:
        """The info in Gymnasium's form; `has` marks the heads with an entry, None for all."""
        everywhere = np.ones(self.num_envs, dtype=np.bool_)
        return _with_masks(self.task.info(), everywhere if has is None else has)

    def _requested_seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            first = as_seed(seed)
            self._np_random, self._np_random_seed = gymnasium.utils.seeding.np_random(first)
            return [as_seed(first + i) for i in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ConfigurationError(f"seed: expected {self.num_envs} seeds, got {len(seed)}")
        return [None if one is None else as_seed(one) for one in seed]

    def _begin(self, ids: NDArray[np.int64]) -> None:
        self.task.begin(ids, self._seeds[ids], self._trials[ids])
        self._elapsed[ids] = 0
        self._done[ids] = False

    def _next_trials(self, ids: NDArray[np.int64]) -> None:
        self._trials[ids] += np.uint64(1)
        self._begin(ids)

    def step(
        self, actions: ArrayLike
    ) -> tuple[
        NDArray[np.float32], NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]
    ]:
        """Apply actions, limited to [-1, 1], for one control period.

        Returns:
            Observations, rewards, terminations, truncations, info. In `SameStep` mode, info
            has the last observations and infos of ended episodes as `final_obs` and
            `final_info`, and the masks `_final_obs` and `_final_info`.

        Raises:
            ResetNeeded: nothing has been reset yet.
            ConfigurationError: an action is nan, or in `Disabled` mode an ended episode has
                not been reset.
        """
        if not self._begun:
            raise reset_needed("step")
        task = self.task
        ended = self._done
        if self._autoreset is AutoresetMode.DISABLED and ended.any():
            raise ConfigurationError(
                f"step: expected ended episodes to be reset first, got {np.flatnonzero(ended)}"
            )
        task.step(task.as_action(actions))
        self._elapsed += 1
        resets = np.flatnonzero(ended)
        if resets.size:
            # in NextStep mode this step resets an ended episode and ignores its action
            self._next_trials(resets)
            task.reward[resets] = 0.0
            task.lost[resets] = False
        terminated = task.lost.copy()
        truncated = (
            np.zeros(self.num_envs, dtype=np.bool_)
            if self.max_episode_steps is None
            else self._elapsed >= self.max_episode_steps
        ) | bool(task.plant.fault)
        reward = task.reward.copy()
        done = terminated | truncated
        if self._autoreset is AutoresetMode.SAME_STEP and done.any():
            last_info, last_observation = self._info(done), task.observation.copy()
            self._next_trials(np.flatnonzero(done))
            info = self._info()
            info.update(
                final_obs=_pick(last_observation, done), _final_obs=done,
                final_info=last_info, _final_info=done,
            )  # fmt: skip
        else:
            info = self._info()
            self._done = done
        return task.observation.copy(), reward, terminated, truncated, info

    def state(self) -> SavedState:
        """Copy the complete state of the running episodes.

        Raises:
            ConfigurationError: the plant is not a simulation, or its state cannot be saved.
        """
        return {"episodes": copy_arrays(self._arrays()), **self.task.state()}

    def restore(self, state: SavedState) -> None:
        """Restore the episodes from a result of `state`; they then repeat bit by bit.

        Args:
            state: the state of an environment with the same arguments.

        Raises:
            ConfigurationError: the state belongs to another environment.
        """
        restore_arrays(self._arrays(), state["episodes"])
        self.task.restore(state)
        self._begun, self._staggered = True, False

    def _arrays(self) -> Arrays:
        """State arrays of this class, without those of the task."""
        return {
            "seeds": self._seeds,
            "trials": self._trials,
            "elapsed": self._elapsed,
            "done": self._done,
        }

    def render(self) -> tuple[Image, ...] | None:
        """The picture of every head, see `GazeEnv.render`."""
        if not self._begun:
            raise reset_needed("render")
        pictures = self._task_pictures()
        if pictures is None:
            return None
        return tuple(pictures.picture(env) for env in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Bring the heads to rest and release the plant."""
        self._release()


def _pick(observations: NDArray[np.float32], done: NDArray[np.bool_]) -> NDArray[np.object_]:
    """Final observations in Gymnasium's form: an array of objects, None where none ended."""
    out = np.full(len(done), None, dtype=np.object_)
    for i in np.flatnonzero(done):
        out[i] = observations[i]
    return out


def _with_masks(info: dict[str, Any], has: NDArray[np.bool_]) -> dict[str, Any]:
    """Add Gymnasium's masks to an info: for each key k, `_k` marks the heads that have it."""
    out: dict[str, Any] = {}
    for key, value in info.items():
        out[key] = _with_masks(value, has) if isinstance(value, dict) else value
        out[f"_{key}"] = has.copy()
    return out


def _requested_trials(trial: object, num: int) -> NDArray[np.uint64] | None:
    if trial is None:
        return None
    many = isinstance(trial, Sequence | np.ndarray) and not isinstance(trial, str)
    trials: list[Any] = list(trial) if many else [trial] * num  # type: ignore[call-overload]
    if len(trials) != num:
        raise ConfigurationError(f"trial: expected one or {num} whole numbers, got {trial!r:.80}")
    return np.array([as_seed(one, "trial") for one in trials], dtype=np.uint64)


def _reset_mask(mask: object, num: int) -> NDArray[np.bool_]:
    if mask is None:
        return np.ones(num, dtype=np.bool_)
    array = np.asarray(mask)
    if array.shape != (num,) or array.dtype != np.bool_ or not array.any():
        raise ConfigurationError(
            f"reset_mask: expected {num} booleans, at least one True, got {mask!r}"
        )
    return array.copy()
