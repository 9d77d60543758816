"""Write each file or new folder in one rename; let one process at a time write to a place."""

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Final

from vergence.errors import ConfigurationError

PARTIAL_PREFIX: Final = ".vergence-partial-"
"""Prefix of the names of hidden temporary folders."""
SUFFIX: Final = ".vergence-lock"
"""Suffix of the names of lock files."""

if TYPE_CHECKING:
    from filelock import FileLock

PathName = str | os.PathLike[str]


@contextmanager
def atomic_files(folder: PathName, moved_last: str | None = None) -> Iterator[Path]:
    """Write files of an existing folder to a temporary one, and move them when all are complete.

    They are moved one by one, `moved_last` as the sign that the others are complete.
    """
    folder = Path(folder)
    with _hidden(folder) as beside:
        yield beside
        written = sorted(beside.iterdir(), key=lambda path: (path.name == moved_last, path.name))
        _fsync(*written)
        for path in written:
            os.replace(path, folder / path.name)
    _fsync(folder)


@contextmanager
def atomic_file(path: PathName) -> Iterator[Path]:
    """Write a file of an existing folder to a temporary one, and move it when it is complete."""
    path = Path(path)
    with atomic_files(path.parent) as beside:
        yield beside / path.name


def write_atomic(path: PathName, content: str | bytes) -> None:
    """Write a file of an existing folder atomically; text as UTF-8."""
    with atomic_file(path) as partial:
        partial.write_bytes(content.encode() if isinstance(content, str) else content)


@contextmanager
def atomic_folder(path: PathName, *, replace: bool = False) -> Iterator[Path]:
    """Write a temporary folder, and rename it to its path when it is complete.

    A folder with content that is there by then is an `OSError`, or replaced if asked for.
    """
    path = Path(path)
    with _new_folder(path) as partial:
        yield partial
        _fsync(*partial.rglob("*"), partial)
        if not (replace and path.exists()):
            _rename_to(partial, path)
            return
        former = partial.with_name("old")
        os.replace(path, former)
        try:
            os.replace(partial, path)
        except BaseException:
            os.replace(former, path)
            raise


def save_folder_at_free_path(path: PathName, write: Callable[[Path], None]) -> Path:
    """Write a folder atomically to its path or the first free one of `path-2`, `path-3`, ..."""
    path = place = Path(path)
    with _new_folder(path) as partial:
        write(partial)
        _fsync(*partial.rglob("*"), partial)
        for number in count(2):
            try:
                _rename_to(partial, place)
                break
            except OSError:
                if not os.path.lexists(place):
                    raise
            place = path.with_name(f"{path.name}-{number}")
    return place


def remove_partial(folder: PathName, name: str = "") -> None:
    """Remove what killed processes have left in a folder, of all names or of one folder's."""
    with suppress(OSError):
        for path in list(Path(folder).iterdir()):
            if path.name.startswith(_prefix(name)):
                shutil.rmtree(path, ignore_errors=True)


def _prefix(name: str) -> str:
    # a digest, since a prefix could make a long name too long
    return PARTIAL_PREFIX + (f"{hashlib.sha256(name.encode()).hexdigest()[:12]}-" if name else "")


@contextmanager
def _hidden(folder: Path, name: str = "") -> Iterator[Path]:
    """Create a hidden folder within another, for a folder to be named `name` or for files."""
    # not `tempfile.TemporaryDirectory`, which would try for ever if permission has been lost
    hidden = None
    try:
        hidden = tempfile.mkdtemp(prefix=_prefix(name), dir=folder)
        yield Path(hidden)
    except OSError as error:
        # name a place that the user knows; a full disk has none
        if error.filename is None or PARTIAL_PREFIX in str(error.filename):
            error.filename = error.filename2 or os.fspath(folder)
        raise
    finally:
        if hidden is not None:
            shutil.rmtree(hidden, ignore_errors=True)


@contextmanager
def _new_folder(path: Path) -> Iterator[Path]:
    """Create a temporary folder beside the path, and the path's parent if it is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with _hidden(path.parent, path.name) as hidden:
        partial = hidden / "new"
        partial.mkdir()
        yield partial
    _fsync(path.parent)


def _rename_to(partial: Path, path: Path) -> None:
    """Rename a complete folder to its path; only an empty folder may exist there."""
    if path.exists():
        path.rmdir()  # raises OSError for a folder that is not empty, a file or a link
    os.replace(partial, path)


def _fsync(*paths: Path) -> None:
    """Wait until files, or the names in folders, would survive a loss of power."""
    for path in paths:
        # not every system can open folders or sync them; the files are written anyway
        with suppress(OSError) if path.is_dir() else nullcontext():
            handle = os.open(path, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)


@contextmanager
def hold_lock(path: PathName, *, wait: bool = False) -> Iterator[bool]:
    """Hold the lock of a file or folder, and refuse it to others or let them wait.

    Missing parents are created, and removed at the end if they are still empty. If no lock is
    possible there, False is yielded: the last process to write then finds the path taken.
    """
    # the real path, so that a file or folder has one lock regardless of links
    place = Path(os.path.realpath(path))
    file = place.with_name(f".{place.name}{SUFFIX}") if place.name else place / SUFFIX
    made = [parent for parent in place.parents if not parent.exists()]
    lock = _taken(file, place, wait)
    try:
        yield lock is not None
    finally:
        if lock is not None:
            # removed while held: a process that has opened it meanwhile notices, and makes another;
            # on Windows only the release can remove it
            for end in (file.unlink, lock.release):
                with suppress(OSError):
                    end()
        with suppress(OSError):  # it is not empty
            for parent in made:
                parent.rmdir()


def _taken(file: Path, place: Path, wait: bool) -> "FileLock | None":
    """Acquire the lock; None if there cannot be one."""
    from filelock import FileLock, Timeout  # slow to import, which a help text does not need

    # no soft lock, since it would outlive a process that is killed
    lock = FileLock(file, fallback_to_soft=False)
    for _attempt in range(100):  # more than other processes remove the parent (numerical)
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            lock.acquire(blocking=wait)
            with suppress(OSError):  # a full disk
                file.write_text(str(os.getpid()))  # for the messages of other processes
            return lock
        except Timeout:
            owner = "another process"
            with suppress(OSError, ValueError):
                owner = f"process {int(file.read_text())}"
            raise ConfigurationError(
                f"out: expected a place that no other process is writing to, got {place}, "
                f"to which {owner} is writing (wait for its end, or choose another)"
            ) from None
        except FileNotFoundError:
            continue  # another process has just removed the parent that it had created
        except OSError:
            break
    return None
