"""Register the package's environments; load users' classes, `module:class` or `file.py:class`.

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


MAX_EPISODE_STEPS: Final = 240
"""Steps of an episode of the registered environments: 2 s at 120 Hz (chosen: time to settle
against time of a simulation)."""


def register_environments() -> None:
    """Register the package's environments with Gymnasium, unless this has been done."""
    from gymnasium.envs.registration import register, registry

    if "vergence/Gaze-v0" not in registry:
        register(
            id="vergence/Gaze-v0",
            entry_point="vergence.envs.gaze:GazeEnv",
            vector_entry_point="vergence.envs.gaze:GazeVectorEnv",
            max_episode_steps=MAX_EPISODE_STEPS,
        )
        environments = "vergence.controllers.networks.environments"
        register(
            id="vergence/GainSchedule-v0",
            entry_point=f"{environments}:GainScheduleEnv",
            vector_entry_point=f"{environments}:GainScheduleVectorEnv",
            max_episode_steps=MAX_EPISODE_STEPS,
        )
        # its episodes last for seconds, whatever the control rate
        register(
            id="vergence/GazeHardware-v0", entry_point="vergence.hardware.gaze:GazeHardwareEnv"
        )


def is_entry_point(text: object) -> bool:
    """True if a word has the form `module:class`."""
    return isinstance(text, str) and all(text.rpartition(":"))


@dataclass(frozen=True, kw_only=True)
class EntryPoint:
    """Location of a class, `module:class` or `path/to/file.py:class`; picklable."""

    spec: str
    kind: str  # name for messages, such as `controller`
    module: str  # a dotted name, or the path of a file that ends in `.py`
    attribute: str
    folder: Path
    """Current folder at creation, in which modules and files are searched, in workers as well."""

    @classmethod
    def of(cls, spec: str, kind: str) -> "EntryPoint":
        """Parse an entry point, or raise a `ConfigurationError` for other text."""
        module, colon, attribute = spec.rpartition(":")
        named = module.endswith(".py") or all(part.isidentifier() for part in module.split("."))
        if not (colon and named and attribute.isidentifier()):
            raise ConfigurationError(
                f"{kind}: expected module:class or path/to/file.py:class, got {spec!r}"
            )
        return cls(spec=spec, kind=kind, module=module, attribute=attribute, folder=Path.cwd())

    def load(self) -> Any:
        """Import the class or function, or raise a `ConfigurationError` that says why not."""
        module = self._import()
        file = shown_path(getattr(module, "__file__", None) or self.module)
        expected = f"{self.kind} {self.spec}: expected"
        if not hasattr(module, self.attribute):
            known = ", ".join(_classes_of(module)) or "no class"
            raise ConfigurationError(f"{expected} {self.attribute} in {file}, got {known}")
        found = getattr(module, self.attribute)
        if not callable(found):
            raise ConfigurationError(f"{expected} a class in {file}, got {found!r:.60}")
        return found

    def class_names_with_method(self, method: str) -> list[str]:
        """Names of the classes defined in the module that have a method."""
        return [name for name, one in _classes_of(self._import()).items() if hasattr(one, method)]

    def _import(self) -> ModuleType:
        register_environments()  # which the user's code may make
        _append(self.folder)
        importlib.invalidate_caches()
        file = self.folder / self.module
        try:
            if self.module.endswith(".py"):
                return _load_file(file)
            return importlib.import_module(self.module)
        except (Exception, SystemExit) as error:
            why = f"{self.kind}: expected module:class that exists, got {self.spec!r}: "
            name = error.name if isinstance(error, ModuleNotFoundError) else None
            if name and f"{self.module}.".startswith(f"{name}."):
                why += f"no module {name}, in {self.folder} neither"
            elif isinstance(error, FileNotFoundError) and error.filename == str(file):
                why += "no such file"
            else:
                said = user_error_with_place(error)
                why = f"{self.kind} {self.spec}: cannot be imported: {said}"
            raise ConfigurationError(why) from error


def accepted_arguments(function_or_class: Callable[..., Any]) -> set[str] | None:
    """Names of the accepted arguments, None for any; a class's `**options` go to its base class."""
    functions = [function_or_class]
    if is_class := isinstance(function_or_class, type):
        # the `__init__` of a protocol accepts anything and ignores it
        owners = [own for own in map(vars, function_or_class.__mro__[:-1]) if "__init__" in own]
        functions = [own["__init__"] for own in owners if not own.get("_is_protocol")]
    names: set[str] = set()
    for function in functions:
        parameters = list(signature(function).parameters.values())[is_class:]
        named = (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
        names |= {one.name for one in parameters if one.kind in named}
        if all(one.kind is not Parameter.VAR_KEYWORD for one in parameters):
            return names
    return None if functions else names


def user_error_with_place(error: BaseException) -> str:
    """Describe an error in a user's code in one line: `file:line in function: Type: message`.

    The place is the innermost in the user's code, never one in this package, and one in Python or
    installed packages only if there is no other.
    """
    if isinstance(error, SyntaxError) and error.filename:
        return f"{shown_path(error.filename)}:{error.lineno}: {type(error).__name__}: {error.msg}"
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if not (frame.filename.startswith("<frozen") or _PACKAGE in Path(frame.filename).parents)
    ]
    # the user's own ones last
    frames.sort(key=lambda frame: not any(part in frame.filename for part in _INSTALLED_PATH_PARTS))
    if not frames:
        return _one_line(error)
    place = "" if frames[-1].name == "<module>" else f" in {frames[-1].name}"
    return f"{shown_path(frames[-1].filename)}:{frames[-1].lineno}{place}: {_one_line(error)}"


def shown_path(path: str | Path) -> str:
    """Path relative to the current folder, if it is within it."""
    with suppress(ValueError, OSError):
        return str(Path(path).relative_to(Path.cwd()))
    return str(path)


def _one_line(error: BaseException) -> str:
    text = ""
    with suppress(Exception):  # a user's own __str__ may fail
        text = " ".join(str(error).split())
    text = text if len(text) <= 400 else f"{text[:400]}..."  # (chosen: detail against length)
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _classes_of(module: ModuleType) -> dict[str, type]:
    """Classes that are defined in a module, by name."""
    return {
        name: one
        for name, one in vars(module).items()
        if inspect.isclass(one) and one.__module__ == module.__name__
    }


def _append(folder: Path) -> None:
    """Add a folder to the end of the module search path."""
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


def _load_file(path: Path) -> ModuleType:
    """Load the module in a file; an unchanged file is loaded only once."""
    digest = hashlib.sha256(str(path).encode() + path.read_bytes()).hexdigest()
    name = f"{path.stem}_{digest[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None  # as the name ends in .py
    _append(path.parent)
    module = module_from_spec(spec)
    sys.modules[name] = module  # pickling its classes and creating dataclasses require this
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
