"""Write each file or new folder in one rename; let one process at a time write to a place."""

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from itertools import count
from pathlib import Path
from typing import Final

from filelock import FileLock, Timeout

from vergence.errors import ConfigurationError

PARTIAL_PREFIX: Final = ".vergence-partial-"
"""Prefix of the names of these hidden folders."""

PathName = str | os.PathLike[str]


@contextmanager
def atomic_files(folder: PathName, moved_last: str | None = None) -> Iterator[Path]:
    """Write several files of a folder to a temporary one, and move them when all are complete.

    They are moved one by one, so a reader or a kill in between finds new and former files.

    Args:
        folder: an existing folder; files with these names are replaced, others stay.
        moved_last: name of the file that is moved last, as a sign that the others are complete.

    Yields:
        A folder to write the files to.

    Raises:
        OSError: the files cannot be written.
    """
    folder = Path(folder)
    with _hidden(folder) as beside:
        yield beside
        written = sorted(beside.iterdir(), key=lambda path: (path.name == moved_last, path.name))
        for path in written:
            _fsync(path)
        for path in written:
            os.replace(path, folder / path.name)
    _fsync(folder)


@contextmanager
def atomic_file(path: PathName) -> Iterator[Path]:
    """Write a file to a temporary folder, and move it to its path when it is complete.

    Args:
        path: the file; an existing one is replaced. Its folder must exist.

    Yields:
        The path to write to, with the name of the file.

    Raises:
        OSError: the file cannot be written.
    """
    path = Path(path)
    with atomic_files(path.parent) as beside:
        yield beside / path.name


def write_atomic(path: PathName, content: str | bytes) -> None:
    """Write a file atomically; text as UTF-8.

    Args:
        path: the file; an existing one is replaced. Its folder must exist.
        content: content of the file.

    Raises:
        OSError: the file cannot be written.
    """
    with atomic_file(path) as partial:
        partial.write_bytes(content.encode() if isinstance(content, str) else content)


@contextmanager
def atomic_folder(path: PathName, *, replace: bool = False) -> Iterator[Path]:
    """Write a temporary folder, and rename it to its path when it is complete.

    Args:
        path: the folder. Missing parents are created.
        replace: True to replace an existing folder even if it is not empty by then; it is missing
            for an instant.

    Yields:
        The folder to write to.

    Raises:
        OSError: the folder cannot be written, or the path has been taken meanwhile.
    """
    path = Path(path)
    with _new_folder(path) as partial:
        yield partial
        _fsync_folder(partial)
        if replace and path.exists():
            former = partial.with_name("old")
            os.replace(path, former)
            try:
                os.replace(partial, path)
            except BaseException:
                os.replace(former, path)
                raise
        else:
            _rename_to(partial, path)
    _fsync(path.parent)


def save_folder_at_free_path(path: PathName, write: Callable[[Path], None]) -> Path:
    """Write a folder atomically, under a different name if its path has been taken meanwhile.

    Args:
        path: the folder. Missing parents are created.
        write: called with the folder to write to.

    Returns:
        The folder's path: `path`, or the first free one of `path-2`, `path-3` and so on.

    Raises:
        OSError: the folder cannot be written.
    """
    path = Path(path)
    with _new_folder(path) as partial:
        write(partial)
        _fsync_folder(partial)
        place = path
        for number in count(2):
            try:
                _rename_to(partial, place)
                break
            except OSError:
                if not os.path.lexists(place):
                    raise
            place = path.with_name(f"{path.name}-{number}")
    _fsync(path.parent)
    return place


def remove_partial(folder: PathName, name: str = "") -> None:
    """Remove incomplete files that killed processes have left in a folder.

    Args:
        folder: the folder; no other process may be writing to it.
        name: only those of this folder within it, which no other process may be writing; empty for
            all.
    """
    with suppress(OSError):
        for path in list(Path(folder).iterdir()):
            if path.name.startswith(_prefix(name)):
                shutil.rmtree(path, ignore_errors=True)


