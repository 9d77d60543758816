"""Common part of the gaze task's single and vector environments, beyond Gymnasium's interface."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from enum import Enum
from importlib.util import find_spec
from inspect import Parameter, signature
from typing import Any, ClassVar, Final, Protocol

import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded

from vergence.entry_points import EntryPoint, accepted_arguments
from vergence.envs.layout import ObservationLayout
from vergence.envs.plant import plant_type
from vergence.envs.plants.variation import Variation
from vergence.envs.reading import Image, Reading, Truth
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
    """Check a render mode, which may be None, and return it.

    Raises:
        ConfigurationError: the mode is unknown.
        RenderingUnavailableError: the mode needs a window, and pygame is not installed.
    """
    if mode is not None and mode not in known:
        raise ConfigurationError(
            f"render_mode: expected None or one of {', '.join(known)}, got {mode!r}"
        )
    missing = missing_window_hint() if mode == "human" else None
    if missing is not None:
        raise RenderingUnavailableError(missing)
    return mode


def checked_options(options: Mapping[str, Any] | None, known: Sequence[str]) -> dict[str, Any]:
    """Check the options of a call of `reset`, and return them as a dictionary.

    Raises:
        ConfigurationError: an option is unknown.
    """
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise ConfigurationError(f"reset: options: expected a mapping or None, got {options!r:.80}")
    refuse_unknown("reset: options", options, known)
    return dict(options)


def checked_arguments(env: "type[TaskEnv]", arguments: Mapping[str, Any]) -> Mapping[str, Any]:
    """Check that an environment's task takes the arguments, and return them.

    Raises:
        UnexpectedArgumentError: an argument is unknown.
    """
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


class Pictures(Protocol):
    """Pictures of a task's heads, see `vergence.viewer.pictures.TaskPictures`."""

    def render(self) -> Image | None:
        """The picture of the first head: returned, or shown in the window."""

    def picture(self, n: int) -> Image:
        """The picture of one head."""

    def close(self) -> None:
        """Close the window and the renderer."""


class TaskEnv:
    """Base class of environments around a `GazeTask`; a single head is a batch of one."""

    task_type: ClassVar[type[GazeTask]]
    task: GazeTask
    render_mode: str | None
    metadata: dict[str, Any]
    _pictures: Pictures | None = None
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

    def _task_pictures(self) -> Pictures | None:
        """The task's pictures, made at the first call; None without a render mode."""
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
