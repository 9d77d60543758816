"""Classes of a user's own, named `module:class` or `path/to/file.py:class`, and their mistakes.

What goes wrong in such code is said in one line that names the place there: who wrote it wants
neither our stack nor a guess.
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
_INSTALLED: Final = ("site-packages", "dist-packages", f"python{sys.version_info[0]}.")
_LONGEST: Final = 400
"""Characters of a message of somebody else's that are shown."""


def is_entry_point(word: object) -> bool:
    """Whether a word has the form `module:class`."""
    return isinstance(word, str) and all(word.rpartition(":"))


@dataclass(frozen=True, kw_only=True)
class EntryPoint:
    """Where a class is: `module:class` or `path/to/file.py:class`; picklable."""

    word: str
    what: str
    """What a message calls it, such as `controller`."""
    module: str
    """A dotted name, or the path of a file that ends in `.py`."""
    attribute: str
    folder: Path
    """The current folder at the time: where modules and files are looked for, in workers too."""

    @classmethod
    def of(cls, word: str, what: str) -> "EntryPoint":
        """The entry point that a word names.

        Args:
            word: such as `my_robot:Robot` or `folder/mine.py:Mine`.
            what: what a message calls it, such as `plant`.

        Raises:
            ConfigurationError: it names none.
        """
        module, colon, attribute = word.rpartition(":")
        named = module.endswith(".py") or all(part.isidentifier() for part in module.split("."))
        if not (colon and named and attribute.isidentifier()):
            raise ConfigurationError(
                f"{what}: expected module:class or path/to/file.py:class, got {word!r}"
            )
        return cls(word=word, what=what, module=module, attribute=attribute, folder=Path.cwd())

    def load(self) -> Any:
        """What stands there: a class, or a function.

        Raises:
            ConfigurationError: there is no such module, file or class, or it cannot be imported;
                the message has the error of the module itself, with its file and its line.
        """
        module = self._import()
        file = shown_path(getattr(module, "__file__", None) or self.module)
        if not hasattr(module, self.attribute):
            known = [name for name, one in vars(module).items() if _defined_in(module, one)]
            raise ConfigurationError(
                f"{self.what} {self.word}: expected {self.attribute} in {file}, got "
                f"{', '.join(known) or 'no class'}"
            )
        found = getattr(module, self.attribute)
        if not callable(found):
            raise ConfigurationError(
                f"{self.what} {self.word}: expected a class in {file}, got {found!r:.60}"
            )
        return found

    def classes(self, method: str) -> list[str]:
        """The classes of the module itself that have a method.

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
        expected = f"{self.what}: expected module:class that exists, got {self.word!r}"
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
        return ConfigurationError(f"{self.what} {self.word}: cannot be imported: {where(error)}")


def accepted_arguments(make: Callable[..., Any]) -> set[str] | None:
    """The names of the arguments that a function or class takes.

    Args:
        make: a function; or a class, whose `**options` are those of the class it derives from.

    Returns:
        The names, or None if it takes any.
    """
    if not isinstance(make, type):
        parameters = signature(make).parameters.values()
        if any(one.kind is Parameter.VAR_KEYWORD for one in parameters):
            return None
        return {one.name for one in parameters}
    names: set[str] = set()
    hands_on = False
    for owner in make.__mro__[:-1]:
        # a protocol's own takes anything and does nothing with it
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


def _defined_in(module: ModuleType, one: object) -> bool:
    return inspect.isclass(one) and one.__module__ == module.__name__


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
