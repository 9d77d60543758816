"""Controllers of somebody's own: found by module or file, made, and watched while they run.

What goes wrong in their code is said in one line that names the place there: who wrote it wants
neither our stack nor a guess.
"""

import hashlib
import importlib
import inspect
import sys
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.controller import Controller
from vergence.envs.layout import ObservationLayout
from vergence.errors import ConfigurationError, ControllerError, VergenceError
from vergence.models.head import HeadModel

_PACKAGE: Final = Path(__file__).parents[2]
_INSTALLED: Final = ("site-packages", "dist-packages", f"python{sys.version_info[0]}.")
_PREDICT: Final = "predict(observation, state=None, episode_start=None, deterministic=True)"
_LONGEST: Final = 400
"""Characters of a message of somebody else's that are shown."""


@dataclass(frozen=True, kw_only=True)
class EntryPoint:
    """Where a controller's class is: `module:class` or `path/to/file.py:class`; picklable."""

    word: str
    module: str
    """A dotted name, or the path of a file that ends in `.py`."""
    attribute: str
    folder: Path
    """The current folder at the time: where modules and files are looked for, in workers too."""

    @classmethod
    def of(cls, word: str) -> "EntryPoint":
        """The entry point that a word names.

        Raises:
            ConfigurationError: it names none.
        """
        module, colon, attribute = word.rpartition(":")
        named = module.endswith(".py") or all(part.isidentifier() for part in module.split("."))
        if not (colon and named and attribute.isidentifier()):
            raise ConfigurationError(
                f"controller: expected module:class or path/to/file.py:class, got {word!r}"
            )
        return cls(word=word, module=module, attribute=attribute, folder=Path.cwd())

    def load(self) -> Any:
        """What makes the controller: a class, or a function.

        Raises:
            ConfigurationError: there is no such module, file or class.
            ControllerError: the module cannot be imported.
        """
        module = self._import()
        file = shown_path(getattr(module, "__file__", None) or self.module)
        if not hasattr(module, self.attribute):
            known = [name for name, one in vars(module).items() if hasattr(one, "predict")]
            raise ConfigurationError(
                f"controller {self.word}: expected {self.attribute} in {file}, got "
                f"{', '.join(known) or 'no class with predict'}"
            )
        found = getattr(module, self.attribute)
        if not callable(found):
            raise ConfigurationError(
                f"controller {self.word}: expected a class in {file}, got {found!r:.60}"
            )
        return found

    def _import(self) -> ModuleType:
        _append(self.folder)
        importlib.invalidate_caches()
        expected = f"controller: expected module:class that exists, got {self.word!r}"
        try:
            if self.module.endswith(".py"):
                return _load_file(self.folder / self.module)
            return importlib.import_module(self.module)
        except ModuleNotFoundError as error:
            if error.name and f"{self.module}.".startswith(f"{error.name}."):
                raise ConfigurationError(
                    f"{expected}: no module {error.name}, in {self.folder} neither"
                ) from error
            raise self._cannot_import(error) from error
        except FileNotFoundError as error:
            if error.filename == str(self.folder / self.module):
                raise ConfigurationError(f"{expected}: no such file") from error
            raise self._cannot_import(error) from error
        except (Exception, SystemExit) as error:
            raise self._cannot_import(error) from error

    def _cannot_import(self, error: BaseException) -> ControllerError:
        return ControllerError(f"controller {self.word}: cannot be imported: {where(error)}")

    def option_names(self) -> set[str] | None:
        """The options that it takes beside the head and the layout; None for any."""
        return option_names(self.load())

    def make(
        self, head: HeadModel, layout: ObservationLayout, options: Mapping[str, Any]
    ) -> "Watched":
        """The controller, watched.

        Raises:
            ConfigurationError: there is no such class, or it has no `predict` to be called.
            ControllerError: its code raises.
        """
        make = self.load()
        with suppress(ValueError):  # what is written in C may have no signature
            try:
                inspect.signature(make).bind(head=head, layout=layout, **options)
            except TypeError as error:
                raise ConfigurationError(
                    f"controller {self.word}: expected to be made with head= and layout=, "
                    f"got {self.attribute}{inspect.signature(make)}: {error}"
                ) from error
        try:
            controller = make(head=head, layout=layout, **options)
        except (Exception, SystemExit) as error:
            raise ControllerError(
                f"controller {self.word}: cannot be made: {where(error)}"
            ) from error
        return Watched(controller, self.word)


def option_names(make: Any) -> set[str] | None:
    """The options that a class takes beside `head` and `layout`; None for any."""
    parameters = inspect.signature(make).parameters.values()
    if any(one.kind is inspect.Parameter.VAR_KEYWORD for one in parameters):
        return None
    return {one.name for one in parameters} - {"head", "layout"}


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
        """What is refused meanwhile, such as actions that are nan, is this controller's fault."""
        try:
            yield
        except ControllerError:
            raise
        except VergenceError as error:
            if self._calls == 0:
                raise
            raise self._wrong(f"{error}{_file_of(self._controller)}") from error

    def _wrong(self, what: str) -> ControllerError:
        return ControllerError(f"controller {self._label}: predict, call {self._calls}: {what}")


def where(error: BaseException) -> str:
    """The place in somebody's code and the error there, in one line.

    Args:
        error: what their code has raised.

    Returns:
        `file:line in function: Type: message`; the innermost place in their own code, which is
        neither this package, nor Python, nor an installed package unless there is no other.
    """
    said = _one_line(error)
    if isinstance(error, SyntaxError) and error.filename:
        return f"{shown_path(error.filename)}:{error.lineno}: {type(error).__name__}: {error.msg}"
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if not (frame.filename.startswith("<frozen") or _PACKAGE in Path(frame.filename).parents)
    ]
    own = [frame for frame in frames if not any(part in frame.filename for part in _INSTALLED)]
    if not frames:
        return said
    frame = (own or frames)[-1]
    place = "" if frame.name == "<module>" else f" in {frame.name}"
    return f"{shown_path(frame.filename)}:{frame.lineno}{place}: {said}"


def shown_path(path: str | Path) -> str:
    """A path as a person in the current folder would write it."""
    with suppress(ValueError, OSError):
        return str(Path(path).relative_to(Path.cwd()))
    return str(path)


def _one_line(error: BaseException) -> str:
    try:
        text = " ".join(str(error).split())
    except Exception:  # somebody's own __str__
        text = ""
    text = text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _file_of(controller: Controller) -> str:
    with suppress(TypeError, OSError):
        return f" ({shown_path(inspect.getfile(type(controller)))})"
    return ""


def _append(folder: Path) -> None:
    """Let modules be found in a folder too, where nothing else has them."""
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


def _load_file(path: Path) -> ModuleType:
    """The module in a file; the same one as long as the file is the same."""
    content = path.read_bytes()
    digest = hashlib.sha256(str(path).encode() + content).hexdigest()
    name = f"{path.stem}_{digest[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"expected a Python file, got {path}")
    _append(path.parent)
    module = module_from_spec(spec)
    sys.modules[name] = module  # classes of it can then be pickled, and dataclasses made
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
