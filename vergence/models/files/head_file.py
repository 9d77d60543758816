"""Heads in files: the presets that come with the package, and files of one's own."""

import os
from importlib import resources
from pathlib import Path

from vergence.errors import HeadFileError, UnknownNameError
from vergence.files import write_whole
from vergence.models.files.head_toml import head_to_toml, parse_head
from vergence.models.head import HeadModel

_PRESETS = resources.files("vergence.models.files") / "presets"


def presets() -> list[str]:
    """The names of the heads that come with the package."""
    return sorted(
        entry.name.removesuffix(".toml")
        for entry in _PRESETS.iterdir()
        if entry.name.endswith(".toml")
    )


def load_head(source: str | os.PathLike[str]) -> HeadModel:
    """Load a head from a preset or a TOML file.

    Args:
        source: a preset's name (`simulated`, `physical`) or the path of a TOML file, which
            ends in `.toml` or contains a separator.

    Returns:
        The head.

    Raises:
        UnknownNameError: there is no such preset.
        HeadFileError: the file is missing or is not a head; the message names the key, the
            value and what was expected.
    """
    if not isinstance(source, str | os.PathLike):
        raise UnknownNameError("head", source, [*presets(), "a path of a .toml file"])
    text = os.fspath(source)
    if text in presets():
        return parse_head((_PRESETS / f"{text}.toml").read_text(encoding="utf-8"))
    if not text.endswith(".toml") and os.sep not in text:
        raise UnknownNameError("head", text, [*presets(), "a path of a .toml file"])
    try:
        content = Path(text).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not text"
        raise HeadFileError(text, reason, "a readable TOML file") from error
    return parse_head(content)


def save_head(head: HeadModel, path: str | os.PathLike[str]) -> None:
    """Write one head to a TOML file, whole or not at all.

    Args:
        head: one head, not a population.
        path: where to write; an existing file is replaced.

    Raises:
        HeadFileError: the head is a population.
        OSError: the file cannot be written.
    """
    write_whole(path, head_to_toml(head))
