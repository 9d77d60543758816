"""Locks: of several processes that would write to one place, one does, and the others say so.

The lock of a place lies beside it, in a hidden file of its name. It is the operating system's, so
it ends with the process that holds it, however that ends; a file that a killed process has left
behind locks nothing.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from filelock import FileLock, Timeout

from vergence.errors import ConfigurationError

SUFFIX: Final = ".vergence-lock"
"""How the names of lock files end."""

_ATTEMPTS: Final = 100
"""How often a parent is made again that others remove."""

Name = str | os.PathLike[str]


@contextmanager
def locked(path: Name, *, wait: bool = False) -> Iterator[bool]:
    """Nobody else writes to a file or a folder meanwhile, as far as they ask as well.

    Missing parents are made, and removed in the end if nothing has come into them. Where a file
    system has no locks, or none can be made in the parent, there is no lock: whoever comes last
    then finds the place taken.

    Args:
        path: the file or folder; it need not exist.
        wait: whether to wait for a process that has the lock.

    Yields:
        Whether there is a lock.

    Raises:
        ConfigurationError: another process has the lock, and it is not waited for.
    """
    # one place has one lock, whatever links lead to it
    place = Path(os.path.realpath(path))
    file = place.with_name(f".{place.name}{SUFFIX}") if place.name else place / SUFFIX
    made = [parent for parent in place.parents if not parent.exists()]
    lock = _taken(file, place, wait)
    try:
        yield lock is not None
    finally:
        if lock is not None:
            _let_go(lock, file)
        with suppress(OSError):  # something has come into it
            for parent in made:
                parent.rmdir()


def _taken(file: Path, place: Path, wait: bool) -> FileLock | None:
    """The lock, or None where there cannot be one."""
    # a lock without the operating system would outlive a process that is killed
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
            continue  # another process has just removed the parent that it had made
        except OSError:
            break
    return None


def _let_go(lock: FileLock, file: Path) -> None:
    # removed while it is held: who has opened it meanwhile finds that out, and makes a new one
    with suppress(OSError):
        file.unlink()
    with suppress(OSError):
        lock.release()
    if os.name == "nt":  # there an open file cannot be removed
        with suppress(OSError):
            file.unlink()


def _sign(handle: int) -> None:
    """Write this process's number into the lock, for others to tell."""
    with suppress(OSError):  # a full disk
        os.ftruncate(handle, 0)
        os.write(handle, str(os.getpid()).encode())


def _owner(file: Path) -> str:
    with suppress(OSError, ValueError):
        return f"process {int(file.read_text())}"
    return "another process"
