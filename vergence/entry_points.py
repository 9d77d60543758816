"""Load a user's own classes, named `module:class` or `path/to/file.py:class`.

An error in such code is reported in one line with its place there, without this package's stack.
"""

import hashlib
import importlib
import inspect
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import module_from_spec, spec_from_file_location
from inspect import Parameter, signature
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from vergence.errors import ConfigurationError

_PACKAGE: Final = Path(__file__).parent
_INSTALLED_PATH_PARTS: Final = ("site-packages", "dist-packages", f"python{sys.version_info[0]}.")
_MAX_MESSAGE_CHARS: Final = 400
"""Most characters of a foreign error message that are shown (chosen: detail against length)."""


def is_entry_point(text: object) -> bool:
    """True if a word has the form `module:class`."""
    return isinstance(text, str) and all(text.rpartition(":"))


@dataclass(frozen=True, kw_only=True)
class EntryPoint:
    """Location of a class, `module:class` or `path/to/file.py:class`; picklable."""

    spec: str
    kind: str
    """Name for messages, such as `controller`."""
    module: str
    """A dotted name, or the path of a file that ends in `.py`."""
    attribute: str
    folder: Path
    """Current folder at creation, in which modules and files are searched, in workers as well."""

    @classmethod
    def of(cls, spec: str, kind: str) -> "EntryPoint":
        """Parse an entry point.

        Args:
            spec: text such as `my_robot:Robot` or `folder/mine.py:Mine`.
            kind: name for messages, such as `plant`.

        Raises:
            ConfigurationError: the text is not an entry point.
        """
        module, colon, attribute = spec.rpartition(":")
        named = module.endswith(".py") or all(part.isidentifier() for part in module.split("."))
        if not (colon and named and attribute.isidentifier()):
            raise ConfigurationError(
                f"{kind}: expected module:class or path/to/file.py:class, got {spec!r}"
            )
        return cls(spec=spec, kind=kind, module=module, attribute=attribute, folder=Path.cwd())

    def load(self) -> Any:
        """Import the class or function.

        Raises:
            ConfigurationError: there is no such module, file or class, or it cannot be imported;
                the message includes the module's own error, with its file and line.
        """
        module = self._import()
        file = shown_path(getattr(module, "__file__", None) or self.module)
        if not hasattr(module, self.attribute):
            known = [name for name, one in vars(module).items() if _defined_in(module, one)]
            raise ConfigurationError(
                f"{self.kind} {self.spec}: expected {self.attribute} in {file}, got "
                f"{', '.join(known) or 'no class'}"
            )
        found = getattr(module, self.attribute)
        if not callable(found):
            raise ConfigurationError(
                f"{self.kind} {self.spec}: expected a class in {file}, got {found!r:.60}"
            )
        return found

    def class_names_with_method(self, method: str) -> list[str]:
        """Names of the classes defined in the module that have a method.

        Raises:
            ConfigurationError: there is no such module or file, or it cannot be imported.
        """
        module = self._import()
        return [
            name
            for name, one in vars(module).items()
            if _defined_in(module, one) and hasattr(one, method)
        ]

    def _import(self) -> ModuleType:
        _append(self.folder)
        importlib.invalidate_caches()
        expected = f"{self.kind}: expected module:class that exists, got {self.spec!r}"
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

    def _cannot_import(self, error: BaseException) -> ConfigurationError:
        return ConfigurationError(
            f"{self.kind} {self.spec}: cannot be imported: {user_error_with_place(error)}"
        )


def accepted_arguments(function_or_class: Callable[..., Any]) -> set[str] | None:
    """Names of the arguments that a function or class accepts.

    Args:
        function_or_class: `**options` of a class are taken to go to its base class.

    Returns:
        The names, or None if it accepts any.
    """
    if not isinstance(function_or_class, type):
        parameters = signature(function_or_class).parameters.values()
        if any(one.kind is Parameter.VAR_KEYWORD for one in parameters):
            return None
        return {one.name for one in parameters}
    names: set[str] = set()
    hands_on = False
    for owner in function_or_class.__mro__[:-1]:
        # the `__init__` of a protocol accepts anything and ignores it
        if "__init__" not in vars(owner) or vars(owner).get("_is_protocol"):
            continue
        parameters = signature(vars(owner)["__init__"]).parameters.values()
        names |= {
            one.name
            for one in list(parameters)[1:]
            if one.kind in (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
        }
        hands_on = any(one.kind is Parameter.VAR_KEYWORD for one in parameters)
        if not hands_on:
            break
    return None if hands_on else names


def user_error_with_place(error: BaseException) -> str:
    """Describe an error in a user's code, with its place, in one line.

    Args:
        error: the error that this code raised.

    Returns:
        `file:line in function: Type: message`, for the innermost place in the user's code. Places
        in this package are never named, those in Python or installed packages only if there is no
        other.
    """
    said = _one_line(error)
    if isinstance(error, SyntaxError) and error.filename:
        return f"{shown_path(error.filename)}:{error.lineno}: {type(error).__name__}: {error.msg}"
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if not (frame.filename.startswith("<frozen") or _PACKAGE in Path(frame.filename).parents)
    ]
    own = [
        frame
        for frame in frames
        if not any(part in frame.filename for part in _INSTALLED_PATH_PARTS)
    ]
    if not frames:
        return said
    frame = (own or frames)[-1]
    place = "" if frame.name == "<module>" else f" in {frame.name}"
    return f"{shown_path(frame.filename)}:{frame.lineno}{place}: {said}"


def shown_path(path: str | Path) -> str:
    """Path relative to the current folder, if it is within it."""
    with suppress(ValueError, OSError):
        return str(Path(path).relative_to(Path.cwd()))
    return str(path)


def _one_line(error: BaseException) -> str:
    try:
        text = " ".join(str(error).split())
    except Exception:  # a user's own __str__ may fail
        text = ""
    text = text if len(text) <= _MAX_MESSAGE_CHARS else f"{text[:_MAX_MESSAGE_CHARS]}..."
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _defined_in(module: ModuleType, one: object) -> bool:
    return inspect.isclass(one) and one.__module__ == module.__name__


def _append(folder: Path) -> None:
    """Add a folder to the end of the module search path."""
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


def _load_file(path: Path) -> ModuleType:
    """Load the module in a file; an unchanged file is loaded only once."""
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
    sys.modules[name] = module  # pickling its classes and creating dataclasses require this
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
