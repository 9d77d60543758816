"""Lock files and folders, so that only one process writes to each; the others raise an error.

The lock of a path is a hidden file beside it, locked by the operating system. It is released with
the process that holds it, even if the process is killed; the file it leaves behind locks nothing.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from filelock import FileLock, Timeout

from vergence.errors import ConfigurationError

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
