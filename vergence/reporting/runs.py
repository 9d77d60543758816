"""Run folders: written atomically, with all that is needed to repeat the run."""

import dataclasses
import importlib.metadata
import json
import os
import platform
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import tomli_w

from vergence.errors import ConfigurationError
from vergence.files import (
    atomic_file,
    atomic_folder,
    hold_lock,
    remove_partial,
    save_folder_at_free_path,
    write_atomic,
)
from vergence.models.head import HeadModel
from vergence.models.head_file import head_to_toml

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_VERSIONED_PACKAGES = (
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


_DISTRIBUTION_NAMES: Final = {"mujoco": "mujoco-core"}
"""Distributions of packages that have another name."""


def package_versions(packages: tuple[str, ...] = _VERSIONED_PACKAGES) -> dict[str, str]:
    """Versions of Python and of packages, without packages that are not installed."""
    found = {"python": platform.python_version()}
    for package in packages:
        try:
            found[package] = importlib.metadata.version(_DISTRIBUTION_NAMES.get(package, package))
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def check_folder_free(folder: Path) -> None:
    """Refuse a run folder that would overwrite a file or a folder that is not empty."""
    if "\0" in str(folder):
        raise _unwritable(folder, ValueError("no name has a NUL in it"))
    try:
        if folder.is_dir():
            names = sorted(path.name for path in folder.iterdir())
            if not names:
                return
            what = describe_run_folder(folder) or f"a folder with {', '.join(names[:3])} in it"
        elif folder.exists() or folder.is_symlink():
            what = "a file"
        else:
            return
    except OSError as error:  # for example, a name that is too long
        raise _unwritable(folder, error) from error
    raise ConfigurationError(f"out: expected a new or empty folder, got {what}: {folder}")


_COMMAND_BY_ENTRY: Final = {
    "experiments": "reproduce",
    "study.db": "tune",
    "tune.json": "tune",
    "checkpoints": "train",
    "tensorboard": "train",
    "evaluation.json": "evaluate",
    "margins.json": "evaluate",
    "calibration.html": "calibrate",
    "locate.png": "locate",
    "gazes.csv": "replay",
    "trajectory.csv": "gaze",
    "trajectory.parquet": "gaze",  # alone up to version 0.1
}
"""Commands by an entry that only their run folders contain."""


def run_folder_command(folder: Path) -> str | None:
    """Command that wrote a run folder; None if there is no such folder or it is no run folder."""
    return next(
        (kind for name, kind in _COMMAND_BY_ENTRY.items() if (folder / name).exists()), None
    )


def describe_run_folder(folder: Path) -> str | None:
    """Description of a run folder for messages; None if it is no run folder."""
    if (folder / _ROBOT_RECORD_FOLDER).is_dir() and not (folder / "evaluation.json").exists():
        return "an evaluation on a robot that has not ended (--resume goes on with it)"
    command = run_folder_command(folder)
    return command and f"the run folder of vergence {command}{_RESUME_HINTS.get(command, '')}"


_ROBOT_RECORD_FOLDER: Final = "recording"
"""Folder that an evaluation on a robot contains from its start."""
_RESUME_HINTS: Final = {
    "train": " (--resume goes on with it)",
    "tune": " (which vergence tune goes on with)",
    "reproduce": " (which vergence reproduce goes on with)",
}


def check_writable(folder: Path) -> None:
    """Refuse, before any work is done, a run folder that could not be created afterwards."""
    check_folder_free(folder)
    there = next(path for path in folder.absolute().parents if path.exists())
    try:
        with tempfile.TemporaryDirectory(prefix=".vergence-", dir=there):
            pass
    except OSError as error:
        raise _unwritable(folder, error) from error


def _unwritable(folder: Path, error: Exception) -> ConfigurationError:
    reason = getattr(error, "strerror", None) or error
    return ConfigurationError(f"out: expected a folder that can be written, got {folder}: {reason}")


@contextmanager
def locked_run_folder(folder: Path) -> Iterator[None]:
    """Lock the name of a new or empty run folder from before the work until it is written."""
    check_writable(folder)
    with hold_lock(folder) as alone:
        check_folder_free(folder)  # another process may have just ended
        if alone:
            place = Path(os.path.realpath(folder))
            remove_partial(place.parent, place.name)
        yield


@contextmanager
def run_folder(folder: Path) -> Iterator[Path]:
    """Create a run folder that appears under its name only when its content is complete."""
    check_folder_free(folder)
    try:
        with atomic_folder(folder) as partial:
            yield partial
    except OSError as error:
        raise _unwritable(folder, error) from error


def save_run_at_free_path(folder: Path, write: Callable[[Path], None]) -> Path:
    """Write a finished run, at a free name beside it if its own was taken while it ran."""
    try:
        return save_folder_at_free_path(folder, write)
    except OSError as error:
        raise ConfigurationError(
            f"out: the result is lost, as {folder} cannot be written: {error.strerror or error}"
        ) from error


def write_config_and_head(
    folder: Path, config: "DataclassInstance", head: HeadModel, packages: tuple[str, ...] = ()
) -> None:
    """Write the resolved configuration, the head, and the versions of these packages too."""
    content = {
        "config": toml_value(dataclasses.asdict(config)),
        "head": {"name": head.name, "digest": head.digest, "file": "head.toml"},
        "versions": package_versions(_VERSIONED_PACKAGES + packages),
    }
    (folder / "config.toml").write_text(tomli_w.dumps(content), encoding="utf-8")
    write_atomic(folder / "head.toml", head_to_toml(head))


def write_json(path: Path, content: Mapping[str, Any] | Sequence[Any]) -> None:
    """Write plain values as JSON; nan and inf raise an error, as JSON does not have them."""
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    path.write_text(text, encoding="utf-8")


def toml_value(value: Any) -> Any:
    """Convert a value for TOML: leave out None, which TOML does not have; write paths as text."""
    if isinstance(value, Mapping):
        return {key: toml_value(item) for key, item in value.items() if item is not None}
    if isinstance(value, list | tuple):
        return [toml_value(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def write_parquet(csv: Path) -> Path:
    """Write a CSV table as Parquet beside it, without loss; pyarrow must be installed."""
    from pyarrow.csv import read_csv
    from pyarrow.parquet import write_table

    path = csv.with_suffix(".parquet")
    table = read_csv(csv)  # exact floats; pandas' own reader is exact only from version 3 on
    with atomic_file(path) as partial:
        write_table(table, partial)
    return path
