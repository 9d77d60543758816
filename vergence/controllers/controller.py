"""The interface of controllers, their registry, and the base of those that have a state."""

import inspect
from abc import ABC, abstractmethod
from functools import cached_property
from importlib import import_module
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from vergence.envs.observation import Observation, ObservationLayout
from vergence.errors import ConfigurationError, UnknownNameError, did_you_mean
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray


def checked_layout(head: HeadModel, layout: ObservationLayout | None) -> ObservationLayout:
    """Return a head's layout; refuse another head's, and a head whose eyes do not move."""
    if not head.actuation.count:
        raise ConfigurationError(
            f"head: expected one whose eyes move, got {head.name!r}, a fixed pair, which leaves a "
            "controller nothing to do"
        )
    own = ObservationLayout.of(head)
    if layout is None:
        return own
    if not isinstance(layout, ObservationLayout):
        raise ConfigurationError(f"layout: expected an ObservationLayout, got {layout!r:.80}")
    if layout == own:
        return layout
    ours, theirs = own.to_dict(), layout.to_dict()
    differing = ", ".join(name for name, value in ours.items() if theirs.get(name) != value)
    raise ConfigurationError(
        f"layout: expected that of the head {head.name!r}, got another head's, which differs in "
        f"{differing}"
    )


class Controller(Protocol):
    """A policy with the `predict` of Stable-Baselines3, batched."""

    def predict(
        self, observation: NDArray[Any], state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None, deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:  # fmt: skip
        """Choose actions.

        Args:
            observation: (..., size) observations of the environment.
            state: the state returned by the last call; None at the start.
            episode_start: (...) True for an episode that has just begun.
            deterministic: True to take the most likely action.

        Returns:
            (..., m) actions, one number per actuator, and the state for the next call.

        Raises:
            ConfigurationError: these are not valid observations: another length, integers, nan.
        """


CONTROLLERS: Final[dict[str, str]] = {
    "ibvs": "vergence.controllers.ibvs:IBVS",
    "delay-compensated": "vergence.controllers.state_feedback:DelayCompensatedIBVS",
    "state-feedback": "vergence.controllers.state_feedback:StateFeedback",
    "saccade": "vergence.controllers.saccade:Saccade",
    "ibvs-tuned": "vergence.controllers.ibvs:TunedIBVS",
    "adaptive": "vergence.controllers.adaptive:AdaptiveIBVS",
    "pid": "vergence.controllers.pid:PID",
    "fuzzy": "vergence.controllers.pid:FuzzyPID",
    "pursuit": "vergence.controllers.saccade:Pursuit",
    "learned-gain": "vergence.controllers.networks.learned:LearnedGain",
    "learned-policy": "vergence.controllers.networks.learned:LearnedPolicy",
}
"""Entry points of the controllers by name, `module:class`; add an entry to register another one."""


def make_controller(
    name: str, head: HeadModel, layout: ObservationLayout | None = None, **options: Any
) -> Controller:
    """Make a controller by name.

    Args:
        name: one of `CONTROLLERS`.
        head: the model of the head to control.
        layout: the layout of observations and actions; None for the head's own layout.
        **options: the controller's own options.

    Raises:
        UnknownNameError: there is no such controller.
        ConfigurationError: an option is unknown or has an invalid value, or the layout belongs to
            another head.

    Examples:
        >>> import gymnasium, vergence
        >>> env = gymnasium.make("vergence/Gaze-v0", plant="kinematic", target="random")
        >>> head, layout = env.unwrapped.head, env.unwrapped.layout
        >>> controller = vergence.make_controller("saccade", head=head, layout=layout)
        >>> observation, info = env.reset(seed=1)
        >>> state = None
        >>> for _ in range(60):
        ...     action, state = controller.predict(observation, state)
        ...     observation, reward, terminated, truncated, info = env.step(action)
        >>> info["is_success"]
        True
    """
    if not isinstance(head, HeadModel):
        raise ConfigurationError(f"head: expected a HeadModel, see load_head, got {head!r:.80}")
    layout = checked_layout(head, layout)
    make = controller_class(name)
    try:
        inspect.signature(make).bind(head=head, layout=layout, **options)
    except TypeError as error:
        known = [option for option in default_options(name) if option != "layout"]
        for option in [one for one in options if one not in known]:
            raise ConfigurationError(
                f"controller {name}: expected one of its options, "
                f"{', '.join(known) or 'of which it has none'}, got {option} = "
                f"{options[option]!r:.80}{did_you_mean(option, known)}"
            ) from error
        raise ConfigurationError(f"controller {name}: {error}") from error
    controller: Controller = make(head=head, layout=layout, **options)
    return controller


WHICH_LAW: Final = (
    "state-feedback; once `vergence measure-delay` has measured the loop, saccade, or pursuit if "
    "targets move"
)
"""The law to choose: the steadiest under unknown faults first, then the quickest."""


def default_options(name: str) -> dict[str, Any]:
    """Return a controller's options that have a default, with it, by name.

    Raises:
        UnknownNameError: there is no such controller.
    """
    parameters = inspect.signature(controller_class(name)).parameters.values()
    return {
        one.name: one.default for one in parameters if one.default is not inspect.Parameter.empty
    }


def controller_class(name: str) -> Any:
    """Return the class of a registered controller; `UnknownNameError` if there is none."""
    if name not in list(CONTROLLERS):  # a list accepts unhashable names, too
        raise UnknownNameError("controller", name, sorted(CONTROLLERS))
    module, _, attribute = CONTROLLERS[name].partition(":")
    return getattr(import_module(module), attribute)


_MAX_LISTED_ARRAYS: Final = 10
"""Number of arrays from which on a message does not list their shapes (chosen: length)."""


class StatefulController(ABC):
    """A controller whose state is one packed row (S,) of float64 per head.

    `predict` returns it as a tuple of one array (..., S), and never changes the caller's arrays.
    """

    def __init__(self, *, head: HeadModel, layout: ObservationLayout) -> None:
        self.head = head
        self.layout = checked_layout(head, layout)

    @abstractmethod
    def _initial(self) -> FloatArray:
        """(S,) state at a trial's start."""

    @abstractmethod
    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        """(..., 4) velocities of the eyes' actuators, rad/s; changes `state` (..., S) in place."""

    @cached_property
    def _start(self) -> FloatArray:
        """`_initial`, computed once and never changed."""
        return self._initial()

    def predict(
        self, observation: NDArray[Any], state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None, deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:  # fmt: skip
        """Choose actions, see `Controller.predict`; also refuses a state of another batch."""
        leading = np.shape(observation)[:-1]
        rows = continued_state(self._start, leading, state, episode_start)
        command = self._command(self.layout.decode(observation), rows)
        return self.layout.action(command), (rows,)


def continued_state(
    initial: FloatArray, leading: tuple[int, ...], state: tuple[NDArray[Any], ...] | None,
    episode_start: NDArray[Any] | None,
) -> FloatArray:  # fmt: skip
    """Return the rows (..., S) to continue from, a copy, for observations of a leading shape.

    Those of episodes that have just begun are `initial`; a state of another shape is refused.
    """
    shape = (*leading, initial.size)
    if state is None:
        return np.broadcast_to(initial, shape).copy()
    given: Any = state  # a caller may pass anything, whatever the annotation says
    several = isinstance(given, tuple | list)
    if not several or len(given) != 1 or np.shape(given[0]) != shape:
        found = " ".join(f"{given!r:.200}".split())[:80]
        if several and len(given) < _MAX_LISTED_ARRAYS:
            found = ", ".join(str(np.shape(part)) for part in given)
        raise ConfigurationError(
            f"state: expected a tuple of one array of shape {shape}, got {found or '()'}"
        )
    rows = np.array(state[0], dtype=np.float64)
    if episode_start is not None:
        begun = np.asarray(episode_start, dtype=np.bool_)
        try:
            rows[np.broadcast_to(begun, leading)] = initial
        except ValueError as error:
            raise ConfigurationError(
                f"episode_start: expected shape {leading}, got {begun.shape}"
            ) from error
    return rows
