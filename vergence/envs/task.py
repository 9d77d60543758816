"""The gaze task for any number of heads; a single environment is a batch of one."""

import functools
from collections.abc import Callable, Collection, Mapping
from functools import cached_property
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike, NDArray

from vergence.envs.observation import ObservationLayout
from vergence.envs.plant import Simulation, TrialStart, make_plant, plant_type, simulation_of
from vergence.envs.plants.cameras import BoardImageRenderer
from vergence.envs.plants.conditions import Variation, make_variation
from vergence.envs.reading import Image, Reading, Truth, as_action_array, refuse_immobile_eyes
from vergence.envs.reward import TERMS, TaskArrays
from vergence.envs.streams import (
    Arrays,
    IntArray,
    KeyArray,
    RandomStreams,
    SavedState,
    as_seed,
    copy_arrays,
    join_parts,
    restore_arrays,
)
from vergence.envs.targets import make_target, separate_look
from vergence.envs.targets.motion import Target
from vergence.errors import ConfigurationError, HardwareError
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import FloatArray
from vergence.models.perturbation import ModelErrors, as_model_errors
from vergence.triangulation import Fix, triangulate_gaze, triangulate_views
from vergence.vision.targets import make_planar_target


class Policy(Protocol):
    """Any object with Stable-Baselines3's `predict`: a control law, a network, a user's class."""

    def predict(
        self, observation: NDArray[np.float32], state: Any = None,
        episode_start: NDArray[np.bool_] | None = None, deterministic: bool = True,
    ) -> tuple[NDArray[Any], Any]:  # fmt: skip
        """Choose actions.

        Args:
            observation: (num, size) the observations.
            state: state returned by the last call; None at the start.
            episode_start: (num,) True where a trial has just begun.
            deterministic: True to choose the most likely action.

        Returns:
            (num, m) actions of m actuators, and the state for the next call.
        """


INFO: Final = ("fixes", "truth")
"""Optional entries of `info`, besides the reward's terms and `is_success`."""


