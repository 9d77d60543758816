"""The Gymnasium environment of the gaze task, for one head."""

from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.envs.reading import Image
from vergence.envs.streams import as_seed
from vergence.envs.task import GazeTask
from vergence.envs.task_env import (
    TaskEnv,
    checked_arguments,
    checked_options,
    checked_render_mode,
    control_rate,
    missing_window_hint,
    reset_needed,
)
from vergence.envs.validation import as_action_array, check_above_zero

_FIRST = np.zeros(1, dtype=np.int64)


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
        self,
        *,
        render_mode: str | None = None,
        duration_s: float | None = None,
        **options: Any,
    ) -> None:
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
        """Apply an action, limited to [-1, 1], for one control period.

        Raises:
            ResetNeeded: nothing has been reset yet.
            ConfigurationError: an action is nan, or has another shape.
        """
        if self._seed is None:
            raise reset_needed("step")
        task = self.task
        array = as_action_array(action)
        task.step(task.as_action(array.reshape(1, -1)))
        if self.render_mode == "human":
            self.render()
        return (
            task.observation[0].copy(),
            task.reward.item(),
            task.lost.item(),
            # half a period of tolerance for rounding of the time
            bool(
                task.plant.fault
                or task.reading.time_s.item() + 0.5 * task.head.timing.period_s >= self._duration_s
            ),
            task.single_info(),
        )

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
