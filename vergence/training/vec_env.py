"""Adapt Gymnasium vector environments to the interface of Stable-Baselines3.

Stable-Baselines3 has its own vector interface and does not accept Gymnasium's. They differ in three
ways. SB3's environments begin the next episode within the step that ended the last one. Their infos
are a list with one dictionary per environment. At the end of an episode this dictionary holds the
last observation as `terminal_observation`, and `TimeLimit.truncated`.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from vergence.envs.streams import SavedState, copy_arrays, restore_arrays
from vergence.errors import ConfigurationError, TrainingDivergedError


class VectorEnvAdapter(VecEnv):
    """A Gymnasium vector environment with the interface of Stable-Baselines3.

    For speed, Python loops only over environments whose episode has ended; all others share one
    empty info. The info of an ended episode holds the entries that `Monitor` writes, `episode` with
    the sum of rewards `r` and the length `l`, and `is_success` if the environment reports it.

    Args:
        env: a vector environment in `SameStep` mode.
        seed: seed of the first reset: environment i gets seed + i; None for a random one.
        first_trial: number of each environment's first trial, for environments with numbered
            trials.

    Raises:
        ConfigurationError: the environment resets in another mode.
    """

    def __init__(
        self, env: VectorEnv[Any, Any, Any], seed: int | None = None, first_trial: int = 0
    ) -> None:
        mode = env.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise ConfigurationError(
                f"autoreset_mode: expected {AutoresetMode.SAME_STEP}, got {mode}"
            )
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        if seed is not None:
            self.seed(seed)
        if first_trial:
            self.set_options({"trial": first_trial})
        self._returns = np.zeros(self.num_envs)
        self._lengths = np.zeros(self.num_envs, dtype=np.int64)
        self._empty_info: dict[str, Any] = {}

    def reset(self) -> NDArray[np.float32]:
        """Begin an episode in every environment, with the seeds and options last given."""
        options: dict[str, Any] = {}
        for key in self._options[0]:
            options[key] = [given[key] for given in self._options]
        seeds: Any = None if self._seeds[0] is None else self._seeds
        observation, _info = self.env.reset(seed=seeds, options=options or None)
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return np.asarray(observation)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the actions for `step_wait`.

        Raises:
            TrainingDivergedError: an action is nan.
        """
        if np.isnan(actions).any():
            raise TrainingDivergedError("the network's actions became nan")
        self._actions = actions

    def step_wait(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Step the environments with the stored actions.

        Returns:
            Observations, float32 rewards, flags of episodes that have ended, and infos.
        """
        observation, reward, terminated, truncated, info = self.env.step(self._actions)
        reward = np.asarray(reward, dtype=np.float32)
        done = np.asarray(terminated | truncated)
        self._returns += reward
        self._lengths += 1
        infos = [self._empty_info] * self.num_envs
        if done.any():
            ended = np.flatnonzero(done)
            success = info.get("final_info", {}).get("is_success")
            for i in ended:
                infos[i] = {
                    "terminal_observation": np.asarray(info["final_obs"][i]),
                    "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                    "episode": {"r": float(self._returns[i]), "l": int(self._lengths[i])},
                }
                if success is not None:
                    infos[i]["is_success"] = bool(success[i])
            self._returns[ended] = 0.0
            self._lengths[ended] = 0
        return np.asarray(observation), reward, done, infos

    def state(self) -> SavedState:
        """State from which the running episodes continue; the environments must have `state`."""
        env: Any = self.env
        monitored = copy_arrays({"returns": self._returns, "lengths": self._lengths})
        return {"monitored": monitored, **env.state()}

    def restore(self, state: SavedState) -> None:
        """Restore the episodes to a state from `state`.

        Raises:
            ConfigurationError: the state belongs to other environments.
        """
        env: Any = self.env
        restore_arrays({"returns": self._returns, "lengths": self._lengths}, state["monitored"])
        env.restore(state)

    def close(self) -> None:
        """Release the environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the vector environment, repeated for each index asked for."""
        value = getattr(self.env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the vector environment, common to all environments."""
        self._require_all_environments(indices, attr_name)
        setattr(self.env, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the vector environment once for all environments."""
        self._require_all_environments(indices, method_name)
        result = getattr(self.env, method_name)(*method_args, **method_kwargs)
        return [result] * self.num_envs

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: Any = None
    ) -> list[bool]:
        """False for each index: single environments have no wrappers."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Rendered image of each environment; None without rendering."""
        pictures: Any = self.env.render()
        return [None] * self.num_envs if pictures is None else list(pictures)

    def _require_all_environments(self, indices: Any, what: str) -> None:
        if indices is not None and len(list(self._get_indices(indices))) != self.num_envs:
            raise ConfigurationError(
                f"{what}: expected all places of the vector environment, got {indices!r}"
            )
