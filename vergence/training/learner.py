"""The learner of a run: Stable-Baselines3's PPO on the training environments."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize

from vergence.controllers.adaptive import gain_names_of_head, gains_from_action
from vergence.controllers.controller import continued_state
from vergence.controllers.networks.acting import NetworkPrePostProcessor
from vergence.controllers.networks.environments import decode_velocity_action, training_env
from vergence.controllers.networks.inputs import Inputs
from vergence.controllers.networks.manifest import GAIN_SCHEDULE
from vergence.errors import ConfigurationError, TrainingDivergedError
from vergence.eval.trials.scenarios import load_scenario
from vergence.models.head import HeadModel
from vergence.training.config import TrainConfig, load_run
from vergence.training.learner_state import restore_learner, restore_running_episodes
from vergence.training.networks import JointwisePolicy
from vergence.training.run_checkpoints import RUNNING_EPISODES_KEY, RunCheckpoints
from vergence.training.vec_env import VectorEnvAdapter

Actor = Callable[[NDArray[np.float32]], NDArray[np.float32]]

CLIP_INPUTS: Final = 10.0
"""Limit of normalised inputs, standard deviations (chosen: outliers against information)."""
_ACTIVATIONS: Final[dict[str, type[torch.nn.Module]]] = {
    "tanh": torch.nn.Tanh,
    "relu": torch.nn.ReLU,
    "elu": torch.nn.ELU,
    "silu": torch.nn.SiLU,
}


class Learner:
    """A network, its algorithm and its training environments.

    Args:
        config: the run's configuration.
        head: the head, used by the environments and the inputs.

    Raises:
        VergenceError: an option is invalid.
    """

    def __init__(self, config: TrainConfig, head: HeadModel) -> None:
        torch.set_num_threads(config.threads)
        # weights and actions are checked elsewhere: this shows a network that has diverged
        torch.distributions.Distribution.set_default_validate_args(False)
        self.config = config
        self.head = head
        self.inputs = Inputs.of(config.inputs, head)
        self.scenario = load_scenario(config.scenario)
        options = self.scenario.env_options(plant=config.plant, head=head)
        if config.randomise:
            options["variation"] = load_scenario("hardware").variation
        try:
            self._make(options)
        except MemoryError as error:
            raise ConfigurationError(
                "envs, n_steps: expected numbers that memory suffices for, got "
                f"{str(error).splitlines()[0] or 'too little of it'}"
            ) from error

    def _make(self, options: Mapping[str, Any]) -> None:
        """Create environments, statistics and networks."""
        config = self.config
        self.env = VectorEnvAdapter(
            training_env(
                config.kind,
                config.envs,
                config.inputs,
                max_episode_steps=config.episode_steps,
                **options,
            )
        )
        self.normalisation = VecNormalize(
            self.env,
            norm_obs=config.normalise_inputs,
            norm_reward=config.normalise_rewards,
            clip_obs=CLIP_INPUTS,
            gamma=config.algorithm.get("gamma", 0.99),
        )
        if not config.normalise_inputs:
            # not used, but every checkpoint holds statistics of the inputs
            unused: Any = RunningMeanStd(shape=(self.inputs.size,))
            self.normalisation.obs_rms = unused
        self.model = _model(config, self.normalisation, self.inputs)

    def begin(self) -> None:
        """Seed the trials of a new run."""
        # SB3 has seeded the environments with the networks' seed
        self.env.seed(self.scenario.seed("train", self.config.seed))

    def restore(self, content: Mapping[str, Any]) -> None:
        """Restore the learner from a checkpoint.

        Args:
            content: the checkpoint's content; from a `last` checkpoint, training continues as if
                it had never stopped.

        Raises:
            ConfigurationError: the checkpoint belongs to another learner.
        """
        restore_learner(content, self.model, self.normalisation)
        if RUNNING_EPISODES_KEY in content:
            restore_running_episodes(content[RUNNING_EPISODES_KEY], self.model, self.normalisation)

    def check_finite(self) -> None:
        """Raise an error if networks or optimisers hold nan or infinity.

        Raises:
            TrainingDivergedError: one does; the message names it.
        """
        name = _not_finite(self.model.get_parameters())
        if name is not None:
            raise TrainingDivergedError(f"{name} became nan or infinite")

    def controller(self) -> "LearnerPolicy":
        """The network as a controller; it keeps changing as the learner trains."""
        return LearnerPolicy(self.config.kind, self.inputs, self._act)

    def _act(self, inputs: NDArray[np.float32]) -> NDArray[np.float32]:
        """Map (n, size) inputs to (n, actions) in [-1, 1], without exploration."""
        policy: Any = self.model.policy
        policy.set_training_mode(False)
        seen: Any = self.normalisation.normalize_obs(inputs)
        with torch.no_grad():
            action: torch.Tensor = policy._predict(torch.as_tensor(seen), deterministic=True)
        if action.isnan().any():
            raise TrainingDivergedError("the network's actions became nan")
        return action.clamp(-1.0, 1.0).numpy()

    def close(self) -> None:
        """Release the environments."""
        self.env.close()


class LearnerPolicy:
    """A network in training as a controller, to be evaluated like any other.

    Args:
        kind: `gain-schedule` or `policy`.
        inputs: the network's inputs.
        act: maps (n, size) inputs to (n, actions) in [-1, 1].
    """

    def __init__(self, kind: str, inputs: Inputs, act: Actor) -> None:
        self.inputs = inputs
        self._act = act
        self._names = gain_names_of_head(inputs.head) if kind == GAIN_SCHEDULE else None
        self._acting = NetworkPrePostProcessor(inputs, kind == GAIN_SCHEDULE)

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Choose actions, see `vergence.controllers.Controller`."""
        observation = np.asarray(observation)
        shape = observation.shape[:-1]
        memory = continued_state(self._acting.initial(), shape, state, episode_start)
        seen = self._acting.network_inputs(observation, memory)
        action = self._act(seen.reshape(-1, self.inputs.size)).reshape(*shape, -1)
        if self._names is None:
            return self._acting.action_from_velocities(
                seen, decode_velocity_action(action), memory
            ), (memory,)
        gains = gains_from_action(action, self._names)
        return self._acting.ibvs_action_from_gains(observation, gains, memory), (memory,)


