"""Files and folders that appear under their names whole, or not at all.

What is being written lies in a hidden folder beside its place, on the same disk, and takes its
name in one step when it is complete. A process that is killed leaves at most such a hidden folder.
"""

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from itertools import count
from pathlib import Path
from typing import Final

PARTIAL: Final = ".vergence-partial-"
"""How the names of hidden folders begin in which something is being written."""

Name = str | os.PathLike[str]


@contextmanager
def whole_files(folder: Name, last: str | None = None) -> Iterator[Path]:
    """Several files of a folder, written beside it and put there when all are complete.

    Args:
        folder: an existing folder; files of the same names are replaced, others stay.
        last: the file that is put there last, as a sign that the others are there.

    Yields:
        A folder to write them to.

    Raises:
        OSError: they cannot be written.
    """
    folder = Path(folder)
    with _hidden(folder) as beside:
        yield beside
        written = sorted(beside.iterdir(), key=lambda path: (path.name == last, path.name))
        for path in written:
            _to_disk(path)
        for path in written:
            os.replace(path, folder / path.name)
    _to_disk(folder)


@contextmanager
def whole_file(path: Name) -> Iterator[Path]:
    """A file, written beside its place and put there when it is complete.

    Args:
        path: the file; one of that name is replaced. Its folder exists.

    Yields:
        The path to write to, of the same name.

    Raises:
        OSError: it cannot be written.
    """
    path = Path(path)
    with whole_files(path.parent) as beside:
        yield beside / path.name


def write_whole(path: Name, content: str | bytes) -> None:
    """Write a file whole or not at all; text as UTF-8.

    Args:
        path: the file; one of that name is replaced. Its folder exists.
        content: what it holds.

    Raises:
        OSError: it cannot be written.
    """
    with whole_file(path) as partial:
        partial.write_bytes(content.encode() if isinstance(content, str) else content)


@contextmanager
def whole_folder(path: Name, *, replace: bool = False) -> Iterator[Path]:
    """A folder, written beside its place and put there when it is complete.

    Args:
        path: the folder. Missing parents are made.
        replace: whether a folder of that name may be replaced that has something in it by then.

    Yields:
        The folder to write to.

    Raises:
        OSError: it cannot be written, or its place has been taken.
    """
    path = Path(path)
    with _new_folder(path) as partial:
        yield partial
        _folder_to_disk(partial)
        if replace and path.exists():
            former = partial.with_name("old")
            os.replace(path, former)
            try:
                os.replace(partial, path)
            except BaseException:
                os.replace(former, path)
                raise
        else:
            _name(partial, path)
    _to_disk(path.parent)


def save_folder(path: Name, write: Callable[[Path], None]) -> Path:
    """Write a folder whole; where its place has been taken meanwhile, under a free name beside it.

    Args:
        path: the folder. Missing parents are made.
        write: called with the folder to write to.

    Returns:
        Where it is: the path, or the first that is free of `path-2`, `path-3` and so on.

    Raises:
        OSError: it cannot be written.
    """
    path = Path(path)
    with _new_folder(path) as partial:
        write(partial)
        _folder_to_disk(partial)
        place = path
        for number in count(2):
            try:
                _name(partial, place)
                break
            except OSError:
                if not os.path.lexists(place):
                    raise
            place = path.with_name(f"{path.name}-{number}")
    _to_disk(path.parent)
    return place


def remove_partial(folder: Name, name: str = "") -> None:
    """Remove what killed processes have left half-written in a folder.

    Args:
        folder: the folder; nobody else may be writing to it.
        name: the one folder in it that nobody else may be writing; empty for all there.
    """
    with suppress(OSError):
        for path in list(Path(folder).iterdir()):
            if path.name.startswith(_prefix(name)):
                shutil.rmtree(path, ignore_errors=True)


def _prefix(name: str) -> str:
    # a long name would be too long with more before it
    return f"{PARTIAL}{hashlib.sha256(name.encode()).hexdigest()[:12]}-" if name else PARTIAL


@contextmanager
def _hidden(folder: Path, name: str = "") -> Iterator[Path]:
    """A hidden folder in another, removed in the end with what is still in it.

    Args:
        folder: the other.
        name: of the one folder that is written in it.
    """
    # tempfile's own folder tries for ever to remove itself where permission has been lost
    hidden = tempfile.mkdtemp(prefix=_prefix(name), dir=folder)
    try:
        yield Path(hidden)
    except OSError as error:
        if error.filename is None:  # such as where the disk is full
            error.filename = os.fspath(folder)
        raise
    finally:
        shutil.rmtree(hidden, ignore_errors=True)


@contextmanager
def _new_folder(path: Path) -> Iterator[Path]:
    """A folder to write to beside the path, whose parent is made if it is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with _hidden(path.parent, path.name) as hidden:
        partial = hidden / "new"
        partial.mkdir()
        yield partial


def _name(partial: Path, path: Path) -> None:
    """Give a complete folder its name, which at most an empty folder may have."""
    if path.exists():
        path.rmdir()  # refuses a folder with something in it, a file and a link
    os.replace(partial, path)


def _folder_to_disk(folder: Path) -> None:
    for written in (*folder.rglob("*"), folder):
        _to_disk(written)


def _to_disk(path: Path) -> None:
    """Wait until a file, or the names in a folder, would outlast a loss of power."""
    # not every system opens folders or can wait for them; what is written is there all the same
    with suppress(OSError) if path.is_dir() else nullcontext():
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
