"""The gaze task, written once for any number of heads: a single environment is a batch of one."""

from collections.abc import Collection, Mapping
from typing import Any, Final

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike, NDArray

from vergence._jit import compiled
from vergence.envs.layout import SIZE, ObservationLayout
from vergence.envs.plant import Plant, TrialStart, make_plant
from vergence.envs.plants.variation import Variation, make_variation
from vergence.envs.reading import Reading, Truth
from vergence.envs.reward import LOST_AFTER_S, SUCCESS_AFTER_S, TERMS, assess
from vergence.envs.streams import IntArray, Streams, as_seed
from vergence.envs.targets.registry import make_target
from vergence.envs.targets.target import Target
from vergence.errors import ConfigurationError
from vergence.models.files.head_file import load_head
from vergence.models.head import HeadModel
from vergence.models.perturbation import ModelErrors, as_model_errors
from vergence.triangulation import Fix, triangulate_gaze, triangulate_views

INFO: Final = ("fixes", "truth")
"""What `info` can hold beyond the reward's terms and `is_success`, on request."""


@compiled
def _command(action: Any, limits: Any, taken: Any, command: Any) -> None:
    """Limit actions and scatter them over the eyes' joints; the neck's stay as they are."""
    for n in range(action.shape[0]):
        for j in range(4):
            a = min(max(float(action[n, j]), -1.0), 1.0)
            if action[n, j] != action[n, j]:
                a = np.nan
            taken[n, j] = a
            command[n, 3 + j] = a * limits[j]