class GazeTask:
    """The task of looking at targets, for a batch of heads: trials, observations, rewards, ends.

    Args:
        num: number of heads.
        head: the model that the controller knows: a preset's name, a TOML path or a model.
        plant: the plant that moves the heads: a name, see `vergence.envs.plant.PLANTS`, or
            `module:class` of a user's plant.
        target: the target to look at: its motion, see `make_target`, or what it is, see
            `parse_gaze_target`, or both, see `separate_look`; a real head looks at the world, and
            takes only the start of its trials from a motion.
        model_errors: standard deviations of the true heads from the model, as a mapping of
            `ModelErrors`' fields; each head of the batch is a separate draw.
        model_seed: seed of that draw; head i of the batch is drawn with model_seed + i.
        variation: conditions that each trial draws anew, hidden from the controller: delay, lag,
            noise, dropped frames, model errors; see `vergence.envs.plants.conditions.Variation`.
        info: optional entries of `info`: `truth`, `fixes`.
        plant_options: the plant's own options.

    Raises:
        VergenceError: an argument is invalid.
    """

    def __init__(
        self, num: int = 1, *, head: str | HeadModel = "simulated", plant: str = "mujoco",
        target: str | Mapping[str, Any] | Target = "random",
        model_errors: Mapping[str, float] | ModelErrors | None = None, model_seed: int = 0,
        variation: Mapping[str, Any] | Variation | None = None, info: Collection[str] = (),
        plant_options: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        self.head = head if isinstance(head, HeadModel) else load_head(head)
        refuse_immobile_eyes(self.head)
        target, look = separate_look(target)
        self.target = make_target(target)
        """Target that draws the trials' motions and starts."""
        self.layout = ObservationLayout.of(self.head)
        asked: Any = info  # a caller may pass anything, whatever the annotation says
        for name in asked if isinstance(asked, Collection) else (asked,):
            if name not in INFO:
                raise ConfigurationError(f"info: expected some of {', '.join(INFO)}, got {name!r}")
        self._info = frozenset(info)
        if not isinstance(plant_options, Mapping | None):
            raise ConfigurationError(
                f"plant_options: expected options by name, got {plant_options!r:.80}"
            )
        options = dict(plant_options or {})
        if look is not None:
            options["look"] = look
        if "look" in options and plant in ("kinematic", "mujoco"):
            raise ConfigurationError(
                f"target: expected the plant rendered, whose images show it, for "
                f"{options['look']}, got {plant}"
            )
        if self.target.drawn_in_workspace:
            options = {**getattr(plant_type(plant), "workspace_options", {}), **options}
        if model_errors is not None:
            if "true_head" in options:
                raise ConfigurationError("expected either model_errors or true_head, got both")
            errors = as_model_errors(model_errors, "model_errors")
            # environment i is the same as a single environment with model_seed + i
            heads = [
                self.head.perturbed(np.random.default_rng(as_seed(model_seed) + i), errors)
                for i in range(num)
            ]
            options["true_head"] = HeadModel.stack(heads)
        if variation is not None:
            options["variation"] = make_variation(variation)
        self.plant = make_plant(plant, self.head, num, **options)
        if isinstance(self.plant, Simulation) or self.plant.places_targets:
            try:
                self.target.check(self.head)
            except ConfigurationError:
                self.plant.close()
                raise
        self.num = num
        self._all = np.arange(num)
        self._streams = RandomStreams(num)
        self._task_arrays = arrays = TaskArrays.empty(self.head, num)
        self._command, self._action = arrays.command, arrays.action
        self._progress, self._outcome = arrays.progress, arrays.result
        self.reading = Reading.empty(num)
        self.encoded = self.observation = self._outcome.observation
        self.reward, self.success = self._outcome.reward, self._outcome.success
        self.lost = self._outcome.lost
        self.plant.join(arrays)

    def prepare(self, policy: Policy) -> None:
        """Compile all code that trials call, before anything moves.

        The plant prepares itself, and the policy is called once, as at a trial's start; its action
        is discarded.
        """
        self.plant.prepare()
        self.plant.judge(self._all, self.reading)
        action, _state = policy.predict(
            self.observation.copy(), state=None, episode_start=np.ones(self.num, dtype=np.bool_),
            deterministic=True,
        )  # fmt: skip
        self.as_action(action)
        self.fixes()

    def begin(self, ids: IntArray, seeds: KeyArray, trials: KeyArray) -> None:
        """Begin trials in some environments; the others continue.

        Args:
            ids: (m,) environment indices.
            seeds: (m,) the trials' seeds.
            trials: (m,) the trials' numbers.
        """
        plant = self.plant
        self._streams.start(ids, seeds, trials)
        motions, positions = self.target.draw(self.head, self._streams, ids, plant.board)
        if isinstance(plant, Simulation):
            reading = plant.begin(TrialStart(ids, seeds, trials, positions, motions))
        else:
            if plant.places_targets:
                plant.show(ids, motions)
            reading = plant.reset(ids, positions)
        self._progress.begin(ids, self.head.timing.period_s)
        self._command[ids] = 0.0
        self._action[ids] = 0.0
        self.reading = plant.judge(ids, reading)

    def step(self, action: NDArray[Any]) -> None:
        """Apply actions, and update observation, reward, success and loss.

        Args:
            action: (num, m) for the m actuators, limited to [-1, 1].

        Raises:
            ConfigurationError: an action is nan.
        """
        self._task_arrays.requested[:] = action
        reading = self.plant.act()
        if reading is None:
            self.plant.rest("policy: expected numbers for an action, got nan")
            raise ConfigurationError("action: expected numbers, got nan")
        self.reading = reading

    def state(self) -> SavedState:
        """Copy the complete state of the running trials.

        Raises:
            ConfigurationError: the plant is not a simulation, or its state cannot be saved.
        """
        plant = simulation_of(self.plant)
        return {"task": copy_arrays(self._arrays()), "plant": plant.state()}

    def restore(self, state: SavedState) -> None:
        """Restore the running trials from a result of `state`, bit by bit."""
        restore_arrays(self._arrays(), state["task"])
        self.reading = Reading.of(simulation_of(self.plant).restore(state["plant"]), self.num)

    def _arrays(self) -> Arrays:
        """State arrays of the task, without those of the plant."""
        return join_parts(
            keys=self._streams.keys._asdict(), progress=self._progress._asdict(),
            outcome=self._outcome._asdict(),
            last={"command": self._command, "action": self._action},
        )  # fmt: skip

    @property
    def action_names(self) -> tuple[str, ...]:
        """(m,) names of the actuators, in the order of an action."""
        return self.layout.action_names

    def spaces(self) -> tuple[Any, Any]:
        """Observation space and action space of one head."""
        actions = Box(-1.0, 1.0, (len(self.action_names),), np.float32)
        return Box(self.layout.low(), self.layout.high()), actions

    def as_action(self, action: ArrayLike) -> NDArray[Any]:
        """Check actions of all heads, and return an array (num, m) in the order of `action_names`.

        Raises:
            ConfigurationError: the shape is wrong.
        """
        return self.of_all_heads(as_action_array(action))

    def of_all_heads(self, action: NDArray[Any]) -> NDArray[Any]:
        """Refuse an array of another shape than (num, m), and return it; see `as_action`."""
        if action.shape != self._action_shape:
            raise ConfigurationError(
                f"action: expected shape {self._action_shape}, heads by "
                f"{', '.join(self.action_names)}, got {action.shape}"
            )
        return action

    @cached_property
    def _action_shape(self) -> tuple[int, int]:
        return self.num, len(self.action_names)

    @property
    def pixel_error(self) -> FloatArray:
        """(num, 2, 2) measured pixel errors of the newest images, px; nan if not visible."""
        return self._outcome.error

    @property
    def command(self) -> FloatArray:
        """(num, 7) velocities commanded by the last actions, rad/s; see `Plant.step`."""
        return self._command

    def truth(self) -> Truth | None:
        """Ground truth of the present, see `vergence.envs.plant.Plant.truth`."""
        return self.plant.truth()

    def fixes(self) -> tuple[Fix, Fix]:
        """Triangulate the target by gaze from the present angles, and from the newest images."""
        reading = self.reading
        return (
            triangulate_gaze(self.head, reading.positions),
            triangulate_views(self.head, reading.positions_at_exposure, reading.pixels),
        )

    def info(self) -> dict[str, Any]:
        """The `info` of the batch: arrays with a leading axis over the heads."""
        terms = {name: self._outcome.terms[:, i].copy() for i, name in enumerate(TERMS)}
        info: dict[str, Any] = {"is_success": self.success.copy(), "reward_terms": terms}
        truth = self.truth() if "truth" in self._info else None
        if truth is not None:
            info["truth"] = truth._asdict()
        if "fixes" in self._info:
            gaze, views = self.fixes()
            info["gaze"], info["itpc"] = gaze._asdict(), views._asdict()
        if self.plant.fault:
            info["fault"] = np.full(self.num, self.plant.fault, dtype=object)
        return info

    def single_info(self) -> dict[str, Any]:
        """The `info` of a batch of one, without the leading axis."""
        if not self._info:
            # written out, as this is a tenth of a step
            tracking, precision, effort, lost = self._outcome.terms[0].tolist()
            terms = {"tracking": tracking, "precision": precision, "effort": effort, "lost": lost}
            known: dict[str, Any] = {"is_success": bool(self.success[0]), "reward_terms": terms}
            return known | {"fault": self.plant.fault} if self.plant.fault else known
        info = GazeTask.info(self)  # a subclass adds its own
        return {
            key: {name: part[0] for name, part in value.items()}
            if isinstance(value, dict)
            else value.tolist()[0]
            for key, value in info.items()
        }

    def close(self) -> None:
        """Bring the heads to rest and release what the plant holds; may be called twice."""
        self.plant.close()


def rollout(
    task: GazeTask, policy: Policy, steps: int, record: Callable[[int], None], *, seed: int = 0,
    first_trial: int = 0,
) -> None:  # fmt: skip
    """Run one trial in each environment of a task, and close the task in any case.

    Unless the plant is a simulation, all code is compiled before the heads move, see
    `GazeTask.prepare`. `record` is called at time zero and after each step with the step's number.
    """
    try:
        if not isinstance(task.plant, Simulation):
            task.prepare(policy)
        run_trial(task, policy, steps, record, seed=seed, first_trial=first_trial)
    finally:
        task.close()


def run_trial(
    task: GazeTask, policy: Policy, steps: int, record: Callable[[int], None], *, seed: int = 0,
    first_trial: int = 0,
) -> None:  # fmt: skip
    """Run one trial in each environment of a task, and leave the task open for the next one."""
    ids = np.arange(task.num)
    seeds = np.full(task.num, as_seed(seed), dtype=np.uint64)
    task.begin(ids, seeds, (first_trial + ids).astype(np.uint64))
    record(0)
    state, start = None, np.ones(task.num, dtype=np.bool_)
    for step in range(1, steps + 1):
        # a copy: the task writes its next observation into the same array
        action, state = policy.predict(
            task.observation.copy(), state=state, episode_start=start, deterministic=True
        )
        start = np.zeros(task.num, dtype=np.bool_)
        task.step(task.as_action(action))
        if task.plant.fault:
            raise HardwareError(task.plant.fault)
        record(step)


class EyeImages(NamedTuple):
    """Images of both eyes: (height, width) grey levels, or (height, width, 3) RGB."""

    left: Image
    right: Image
    drawn: bool
    """True if the plant has no cameras, so that the images are drawn for the present posture."""

    def of(self, eye: int) -> Image:
        """Image of the left eye, 0, or of the right, 1."""
        return self.right if eye else self.left


def best_known_angles_and_target(task: GazeTask, n: int) -> tuple[FloatArray, FloatArray]:
    """(7,) joint angles, rad, and (3,) target in N, m: the truth if known, else as measured."""
    truth = task.truth()
    if truth is not None:
        return truth.positions[n], truth.target[n]
    gaze, _views = task.fixes()
    return task.reading.positions[n], gaze.point[n]


def given_or_drawn_eye_images(task: GazeTask, n: int) -> EyeImages | None:
    """Copies of the present images of one head's eyes, or drawn ones in a simulation without."""
    frames = task.plant.frames(n)
    if frames is not None:
        # plants give blue, green and red
        left, right = (image[..., ::-1] if image.ndim == 3 else image for image in frames)
        return EyeImages(left.copy(), right.copy(), False)
    if not isinstance(task.plant, Simulation):
        return None
    positions, target = best_known_angles_and_target(task, n)
    left, right = _renderer(task.head).draw(positions, np.zeros(7), target)
    return EyeImages(left.copy(), right.copy(), True)


@functools.lru_cache(maxsize=4)
def _renderer(head: HeadModel) -> BoardImageRenderer:
    return BoardImageRenderer(head, make_planar_target("tag"))
