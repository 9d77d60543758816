"""Controllers of somebody's own: made, and watched while they run.

What goes wrong in their code is said in one line that names the place there: who wrote it wants
neither our stack nor a guess.
"""

import inspect
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.controller import Controller
from vergence.entry_points import EntryPoint, shown_path, where
from vergence.envs.layout import ObservationLayout
from vergence.envs.policy import Policy
from vergence.errors import ConfigurationError, ControllerError, HardwareError, VergenceError
from vergence.models.head import HeadModel

_PREDICT: Final = "predict(observation, state=None, episode_start=None, deterministic=True)"


def make_own(
    entry: EntryPoint, head: HeadModel, layout: ObservationLayout, options: Mapping[str, Any]
) -> "Watched":
    """A controller of somebody's own, watched.

    Raises:
        ConfigurationError: there is no such class, or it has no `predict` to be called.
        ControllerError: its code raises.
    """
    make = entry.load()
    with suppress(ValueError):  # what is written in C may have no signature
        try:
            inspect.signature(make).bind(head=head, layout=layout, **options)
        except TypeError as error:
            raise ConfigurationError(
                f"controller {entry.word}: expected to be made with head= and layout=, "
                f"got {entry.attribute}{inspect.signature(make)}: {error}"
            ) from error
    try:
        controller = make(head=head, layout=layout, **options)
    except (Exception, SystemExit) as error:
        raise ControllerError(f"controller {entry.word}: cannot be made: {where(error)}") from error
    return Watched(controller, entry.word)


def option_names(make: Any) -> set[str] | None:
    """The options that a class takes beside `head` and `layout`; None for any."""
    parameters = inspect.signature(make).parameters.values()
    if any(one.kind is inspect.Parameter.VAR_KEYWORD for one in parameters):
        return None
    return {one.name for one in parameters} - {"head", "layout"}


def blamed(controller: Policy) -> AbstractContextManager[None]:
    """Blame a controller of somebody's own for all that is refused meanwhile, and no other.

    See `Watched.blamed`.
    """
    return controller.blamed() if isinstance(controller, Watched) else nullcontext()


class Watched:
    """A controller that says in one line what goes wrong in its `predict`, and where.

    Args:
        controller: anything with Stable-Baselines3's `predict`.
        label: what messages call it.

    Raises:
        ConfigurationError: it has no `predict` that can be called so.
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
                    f"controller {label}: expected {_PREDICT}, got "
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
            ControllerError: it raises, or answers something else than actions and a state.
        """
        self._calls += 1
        try:
            answer = self._controller.predict(
                observation, state=state, episode_start=episode_start, deterministic=deterministic
            )
        except (Exception, SystemExit) as error:
            raise self._wrong(where(error)) from error
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
    def blamed(self) -> Iterator[None]:
        """What is refused meanwhile, such as actions that are nan, is this controller's fault.

        A robot's fault, such as a cable that is pulled, is its own.
        """
        try:
            yield
        except (ControllerError, HardwareError):
            raise
        except VergenceError as error:
            if self._calls == 0:
                raise
            raise self._wrong(f"{error}{_file_of(self._controller)}") from error

    def _wrong(self, what: str) -> ControllerError:
        return ControllerError(f"controller {self._label}: predict, call {self._calls}: {what}")


def _file_of(controller: Controller) -> str:
    with suppress(TypeError, OSError):
        return f" ({shown_path(inspect.getfile(type(controller)))})"
    return ""
