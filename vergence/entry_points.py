"""Classes and functions of a user's own, named `module:attribute`, and what is wrong with them."""

import sys
from collections.abc import Callable
from importlib import import_module
from inspect import Parameter, signature
from pathlib import Path
from typing import Any

from vergence.errors import ConfigurationError


def is_entry_point(word: object) -> bool:
    """Whether a word has the form `module:attribute`."""
    return isinstance(word, str) and all(word.partition(":"))


def load_entry_point(word: str, what: str) -> Any:
    """What `module:attribute` names; modules in the current folder are found too, last of all.

    Args:
        word: such as `my_robot:Robot`, or `package.module:Class`.
        what: what a message calls it, such as `plant`.

    Returns:
        The attribute.

    Raises:
        ConfigurationError: the module is not there, cannot be imported, or lacks the attribute; the
            message has the error of the module itself, its file and its line.
    """
    name, _, attribute = word.partition(":")
    append_current_folder()
    try:
        found = import_module(name)
        for part in attribute.split("."):
            found = getattr(found, part)
    except Exception as error:  # whatever a user's module raises
        raise ConfigurationError(
            f"{what} {word!r}: expected module:attribute that can be imported, got "
            f"{type(error).__name__}: {' '.join(str(error).split())}{_where(error)}"
        ) from error
    return found


def append_current_folder() -> None:
    """Let modules in the current folder be imported, where no other place has them."""
    folder = Path.cwd()
    if folder not in {Path(entry).absolute() for entry in sys.path}:
        sys.path.append(str(folder))


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


def _where(error: BaseException) -> str:
    """The last line of a user's code that an error passed through."""
    if isinstance(error, SyntaxError):
        return ""  # its text has it
    trace, own = error.__traceback__, None
    while trace is not None:
        file = trace.tb_frame.f_code.co_filename
        if file != __file__ and "importlib" not in file:
            own = f" ({file}, line {trace.tb_lineno})"
        trace = trace.tb_next
    return own or ""