class GazeTask:
    """Heads that have to look at targets: trials, observations, rewards, terminations.

    Args:
        num: how many heads.
        head: the model that the controller knows: a preset's name, a TOML path or a model.
        plant: name of what moves the heads, see `vergence.envs.plant.PLANTS`.
        target: what they look at, see `vergence.envs.targets.registry.make_target`.
        model_errors: standard deviations by which the true heads differ from the model, a
            mapping of `ModelErrors`' fields; each head of the batch is another draw.
        model_seed: seed of that draw; head i of the batch is drawn with model_seed + i.
        variation: what each trial draws anew and the controller is not told: delay, lag, noise,
            dropped frames, model errors; the fields of `vergence.envs.plants.variation.Variation`.
        info: what `info` holds beyond the reward's terms and `is_success`: `truth`, `fixes`.
        plant_options: the plant's own options.

    Raises:
        VergenceError: an argument cannot be.
    """

    def __init__(
        self,
        num: int = 1,
        *,
        head: str | HeadModel = "simulated",
        plant: str = "mujoco",
        target: str | Mapping[str, Any] | Target = "random",
        model_errors: Mapping[str, float] | ModelErrors | None = None,
        model_seed: int = 0,
        variation: Mapping[str, Any] | Variation | None = None,
        info: Collection[str] = (),
        plant_options: Mapping[str, Any] | None = None,
    ) -> None:
        self.head = head if isinstance(head, HeadModel) else load_head(head)
        self.target = make_target(target)
        self.layout = ObservationLayout.of(self.head)
        for name in info:
            if name not in INFO:
                raise ConfigurationError(f"info: expected some of {', '.join(INFO)}, got {name!r}")
        self._info = frozenset(info)
        options = dict(plant_options or {})
        if model_errors is not None:
            if "true_head" in options:
                raise ConfigurationError("expected either model_errors or true_head, got both")
            errors = as_model_errors(model_errors, "model_errors")
            # place i is what a single environment with model_seed + i runs
            drawn = [
                self.head.perturbed(np.random.default_rng(as_seed(model_seed) + i), errors)
                for i in range(num)
            ]
            options["true_head"] = HeadModel.stack(drawn)
        if variation is not None:
            options["variation"] = make_variation(variation)
        self.plant: Plant = make_plant(plant, self.head, num, **options)
        self.num = num
        self._all = np.arange(num)
        self._streams = Streams(num)
        self._lost_after = max(1, round(LOST_AFTER_S * self.head.timing.control_rate_hz))
        self._success_after = max(1, round(SUCCESS_AFTER_S * self.head.timing.control_rate_hz))
        self._command = np.zeros((num, 7))
        self._action = np.zeros((num, 4))
        self._seen = np.zeros(num, dtype=np.bool_)
        self._unseen_steps = np.zeros(num, dtype=np.int64)
        self._settled_steps = np.zeros(num, dtype=np.int64)
        self._error = np.full((num, 2, 2), np.nan)
        self._terms = np.zeros((num, len(TERMS)))
        self.encoded = np.zeros((num, SIZE), dtype=np.float32)
        self.observation = self.encoded
        self.reward = np.zeros(num)
        self.success = np.zeros(num, dtype=np.bool_)
        self.lost = np.zeros(num, dtype=np.bool_)
        self.reading = Reading.empty(num)

    def begin(self, ids: IntArray, seeds: NDArray[np.uint64], trials: NDArray[np.uint64]) -> None:
        """Begin trials at some places; the others go on as they were.

        Args:
            ids: (m,) the places.
            seeds: (m,) the trials' seeds.
            trials: (m,) the trials' numbers.
        """
        self._streams.start(ids, seeds, trials)
        motions, positions = self.target.draw(self.head, self._streams, ids)
        self.reading = self.plant.reset(TrialStart(ids, seeds, trials, positions, motions))
        self._seen[ids] = False
        self._unseen_steps[ids] = self._settled_steps[ids] = 0
        self._command[ids] = 0.0
        self._action[ids] = 0.0
        self._assess(ids)

    def step(self, action: NDArray[Any]) -> None:
        """Take actions and bring observation, reward, success and loss up to date.

        Args:
            action: (num, 4), limited to [-1, 1].

        Raises:
            ConfigurationError: an action is nan.
        """
        _command(action, self.layout.action_limits, self._action, self._command)
        self.reading = self.plant.step(self._command)
        self._assess(self._all)

    def _assess(self, ids: IntArray) -> None:
        reading = self.reading
        assess(
            ids,
            self.head.packed,
            self.layout.scaling,
            self.layout.latency_s,
            self._lost_after,
            self._success_after,
            self._action,
            reading.time_s,
            reading.pixels,
            reading.visible,
            reading.received_s,
            reading.positions_at_exposure,
            reading.positions,
            reading.velocities,
            self._seen,
            self._unseen_steps,
            self._settled_steps,
            self.encoded,
            self._error,
            self._terms,
            self.reward,
            self.success,
            self.lost,
        )

    def spaces(self) -> tuple[Any, Any]:
        """The spaces of one head's observations and actions."""
        return Box(self.layout.low(), self.layout.high()), Box(-1.0, 1.0, (4,), np.float32)

    @property
    def pixel_error(self) -> NDArray[np.float64]:
        """(num, 2, 2) measured pixel errors of the newest images, px; nan where not seen."""
        return self._error

    def truth(self) -> Truth | None:
        """What the plant's simulation knows about the present; None on hardware."""
        return self.plant.truth()

    def fixes(self) -> tuple[Fix, Fix]:
        """The target triangulated by gaze from the present angles, and from the newest images."""
        reading = self.reading
        return (
            triangulate_gaze(self.head, reading.positions),
            triangulate_views(self.head, reading.positions_at_exposure, reading.pixels),
        )

    def info(self) -> dict[str, Any]:
        """The `info` of the batch: arrays with a leading axis over the heads."""
        info: dict[str, Any] = {
            "is_success": self.success.copy(),
            "reward_terms": {name: self._terms[:, i].copy() for i, name in enumerate(TERMS)},
        }
        if "truth" in self._info:
            truth = self.truth()
            if truth is not None:
                info["truth"] = truth._asdict()
        if "fixes" in self._info:
            gaze, views = self.fixes()
            info["gaze"], info["itpc"] = gaze._asdict(), views._asdict()
        return info

    def single_info(self) -> dict[str, Any]:
        """The `info` of a batch of one, without the leading axis."""
        if not self._info:
            tracking, precision, effort, lost = self._terms[0].tolist()
            return {
                "is_success": bool(self.success[0]),
                "reward_terms": {
                    "tracking": tracking,
                    "precision": precision,
                    "effort": effort,
                    "lost": lost,
                },
            }
        info = GazeTask.info(self)  # a subclass adds its own
        return {
            key: {name: part[0] for name, part in value.items()}
            if isinstance(value, dict)
            else bool(value[0])
            for key, value in info.items()
        }

    def close(self) -> None:
        """Release what the plant holds."""
        self.plant.close()


def as_action(action: ArrayLike, num: int) -> NDArray[Any]:
    """Actions as an array of shape (num, 4).

    Raises:
        ConfigurationError: they have another shape.
    """
    array = np.asarray(action)
    if array.shape != (num, 4):
        raise ConfigurationError(f"action: expected shape ({num}, 4), got {array.shape}")
    return array
