"""Load and save heads: the presets of the package, and the user's own files."""

import os
from difflib import get_close_matches
from importlib import resources
from pathlib import Path

from vergence.errors import HeadFileError, UnknownNameError, UnreadableFileError
from vergence.files import write_atomic
from vergence.models.files.head_toml import head_to_toml, parse_head
from vergence.models.head import HeadModel

_PRESETS = resources.files("vergence.models.files") / "presets"

_STEREO = "vergence import stereo makes of a calibrated pair"
_CONVERTERS = {
    ".yml": _STEREO,
    ".yaml": _STEREO,
    ".json": _STEREO,
    ".xml": f"{_STEREO}, vergence import urdf of a robot",
    ".urdf": "vergence import urdf makes of a robot",
}
"""Command that converts a file often mistaken for a head file, by file suffix."""


def presets() -> list[str]:
    """Names of the heads that come with the package."""
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
        UnreadableFileError: the file is missing, or is no text.
        HeadFileError: the file is not a head; the message names the key, the value and what was
            expected.

    Examples:
        >>> import vergence
        >>> head = vergence.load_head("turrets")
        >>> head.joints[3:]
        ('left_pan', 'left_tilt', 'right_pan', 'right_tilt')
    """
    if not isinstance(source, str | os.PathLike):
        raise UnknownNameError("head", source, [*presets(), "a path of a .toml file"])
    text = os.fspath(source)
    if text in presets():
        return parse_head((_PRESETS / f"{text}.toml").read_text(encoding="utf-8"))
    maker = _CONVERTERS.get(Path(text).suffix.lower())
    if maker is not None:
        raise UnreadableFileError(text, "no head file", f"a TOML file, which {maker}")
    if not text.endswith(".toml") and os.sep not in text:
        raise UnknownNameError("head", text, [*presets(), "a path of a .toml file"])
    try:
        # editors on Windows begin a file with a byte order mark
        content = Path(text).read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not text in UTF-8"
        raise UnreadableFileError(text, reason + _meant(text), "a TOML file") from error
    try:
        return parse_head(content)
    except HeadFileError as error:
        raise HeadFileError(error.key, error.value, error.expected, text) from error


def _meant(path: str) -> str:
    """Hint at the preset whose name resembles a path's."""
    near = get_close_matches(Path(path).stem, presets(), n=1)
    return f" (--head {near[0]} is the preset)" if near else ""


def absolute_source(source: str) -> str:
    """Head name that is valid in any working directory: a preset's name or an absolute path."""
    return source if source in presets() else str(Path(source).absolute())


def save_head(head: HeadModel, path: str | os.PathLike[str]) -> None:
    """Write one head to a TOML file atomically.

    Args:
        head: one head, not a population.
        path: file to write; an existing file is replaced.

    Raises:
        HeadFileError: the head is a population, or has a name that is no valid file name.
        OSError: the file cannot be written.
    """
    write_atomic(path, head_to_toml(head))
