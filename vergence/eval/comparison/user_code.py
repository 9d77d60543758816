"""User-defined controllers: making them, and reporting their errors while they run.

An error in their code becomes a message of one line that names the place in that code, instead of a
traceback through this package.
"""

import inspect
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.controller import Controller
from vergence.entry_points import EntryPoint, shown_path, user_error_with_place
from vergence.envs.layout import ObservationLayout
from vergence.envs.policy import Policy
from vergence.errors import ConfigurationError, HardwareError, UserControllerError, VergenceError
from vergence.models.head import HeadModel

_PREDICT_SIGNATURE: Final = (
    "predict(observation, state=None, episode_start=None, deterministic=True)"
)


def make_user_controller(
    entry: EntryPoint, head: HeadModel, layout: ObservationLayout, options: Mapping[str, Any]
) -> "GuardedController":
    """Make a user-defined controller and wrap it in `GuardedController`.

    Raises:
        ConfigurationError: there is no such class, or it has no suitable `predict`.
        UserControllerError: its constructor raises.
    """
    make = entry.load()
    with suppress(ValueError):  # classes written in C may have no signature
        try:
            inspect.signature(make).bind(head=head, layout=layout, **options)
        except TypeError as error:
            raise ConfigurationError(
                f"controller {entry.spec}: expected to be made with head= and layout=, "
                f"got {entry.attribute}{inspect.signature(make)}: {error}"
            ) from error
    try:
        controller = make(head=head, layout=layout, **options)
    except (Exception, SystemExit) as error:
        raise UserControllerError(
            f"controller {entry.spec}: cannot be made: {user_error_with_place(error)}"
        ) from error
    return GuardedController(controller, entry.spec)


def option_names(controller_factory: Any) -> set[str] | None:
    """Names of the options that a class takes besides `head` and `layout`; None for any name."""
    parameters = inspect.signature(controller_factory).parameters.values()
    if any(one.kind is inspect.Parameter.VAR_KEYWORD for one in parameters):
        return None
    return {one.name for one in parameters} - {"head", "layout"}


def errors_attributed_to(controller: Policy) -> AbstractContextManager[None]:
    """Context that attributes errors to a user-defined controller; no effect for other ones.

    See `GuardedController.attributing_errors`.
    """
    return (
        controller.attributing_errors()
        if isinstance(controller, GuardedController)
        else nullcontext()
    )


class GuardedController:
    """Wrapper of a controller that reports errors of its `predict` in one line, with their place.

    Args:
        controller: any object with Stable-Baselines3's `predict`.
        label: name in messages.

    Raises:
        ConfigurationError: the controller has no `predict` with that signature.
    """

    def __init__(self, controller: Any, label: str) -> None:
        predict = getattr(controller, "predict", None)
        if not callable(predict):
            raise ConfigurationError(
                f"controller {label}: expected an object with predict, got {controller!r:.60}"
            )
        with suppress(ValueError):
            try:
                inspect.signature(predict).bind(
                    None, state=None, episode_start=None, deterministic=True
                )
            except TypeError as error:
                raise ConfigurationError(
                    f"controller {label}: expected {_PREDICT_SIGNATURE}, got "
                    f"predict{inspect.signature(predict)}{_file_of(controller)}: {error}"
                ) from error
        self._controller = controller
        self._label = label
        self._calls = 0

    def predict(
        self,
        observation: NDArray[Any],
        state: Any = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], Any]:
        """See `Controller.predict`.

        Raises:
            UserControllerError: it raises, or does not return actions and a state.
        """
        self._calls += 1
        try:
            answer = self._controller.predict(
                observation, state=state, episode_start=episode_start, deterministic=deterministic
            )
        except (Exception, SystemExit) as error:
            raise self._wrong(user_error_with_place(error)) from error
        try:
            action, state = answer
            action = np.asarray(action)
        except (TypeError, ValueError) as error:
            raise self._wrong(
                f"expected (actions, state), got {answer!r:.60}{_file_of(self._controller)}"
            ) from error
        if action.dtype.kind not in "fiu":
            raise self._wrong(
                f"expected actions as real numbers, got {action.dtype}{_file_of(self._controller)}"
            )
        return action, state

    @contextmanager
    def attributing_errors(self) -> Iterator[None]:
        """Attribute errors raised within the context, such as for nan actions, to this controller.

        Errors of a robot, such as a disconnected cable, stay as they are.
        """
        try:
            yield
        except (UserControllerError, HardwareError):
            raise
        except VergenceError as error:
            if self._calls == 0:
                raise
            raise self._wrong(f"{error}{_file_of(self._controller)}") from error

    def _wrong(self, what: str) -> UserControllerError:
        return UserControllerError(f"controller {self._label}: predict, call {self._calls}: {what}")


def _file_of(controller: Controller) -> str:
    with suppress(TypeError, OSError):
        return f" ({shown_path(inspect.getfile(type(controller)))})"
    return ""
