"""The Gymnasium environments of the gaze task: for one head, and for many in one batch."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from enum import Enum
from importlib.util import find_spec
from inspect import Parameter, signature
from typing import Any, ClassVar, Final

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from vergence.entry_points import EntryPoint, accepted_arguments
from vergence.envs.observation import ObservationLayout
from vergence.envs.plant import plant_type
from vergence.envs.plants.conditions import Variation
from vergence.envs.reading import (
    Image,
    Reading,
    Truth,
    as_action_array,
    check_above_zero,
    check_count,
)
from vergence.envs.streams import Arrays, SavedState, as_seed, copy_arrays, restore_arrays
from vergence.envs.task import GazeTask
from vergence.errors import (
    ConfigurationError,
    RenderingUnavailableError,
    UnexpectedArgumentError,
    how_to_install,
    refuse_unknown,
)
from vergence.models.head import HeadModel
from vergence.models.perturbation import ModelErrors

_PICTURES_ENTRY_POINT: Final = "vergence.viewer.pictures:TaskPictures"
"""Entry point of the class that draws the pictures of `render`, in a later layer."""


def missing_window_hint() -> str | None:
    """Hint to install pygame, an optional dependency that windows need; None if it is installed."""
    if find_spec("pygame") is not None:
        return None
    return f'render_mode="human": expected pygame, got none: {how_to_install("render")}'


def checked_render_mode(mode: str | None, known: Sequence[str]) -> str | None:
    """Check a render mode and return it."""
    if mode is not None and mode not in known:
        raise ConfigurationError(
            f"render_mode: expected None or one of {', '.join(known)}, got {mode!r}"
        )
    missing = missing_window_hint() if mode == "human" else None
    if missing is not None:
        raise RenderingUnavailableError(missing)
    return mode


def checked_options(options: Mapping[str, Any] | None, known: Sequence[str]) -> dict[str, Any]:
    """Check the options of a call of `reset`, and return them as a dictionary."""
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise ConfigurationError(f"reset: options: expected a mapping or None, got {options!r:.80}")
    refuse_unknown("reset: options", options, known)
    return dict(options)


def checked_arguments(env: "type[TaskEnv]", arguments: Mapping[str, Any]) -> Mapping[str, Any]:
    """Check that an environment's task takes the arguments, and return them."""
    of_task = accepted_arguments(env.task_type)
    if of_task is None or arguments.keys() <= of_task - {"num"}:
        return arguments
    own = signature(env).parameters.values()
    known = of_task - {"num"} | {one.name for one in own if one.kind is not Parameter.VAR_KEYWORD}
    plant = arguments.get("plant", signature(GazeTask).parameters["plant"].default)
    of_plant = sorted((accepted_arguments(plant_type(plant)) or set()) - {"head", "num"})
    in_plant = [f"or in plant_options {', '.join(of_plant)}"] if of_plant else []
    try:
        refuse_unknown("environment", arguments, [*sorted(known), *in_plant])
    except ConfigurationError as error:  # in words by which TorchRL goes on without its frameskip
        name = next(name for name in arguments if name not in known)
        raise UnexpectedArgumentError(
            f"got an unexpected keyword argument {name!r}: {error}"
        ) from error
    return arguments


def control_rate(task: GazeTask) -> int:
    """Control periods per second, rounded to a whole number as Gymnasium's frames per second."""
    return max(1, round(task.head.timing.control_rate_hz))


def reset_needed(call: str) -> ResetNeeded:
    """Gymnasium's error for a call before the first `reset`."""
    return ResetNeeded(f"{call}: expected a call of reset first, got none")


class TaskSpec(EnvSpec):
    """A Gymnasium specification whose errors name the argument that JSON cannot hold."""

    def to_json(self) -> str:
        """See `EnvSpec.to_json`.

        Raises:
            ConfigurationError: an argument is an object that JSON cannot hold, such as a head.
        """
        kwargs = {name: _json_argument(name, value) for name, value in self.kwargs.items()}
        return EnvSpec.to_json(dataclasses.replace(self, kwargs=kwargs))


def _json_argument(name: str, value: object) -> Any:
    """Convert an argument to JSON's types, which `GazeTask` accepts as well."""

    def plain(part: object) -> object:
        if isinstance(part, ModelErrors | Variation):
            return {field: one for field, one in vars(part).items() if one is not None}
        if isinstance(part, np.ndarray | np.generic):
            return part.tolist()
        if isinstance(part, Enum):
            return part.value
        if isinstance(part, set | frozenset):
            return sorted(part)
        what = "a preset or a file by name" if isinstance(part, HeadModel) else "names and numbers"
        raise TypeError(f"expected {what}, got a {type(part).__name__}")

    try:
        return json.loads(json.dumps(value, default=plain))
    except (TypeError, ValueError) as error:
        raise ConfigurationError(
            f"spec.to_json: {name}: {error}, which JSON cannot hold"
        ) from error


