"""Run folders: written whole or not at all, with everything needed to run again."""

import dataclasses
import importlib.metadata
import json
import platform
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomli_w

from vergence.errors import ConfigurationError
from vergence.files import whole_folder
from vergence.models.files.head_file import save_head
from vergence.models.head import HeadModel

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_VERSIONED = (
    "vergence",
    "numpy",
    "scipy",
    "mujoco",
    "gymnasium",
    "opencv-python-headless",
    "numba",
    "matplotlib",
    "pandas",
)


def versions(packages: tuple[str, ...] = _VERSIONED) -> dict[str, str]:
    """The versions of Python and of installed packages; those not installed are left out."""
    found = {"python": platform.python_version()}
    for package in packages:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def check_free(folder: Path) -> None:
    """Refuse a run folder that would overwrite something.

    Raises:
        ConfigurationError: there is a file of that name, or a folder with something in it.
    """
    if folder.is_dir() and not any(folder.iterdir()):
        return
    if folder.exists():
        what = "a folder with files in it" if folder.is_dir() else "a file"
        raise ConfigurationError(f"out: expected a new or empty folder, got {what}: {folder}")


def check_writable(folder: Path) -> None:
    """Refuse, before any work is done, a run folder that could not be made in the end.

    Raises:
        ConfigurationError: there is something of that name, or its place cannot be written.
    """
    check_free(folder)
    there = next(path for path in folder.absolute().parents if path.exists())
    try:
        with tempfile.TemporaryDirectory(prefix=".vergence-", dir=there):
            pass
    except OSError as error:
        raise _unwritable(folder, error) from error


def _unwritable(folder: Path, error: OSError) -> ConfigurationError:
    return ConfigurationError(
        f"out: expected a folder that can be written, got {folder}: {error.strerror or error}"
    )


@contextmanager
def run_folder(folder: Path) -> Iterator[Path]:
    """A folder that appears under its name when its content is complete.

    Args:
        folder: where the run belongs; new or empty.

    Yields:
        The folder to write to.

    Raises:
        ConfigurationError: the folder cannot be made or has something in it.
    """
    check_free(folder)
    try:
        with whole_folder(folder) as partial:
            yield partial
    except OSError as error:
        raise _unwritable(folder, error) from error


def write_config(
    folder: Path, config: "DataclassInstance", head: HeadModel, packages: tuple[str, ...] = ()
) -> None:
    """Write the resolved configuration, the head and the versions.

    Args:
        folder: the run folder.
        config: a dataclass of plain values.
        head: the head that the run used.
        packages: packages whose versions matter beyond those of every run.
    """
    content = {
        "config": plain(dataclasses.asdict(config)),
        "head": {"name": head.name, "digest": head.digest, "file": "head.toml"},
        "versions": versions(_VERSIONED + packages),
    }
    (folder / "config.toml").write_text(tomli_w.dumps(content), encoding="utf-8")
    save_head(head, folder / "head.toml")


def write_json(path: Path, content: Mapping[str, Any] | Sequence[Any]) -> None:
    """Write plain values as JSON, refusing nan and inf, which JSON does not have."""
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    path.write_text(text, encoding="utf-8")


def plain(value: Any) -> Any:
    """A value with what TOML has no word for (None) left out and paths as text."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items() if item is not None}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value
