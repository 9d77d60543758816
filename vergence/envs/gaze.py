"""The Gymnasium environments of the gaze task, single and vector."""

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from vergence.envs.layout import ObservationLayout
from vergence.envs.reading import Reading, Truth
from vergence.envs.streams import as_seed
from vergence.envs.task import GazeTask, as_action
from vergence.envs.views import Viewer
from vergence.errors import ConfigurationError

Image = NDArray[np.uint8]
_FIRST = np.zeros(1, dtype=np.int64)


def _check_render_mode(mode: str | None, known: Sequence[str]) -> str | None:
    if mode is not None and mode not in known:
        raise ConfigurationError(
            f"render_mode: expected None or one of {', '.join(known)}, got {mode!r}"
        )
    return mode


class GazeEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Two camera eyes turn until both look straight at a target.

    ## Description
    A robot head with two eyes, each with a tilt and a pan joint and a camera, sees a target
    in both images. The task is to turn the eyes until the target lies on the principal point
    of both cameras: there its position in space is the crossing of the two optical axes. The
    neck holds. The images are old when they arrive (8 frames at 120 Hz by default), the joints
    follow their commands with a lag: what makes the task hard is real delay.

    ## Action space
    `Box(-1, 1, (4,), float32)`: the velocities of left tilt, left pan, right tilt, right pan,
    by the joints' limits (6 rad/s by default). An action holds for one control period.

    ## Observation space
    `Box` of 27 numbers, float32. `ObservationLayout` (`env.unwrapped.layout`) names them and
    decodes them to pixels, radians and seconds.

    ## Rewards
    Per step, from measured pixel errors e: `-e / (e + 20 px)` on average over the eyes,
    +1/2 for each eye below 1 px, minus a hundredth of the mean square action; -25 when the
    target is lost. `info["reward_terms"]` has the parts.

    ## Starting state
    Drawn by the target from the trial's random stream, keyed by (seed, trial): `reset(seed=s)`
    begins trial 0 of seed s, each further `reset()` the next, and `options={"trial": k}` trial k.

    ## Episode end
    Terminated when a target that was seen has not been seen by both eyes for 0.5 s. Truncated
    after 240 steps (2 s) by `gymnasium.make`. Success ends nothing; `info["is_success"]` is
    true while both errors have been below 1 px for 0.1 s.

    ## Arguments
    See `vergence.envs.task.GazeTask`: `head`, `plant` (`kinematic`, `mujoco`, `rendered`),
    `target`, `model_errors`, `model_seed`, `variation`, `info`, `plant_options`; and
    `render_mode`.

    ## Version history
    * v0: the first.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": ["rgb_array", "human"],
        "render_fps": 60,
    }
    task_type: ClassVar[type[GazeTask]] = GazeTask

    def __init__(self, *, render_mode: str | None = None, **options: Any) -> None:
        self.render_mode = _check_render_mode(render_mode, self.metadata["render_modes"])
        self.task = self.task_type(1, **options)
        self.observation_space, self.action_space = self.task.spaces()
        self._seed: int | None = None
        self._trial = 0
        self._viewer: Viewer | None = None

    @property
    def layout(self) -> ObservationLayout:
        """What each number of an observation and an action means."""
        return self.task.layout

    @property
    def reading(self) -> Reading:
        """What the sensors report at present, a batch of one."""
        return self.task.reading

    def truth(self) -> Truth | None:
        """What the plant's simulation knows about the present, a batch of one."""
        return self.task.truth()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin a trial.

        Args:
            seed: begins trial 0 of this seed; None goes on to the next trial.
            options: `{"trial": k}` begins trial k instead.

        Returns:
            The observation and the info.
        """
        super().reset(seed=seed)
        if seed is not None:
            self._seed, self._trial = as_seed(seed), 0
        elif self._seed is None:
            self._seed, self._trial = int(self.np_random.integers(2**63)), 0
        else:
            self._trial += 1
        if options and "trial" in options:
            self._trial = as_seed(options["trial"])
        self.task.begin(
            _FIRST,
            np.array([self._seed], dtype=np.uint64),
            np.array([self._trial], dtype=np.uint64),
        )
        if self.render_mode == "human":
            self.render()
        return self.task.observation[0].copy(), self.task.single_info()

    def step(
        self, action: ArrayLike
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Take an action, limited to [-1, 1], for one control period."""
        task = self.task
        array = np.asarray(action)
        task.step(as_action(array.reshape(1, -1), 1))
        if self.render_mode == "human":
            self.render()
        return (
            task.observation[0].copy(),
            float(task.reward[0]),
            bool(task.lost[0]),
            False,
            task.single_info(),
        )

    def render(self) -> Image | None:
        """Both eyes' images side by side and a view of the head.

        Returns:
            (height, width, 3) for `rgb_array`; None for `human`, which draws to a window.
        """
        if self.render_mode is None:
            return None
        if self._viewer is None:
            self._viewer = Viewer(self.task, self.render_mode, self.metadata["render_fps"])
        return self._viewer.render()

    def close(self) -> None:
        """Close the window, if there is one, and release the plant."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None
        self.task.close()

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_viewer": None}


class GazeVectorEnv(VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """Many heads at once: the same task as `GazeEnv`, one plant, one batch.

    Environment i of a vector that is reset with seed s runs the trials that `GazeEnv` runs
    with seed s + i.

    Args:
        num_envs: how many heads.
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
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        try:
            self._autoreset = AutoresetMode(autoreset_mode)
        except ValueError as error:
            known = ", ".join(mode.value for mode in AutoresetMode)
            raise ConfigurationError(
                f"autoreset_mode: expected one of {known}, got {autoreset_mode!r}"
            ) from error
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": GazeEnv.metadata["render_fps"],
            "autoreset_mode": self._autoreset,
        }
        self.render_mode = _check_render_mode(render_mode, self.metadata["render_modes"])
        self.task = self.task_type(num_envs, **options)
        self.single_observation_space, self.single_action_space = self.task.spaces()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._seeds = np.zeros(num_envs, dtype=np.uint64)
        self._trials = np.zeros(num_envs, dtype=np.uint64)
        self._elapsed = np.zeros(num_envs, dtype=np.int64)
        self._done = np.zeros(num_envs, dtype=np.bool_)
        self._begun = self._staggered = False
        self._viewer: Viewer | None = None

    def stagger(self) -> None:
        """Let the first episodes of the next `reset` be cut short, place by place.

        The episodes of a vector begin together and, with a limit of steps, end together for
        ever; after this their ends spread evenly, as a learner needs it.
        """
        self._staggered = True

    @property
    def layout(self) -> ObservationLayout:
        """What each number of an observation and an action means."""
        return self.task.layout

    @property
    def reading(self) -> Reading:
        """What the sensors report at present."""
        return self.task.reading

    def truth(self) -> Truth | None:
        """What the plant's simulation knows about the present."""
        return self.task.truth()

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin trials, of all heads or of some.

        Args:
            seed: s begins trial 0 of seeds s, s + 1, ...; a sequence names a seed for each,
                None for those that go on to their next trial.
            options: `{"trial": k}` or a sequence begins these trials; `{"reset_mask": mask}`
                resets only where the mask of shape (num_envs,) is True.

        Returns:
            The observations of all heads, and the info.
        """
        options = dict(options or {})
        mask = _reset_mask(options.pop("reset_mask", None), self.num_envs)
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
        if "trial" in options:
            trials = np.broadcast_to(np.asarray(options["trial"]), (self.num_envs,))
            self._trials[mask] = [as_seed(trial) for trial in trials[mask]]
        self._begin(np.flatnonzero(mask))
        if self._staggered and self.max_episode_steps is not None:
            self._elapsed[:] = np.arange(self.num_envs) * self.max_episode_steps // self.num_envs
            self._staggered = False
        return self.task.observation.copy(), self.task.info()

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
        """Take actions, limited to [-1, 1], for one control period.

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
            raise gymnasium.error.ResetNeeded("step: expected a call of reset first, got none")
        task = self.task
        ended = self._done
        if self._autoreset is AutoresetMode.DISABLED and ended.any():
            raise ConfigurationError(
                f"step: expected ended episodes to be reset first, got {np.flatnonzero(ended)}"
            )
        task.step(as_action(actions, self.num_envs))
        self._elapsed += 1
        resets = np.flatnonzero(ended)
        if resets.size:
            # in NextStep mode an ended episode's action is not taken: the step resets it
            self._next_trials(resets)
            task.reward[resets] = 0.0
            task.lost[resets] = False
        terminated = task.lost.copy()
        truncated = (
            np.zeros(self.num_envs, dtype=np.bool_)
            if self.max_episode_steps is None
            else self._elapsed >= self.max_episode_steps
        )
        reward = task.reward.copy()
        done = terminated | truncated
        info = task.info()
        if self._autoreset is AutoresetMode.SAME_STEP and done.any():
            last_info, last_observation = info, task.observation.copy()
            self._next_trials(np.flatnonzero(done))
            info = task.info()
            info.update(
                final_obs=_pick(last_observation, done), _final_obs=done,
                final_info=last_info, _final_info=done,
            )  # fmt: skip
        else:
            self._done = done
        return task.observation.copy(), reward, terminated, truncated, info

    def render(self) -> tuple[Image, ...] | None:
        """The picture of every head, see `GazeEnv.render`."""
        if self.render_mode is None:
            return None
        if self._viewer is None:
            self._viewer = Viewer(self.task, self.render_mode, self.metadata["render_fps"])
        return tuple(self._viewer.picture(place) for place in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Release the plant."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None
        self.task.close()

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_viewer": None}


def _pick(observations: NDArray[np.float32], done: NDArray[np.bool_]) -> NDArray[np.object_]:
    """Gymnasium's form of final observations: an array of objects, None where none ended."""
    out = np.full(len(done), None, dtype=np.object_)
    for i in np.flatnonzero(done):
        out[i] = observations[i]
    return out


def _reset_mask(mask: object, num: int) -> NDArray[np.bool_]:
    if mask is None:
        return np.ones(num, dtype=np.bool_)
    array = np.asarray(mask)
    if array.shape != (num,) or array.dtype != np.bool_ or not array.any():
        raise ConfigurationError(
            f"reset_mask: expected {num} booleans, at least one True, got {mask!r}"
        )
    return array.copy()