class TaskEnv:
    """Base class of environments around a `GazeTask`; a single head is a batch of one."""

    task_type: ClassVar[type[GazeTask]]
    task: GazeTask
    render_mode: str | None
    metadata: dict[str, Any]
    _pictures: Any = None
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """Gymnasium's specification, from which the environment can be made again."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            init = [field.name for field in dataclasses.fields(spec) if field.init]
            spec = TaskSpec(**{name: getattr(spec, name) for name in init})
        self._spec = spec

    @property
    def layout(self) -> ObservationLayout:
        """Meaning of each number of an observation and of an action."""
        return self.task.layout

    @property
    def head(self) -> HeadModel:
        """Head model that controllers know."""
        return self.task.head

    @property
    def reading(self) -> Reading:
        """Present sensor readings, one row per head."""
        return self.task.reading

    def truth(self) -> Truth | None:
        """Ground truth of the present, one row per head; None for real heads."""
        return self.task.truth()

    def _task_pictures(self) -> Any:
        """The task's `TaskPictures`, made at the first call; None without a render mode."""
        if self._pictures is None and self.render_mode is not None:
            make = EntryPoint.of(_PICTURES_ENTRY_POINT, "render_mode").load()
            self._pictures = make(self.task, self.render_mode, self.metadata["render_fps"])
        return self._pictures

    def _release(self) -> None:
        """Bring the heads to rest, release the plant, and close the window if there is one."""
        self.task.close()
        if self._pictures is not None:
            self._pictures.close()
            self._pictures = None

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_pictures": None}


