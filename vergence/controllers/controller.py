"""The interface of controllers, and their registry."""

import inspect
from importlib import import_module
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.fitting import checked_layout
from vergence.envs.observation import ObservationLayout
from vergence.errors import ConfigurationError, UnknownNameError, did_you_mean
from vergence.models.head import HeadModel


class Controller(Protocol):
    """A policy with the `predict` of Stable-Baselines3, batched."""

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
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
    "delay-compensated": "vergence.controllers.delay_compensated:DelayCompensatedIBVS",
    "state-feedback": "vergence.controllers.state_feedback:StateFeedback",
    "saccade": "vergence.controllers.saccade:Saccade",
    "ibvs-tuned": "vergence.controllers.tuned_ibvs:TunedIBVS",
    "adaptive": "vergence.controllers.adaptive:AdaptiveIBVS",
    "pid": "vergence.controllers.pid:PID",
    "fuzzy": "vergence.controllers.fuzzy:FuzzyPID",
    "pursuit": "vergence.controllers.pursuit:Pursuit",
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

    Returns:
        The controller.

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
    """Return the class of a registered controller.

    Raises:
        UnknownNameError: there is no such controller.
    """
    if name not in list(CONTROLLERS):  # a list accepts unhashable names, too
        raise UnknownNameError("controller", name, sorted(CONTROLLERS))
    module, _, attribute = CONTROLLERS[name].partition(":")
    return getattr(import_module(module), attribute)