def _prefix(name: str) -> str:
    # a digest, since a prefix could make a long name too long
    return (
        f"{PARTIAL_PREFIX}{hashlib.sha256(name.encode()).hexdigest()[:12]}-"
        if name
        else PARTIAL_PREFIX
    )


@contextmanager
def _hidden(folder: Path, name: str = "") -> Iterator[Path]:
    """Create a hidden folder within another, and remove it with its content at the end.

    Args:
        folder: the folder to create it in.
        name: name of the folder that is written in it; empty for files.
    """
    # not `tempfile.TemporaryDirectory`, which never stops trying to remove itself if permission
    # has been lost
    hidden = tempfile.mkdtemp(prefix=_prefix(name), dir=folder)
    try:
        yield Path(hidden)
    except OSError as error:
        if error.filename is None:  # for example if the disk is full
            error.filename = os.fspath(folder)
        raise
    finally:
        shutil.rmtree(hidden, ignore_errors=True)


@contextmanager
def _new_folder(path: Path) -> Iterator[Path]:
    """Create a temporary folder beside the path, and the path's parent if it is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with _hidden(path.parent, path.name) as hidden:
        partial = hidden / "new"
        partial.mkdir()
        yield partial


def _rename_to(partial: Path, path: Path) -> None:
    """Rename a complete folder to its path; only an empty folder may exist there."""
    if path.exists():
        path.rmdir()  # raises OSError for a folder that is not empty, a file or a link
    os.replace(partial, path)


def _fsync_folder(folder: Path) -> None:
    for written in (*folder.rglob("*"), folder):
        _fsync(written)


def _fsync(path: Path) -> None:
    """Wait until a file, or the names in a folder, would survive a loss of power."""
    # not every system can open folders or sync them; the files are written anyway
    with suppress(OSError) if path.is_dir() else nullcontext():
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


SUFFIX: Final = ".vergence-lock"
"""Suffix of the names of lock files."""

_ATTEMPTS: Final = 100
"""Most attempts to create a parent folder that other processes remove (numerical)."""

Name = str | os.PathLike[str]


@contextmanager
def hold_lock(path: Name, *, wait: bool = False) -> Iterator[bool]:
    """Hold the lock of a file or folder; it excludes only processes that use this lock as well.

    Missing parents are created, and removed at the end if they are still empty. If the file system
    has no locks, or no file can be created in the parent, there is no lock: the last process to
    write then finds the path taken.

    Args:
        path: the file or folder; it need not exist.
        wait: True to wait for a process that holds the lock.

    Yields:
        True if there is a lock.

    Raises:
        ConfigurationError: another process holds the lock, and `wait` is False.
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
            _let_go(lock, file)
        with suppress(OSError):  # it is not empty
            for parent in made:
                parent.rmdir()


def _taken(file: Path, place: Path, wait: bool) -> FileLock | None:
    """Acquire the lock; None if there cannot be one."""
    # no soft lock, since it would outlive a process that is killed
    lock = FileLock(file, fallback_to_soft=False, on_acquired=_sign)
    for _attempt in range(_ATTEMPTS):
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            lock.acquire(blocking=wait)
            return lock
        except Timeout:
            raise ConfigurationError(
                f"out: expected a place that no other process is writing to, got {place}, "
                f"to which {_owner(file)} is writing (wait for its end, or choose another)"
            ) from None
        except FileNotFoundError:
            continue  # another process has just removed the parent that it had created
        except OSError:
            break
    return None


def _let_go(lock: FileLock, file: Path) -> None:
    # removed while held: a process that has opened it meanwhile notices, and creates a new one
    with suppress(OSError):
        file.unlink()
    with suppress(OSError):
        lock.release()
    if os.name == "nt":  # Windows cannot remove an open file
        with suppress(OSError):
            file.unlink()


def _sign(handle: int) -> None:
    """Write this process's number into the lock file, for the messages of other processes."""
    with suppress(OSError):  # a full disk
        os.ftruncate(handle, 0)
        os.write(handle, str(os.getpid()).encode())


def _owner(file: Path) -> str:
    with suppress(OSError, ValueError):
        return f"process {int(file.read_text())}"
    return "another process"