class GazeEnv(TaskEnv, gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Two camera eyes turn until both look straight at a target.

    ## Description
    A robot head with two eyes, by default each with a tilt and a pan joint, sees a target
    in both images. The task is to turn the eyes until the target lies on the principal point
    of both cameras: its position in space is then the intersection of the two optical axes. The
    neck is held. The difficulty is realistic delay: images arrive late (8 frames at 120 Hz by
    default), and the joints follow their commands with a lag.

    ## Action space
    `Box(-1, 1, (4,), float32)`: the velocities of left tilt, left pan, right tilt, right pan,
    as fractions of their limits (6 rad/s by default). An action holds for one control period. A
    head with m other eye actuators takes m numbers, named in `layout.action_names`.

    ## Observation space
    `Box` of 27 numbers, float32; 11 + 4 m for m actuators. `ObservationLayout`
    (`env.unwrapped.layout`) names them and decodes them to pixels, radians and seconds.

    ## Rewards
    With e the measured pixel error of an eye, a step in which both eyes see the target earns the
    means over the eyes of `(10 / (10 + e) + 100 / (100 + e)) / 3` (tracking) and of
    `1 / (1 + e) / 3` (precision), minus a hundredth of their sum times the mean square action
    (effort). A step in which an eye does not see the target earns 0. Losing the target costs 25
    (lost). So the best gaze earns 1 per step, and only a lost target has a negative reward, so
    that losing it never pays. `info["reward_terms"]` has the terms.

    ## Starting state
    The target draws it from the trial's random stream, keyed by (seed, trial). `reset(seed=s)`
    begins trial 0 of seed s, each further `reset()` the next trial, and `options={"trial": k}`
    trial k.

    ## Episode end
    Terminated when the target is lost: when it was seen and has not been seen by both eyes for
    0.5 s, or when no eye has seen it 1.5 s after the start. Truncated after `duration_s` of the
    head's time (periods that a real head has missed count too), after 240 steps (2 s)
    by `gymnasium.make`, and when a robot has been stopped: `info["fault"]` gives the reason, and
    `env.unwrapped.task.plant.release()` lets the next `reset` begin anew. Episodes continue after a
    success; `info["is_success"]` is true while both errors have been below 1 px for 0.1 s. If a
    head cannot look straight at all targets, only the part of the errors that its actuators can
    reduce counts for this and for precision.

    ## Arguments
    See `vergence.envs.task.GazeTask`: `head`, `target`, `model_errors`, `model_seed`, `variation`,
    `info`, `plant_options`, and `plant` (`hardware`, `kinematic`, `mujoco`, `rendered`, or
    `module:class` of a user's plant); and `render_mode` and `duration_s` (None for no end).

    ## Version history
    * v0: the first.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "human"], "render_fps": 120}  # noqa: RUF012
    """Gymnasium's metadata. The class lists all render modes, at the default head's control rate;
    an environment lists the modes that work on this machine, at its own head's rate."""
    task_type: ClassVar[type[GazeTask]] = GazeTask

    def __init__(
        self, *, render_mode: str | None = None, duration_s: float | None = None, **options: Any,
    ) -> None:  # fmt: skip
        if duration_s is not None:
            check_above_zero("duration_s", duration_s)
        self._duration_s = np.inf if duration_s is None else duration_s
        modes = type(self).metadata["render_modes"]
        self.render_mode = checked_render_mode(render_mode, modes)
        self.task = self.task_type(1, **checked_arguments(type(self), options))
        self.metadata = {**type(self).metadata, "render_fps": control_rate(self.task)}
        if missing_window_hint() is not None:
            # not removed from the class: `make` would then wrap the environment in a window of
            # Gymnasium's, which needs an extra of Gymnasium
            self.metadata["render_modes"] = [mode for mode in modes if mode != "human"]
        self.observation_space, self.action_space = self.task.spaces()
        self._seed: int | None = None
        self._trial = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin a trial.

        Args:
            seed: begins trial 0 of this seed; None goes on to the next trial.
            options: `{"trial": k}` begins trial k instead.

        Returns:
            The observation and the info.

        Raises:
            ConfigurationError: an option is unknown, or a seed or trial is no whole number.
        """
        trial = checked_options(options, ("trial",)).get("trial")
        if seed is not None:
            seed = as_seed(seed)
        if trial is not None:
            trial = as_seed(trial, "trial")
        super().reset(seed=seed)
        if seed is not None:
            self._seed, self._trial = seed, 0
        elif self._seed is None:
            self._seed, self._trial = int(self.np_random.integers(2**63)), 0
        else:
            self._trial += 1
        if trial is not None:
            self._trial = trial
        seeds, trials = np.array([[self._seed], [self._trial]], dtype=np.uint64)
        self.task.begin(np.zeros(1, dtype=np.int64), seeds, trials)
        if self.render_mode == "human":
            self.render()
        return self.task.observation[0].copy(), self.task.single_info()

    def step(
        self, action: ArrayLike
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Apply an action, limited to [-1, 1], for one control period.

        Raises:
            ResetNeeded: nothing has been reset yet.
            ConfigurationError: an action is nan, or has another shape.
        """
        if self._seed is None:
            raise reset_needed("step")
        task = self.task
        task.step(task.of_all_heads(as_action_array(action).reshape(1, -1)))
        if self.render_mode == "human":
            self.render()
        # half a period of tolerance for rounding of the time
        time_s = task.reading.time_s.item() + 0.5 * task.head.timing.period_s
        truncated = bool(task.plant.fault or time_s >= self._duration_s)
        return (
            task.observation[0].copy(), task.reward.item(), task.lost.item(), truncated,
            task.single_info(),
        )  # fmt: skip

    def render(self) -> Image | None:
        """Both eyes' images side by side and a view of the head.

        Returns:
            (height, width, 3) for `rgb_array`; None for `human`, which draws to a window.

        Raises:
            ResetNeeded: nothing has been reset yet.
        """
        if self._seed is None:
            raise reset_needed("render")
        pictures = self._task_pictures()
        return None if pictures is None else pictures.render()

    def close(self) -> None:
        """Bring the head to rest, release the plant, and close the window if there is one."""
        self._release()


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
        self, num_envs: int = 1, *, max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None, **options: Any,
    ) -> None:  # fmt: skip
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
            "render_modes": modes, "render_fps": control_rate(self.task),
            "autoreset_mode": self._autoreset,
        }  # fmt: skip
        self.single_observation_space, self.single_action_space = self.task.spaces()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._seeds, self._trials = np.zeros((2, num_envs), dtype=np.uint64)
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
        self, *, seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:  # fmt: skip
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
            self._seeds[:] = self.np_random.integers(2**63, size=self.num_envs, dtype=np.uint64)
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
        most = np.inf if self.max_episode_steps is None else self.max_episode_steps
        truncated = (self._elapsed >= most) | bool(task.plant.fault)
        reward = task.reward.copy()
        done = terminated | truncated
        if self._autoreset is AutoresetMode.SAME_STEP and done.any():
            last_info, last_observation = self._info(done), task.observation.copy()
            self._next_trials(np.flatnonzero(done))
            info = self._info()
            final = np.full(self.num_envs, None, dtype=np.object_)
            for i in np.flatnonzero(done):
                final[i] = last_observation[i]
            info |= {
                "final_obs": final, "_final_obs": done, "final_info": last_info,
                "_final_info": done,
            }  # fmt: skip
        else:
            info = self._info()
            self._done = done
        return task.observation.copy(), reward, terminated, truncated, info

    def state(self) -> SavedState:
        """Copy the complete state of the running episodes, see `GazeTask.state`."""
        return {"episodes": copy_arrays(self._arrays()), **self.task.state()}

    def restore(self, state: SavedState) -> None:
        """Restore the episodes from a state of an environment with the same arguments.

        Raises:
            ConfigurationError: the state belongs to another environment.
        """
        restore_arrays(self._arrays(), state["episodes"])
        self.task.restore(state)
        self._begun, self._staggered = True, False

    def _arrays(self) -> Arrays:
        """State arrays of this class, without those of the task."""
        return {
            "seeds": self._seeds, "trials": self._trials, "elapsed": self._elapsed,
            "done": self._done,
        }  # fmt: skip

    def render(self) -> tuple[Image, ...] | None:
        """The picture of every head, see `GazeEnv.render`."""
        if not self._begun:
            raise reset_needed("render")
        pictures = self._task_pictures()
        return pictures and tuple(pictures.picture(env) for env in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Bring the heads to rest and release the plant."""
        self._release()


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