def load_learner(folder: Path, checkpoint: str = "best") -> Learner:
    """Load the learner of a run folder, with the weights and statistics of a checkpoint.

    Args:
        folder: the run folder.
        checkpoint: `best` or `last`.

    Raises:
        ConfigurationError: the folder holds no such checkpoint of its own run.
    """
    config, head = load_run(folder)
    content = RunCheckpoints(folder, config, head).read(checkpoint)
    learner = Learner(config, head)
    learner.restore(content)
    return learner


def _model(config: TrainConfig, env: VecNormalize, inputs: Inputs) -> PPO:
    options: dict[str, Any] = dict(config.algorithm)
    rate = options.pop("learning_rate", 3e-4)
    if config.final_learning_rate is not None:
        rate = _linear(rate, config.final_learning_rate)
    policy: Any = "MlpPolicy"
    network: dict[str, Any] = {
        "activation_fn": _ACTIVATIONS[config.activation],
        "log_std_init": config.log_std_init,
    }
    if config.shared:
        if inputs.by_joint is None:
            raise ConfigurationError(
                f"shared: expected inputs told joint by joint, got {config.inputs!r}"
            )
        policy = JointwisePolicy
        network |= {"by_joint": inputs.by_joint.tolist(), "critic": config.critic}
        network["net_arch"] = list(config.network)
    else:
        network["net_arch"] = {"pi": list(config.network), "vf": list(config.critic)}
    rollout = options.get("n_steps", 2048) * config.envs
    if rollout % options.get("batch_size", 64):
        raise ConfigurationError(
            f"batch_size: expected a divisor of n_steps * envs = {rollout}, "
            f"got {options.get('batch_size', 64)}"
        )
    try:
        return PPO(
            policy,
            env,
            learning_rate=rate,
            policy_kwargs=network,
            seed=config.seed % 2**32,
            device="cpu",
            **options,
        )
    except (TypeError, ValueError, AssertionError) as error:
        raise ConfigurationError(f"algorithm: {str(error).splitlines()[0]}") from error


def _not_finite(value: Any, name: str = "") -> str | None:
    """Name of the first tensor in nested dictionaries that holds nan or infinity."""
    if isinstance(value, torch.Tensor):
        return None if bool(torch.isfinite(value).all()) else name
    if isinstance(value, Mapping):
        for key, item in value.items():
            found = _not_finite(item, f"{name}.{key}" if name else str(key))
            if found is not None:
                return found
    return None


def _linear(first: float, last: float) -> Any:
    return lambda remaining: last + (first - last) * remaining
