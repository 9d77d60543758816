"""What the environments of the gaze task, single and vector, offer beyond Gymnasium's interface."""

from collections.abc import Mapping, Sequence
from typing import Any

from vergence.entry_points import accepted_arguments
from vergence.envs.layout import ObservationLayout
from vergence.envs.reading import Reading, Truth
from vergence.envs.task import GazeTask
from vergence.envs.views import Viewer, window_missing
from vergence.errors import ConfigurationError, RenderingUnavailableError, refuse_unknown


def checked_render_mode(mode: str | None, known: Sequence[str]) -> str | None:
    """A render mode that is known, or None.

    Raises:
        ConfigurationError: the mode is another.
        RenderingUnavailableError: it needs a window, and pygame is not installed.
    """
    if mode is not None and mode not in known:
        raise ConfigurationError(
            f"render_mode: expected None or one of {', '.join(known)}, got {mode!r}"
        )
    missing = window_missing() if mode == "human" else None
    if missing is not None:
        raise RenderingUnavailableError(missing)
    return mode


def checked_options(options: Mapping[str, Any] | None, known: Sequence[str]) -> dict[str, Any]:
    """The options of a call of `reset`.

    Raises:
        ConfigurationError: one is unknown.
    """
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise ConfigurationError(f"reset: options: expected a mapping or None, got {options!r:.80}")
    refuse_unknown("reset: options", options, known)
    return dict(options)


def checked_arguments(task: type[GazeTask], arguments: Mapping[str, Any]) -> Mapping[str, Any]:
    """Arguments of an environment that its task takes.

    Raises:
        ConfigurationError: one is unknown.
    """
    known = accepted_arguments(task)
    if known is not None:
        refuse_unknown("environment", arguments, sorted(known - {"num"}))
    return arguments


class TaskEnv:
    """An environment around a task: one head is a batch of one."""

    task: GazeTask
    render_mode: str | None
    metadata: dict[str, Any]
    _viewer: Viewer | None = None

    @property
    def layout(self) -> ObservationLayout:
        """What each number of an observation and an action means."""
        return self.task.layout

    @property
    def reading(self) -> Reading:
        """What the sensors report at present, a row a head."""
        return self.task.reading

    def truth(self) -> Truth | None:
        """What the plant's simulation knows about the present, a row a head; else None."""
        return self.task.truth()

    def _view(self) -> Viewer | None:
        """What draws the pictures, made for the first of them; None if none are wanted."""
        if self._viewer is None and self.render_mode is not None:
            self._viewer = Viewer(self.task, self.render_mode, self.metadata["render_fps"])
        return self._viewer

    def _release(self) -> None:
        """Bring the heads to rest, release the plant, and close the window if there is one."""
        self.task.close()
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_viewer": None}
