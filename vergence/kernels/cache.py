"""Keep compiled kernels on disk: never stale, and also where a wheel carries them.

Numba stores machine code beside a function's source and recompiles if that file changes. It does
not notice a change in another module whose function or constant was compiled in, so a kernel would
keep running the old code of an edited helper. Here the folder of a module's kernels is named by a
digest of the module and of what it imports, directly or not, as far as that names this folder:
a change costs the kernels that it may touch, and no others. A constant that is compiled in must
therefore be in such a module.

A wheel may carry compiled kernels in a second folder, which is only read; `make wheel` fills it. It
serves the sources, Python and numba that it was made with, on every processor of its kind;
elsewhere kernels are compiled when they are called.

If no folder can be written, kernels still work: each process then compiles them for itself.
"""

import atexit
import contextlib
import functools
import hashlib
import os
import platform
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, cast

import numba
from llvmlite.binding import get_host_cpu_features
from numba.core import event
from numba.core.caching import Cache, IndexDataCacheFile
from numba.core.compiler import CompileResult
from numba.core.runtime.nrt import rtsys

from vergence import interrupts

try:
    import fcntl
except ImportError:  # Windows: no lock, so the first run there should be a single process
    fcntl = None  # type: ignore[assignment]

_PACKAGE: Final = Path(__file__).resolve().parents[1]
SHIPPED: Final = _PACKAGE / "kernels" / "shipped"
"""Folder of the compiled kernels that a wheel carries; a clone has none."""
_MARK: Final = f"{_PACKAGE.name}.kernels".encode()
"""What a source names from which kernels may be compiled."""


@functools.cache
def cache_folder() -> Path | None:
    """Folder of the machine code, with one inside for each version of a module.

    It is in the first of these that can be written: ``NUMBA_CACHE_DIR``, the package's own
    ``__pycache__``, the user's cache folder.

    Returns:
        An existing folder, or None if none can be written: nothing is cached then.
    """
    if not Path(__file__).is_file():  # imported from an archive, whose files numba cannot check
        return None
    place = hashlib.sha256(os.fsencode(_PACKAGE)).hexdigest()[:8]
    for parent in _cache_parents():
        folder = parent / f"kernels-{place}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
        except OSError:
            continue
        return folder
    return None


PORTABLE_PROCESSORS: Final = {
    "x86_64": ("x86-64-v3", ""),
    "AMD64": ("x86-64-v3", ""),
    "aarch64": ("generic", ""),
    "arm64": ("generic", ""),
}
"""Processor that shipped kernels are compiled for, as LLVM names it, with further features; by the
name of the kind of machine."""
_X86_64_V3: Final = ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")
"""Processor features that x86-64-v3 adds to its predecessor."""


def shipped_name() -> str:
    """Name of the folder of shipped kernels for this Python, numba and machine."""
    made_with = f"{sys.implementation.cache_tag}-numba-{numba.__version__}"
    return f"{made_with}-{sys.platform}-{platform.machine()}"


@functools.cache
def shipped_folder() -> Path | None:
    """Folder of compiled kernels that came with the package; None if none fit this machine."""
    folder = SHIPPED / shipped_name()
    if not folder.is_dir():
        return None
    if platform.machine() in ("x86_64", "AMD64"):
        features = cast("dict[str, bool]", get_host_cpu_features())
        if not all(features.get(name) for name in _X86_64_V3):
            return None
    return folder


def _cache_parents() -> Iterator[Path]:
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        yield Path(chosen)
    yield _PACKAGE / "__pycache__"
    cache_home = os.environ.get("XDG_CACHE_HOME")
    if cache_home:
        yield Path(cache_home) / "vergence"
    with contextlib.suppress(RuntimeError):  # no home folder is known for this user
        yield Path.home() / ".cache" / "vergence"


@functools.cache
def _written() -> dict[str, Path]:
    """Folders that this process writes, by module; at exit it deletes those of changed sources."""
    folders: dict[str, Path] = {}

    def discard_mixed() -> None:
        _source.cache_clear()
        for module, folder in folders.items():
            if not folder.name.endswith(_digest.__wrapped__(module)):
                shutil.rmtree(folder, ignore_errors=True)

    atexit.register(discard_mixed)
    return folders


_IMPORT: Final = re.compile(
    rf"^[ \t]*(?:from|import)[ \t]+({_PACKAGE.name}[\w.]*)"
    r"(?:[ \t]+import[ \t]+(\([^)]*\)|.*))?".encode(),
    re.MULTILINE,
)
"""An import from this package: the module, and the names taken from it."""


@functools.cache
def _source(module: str) -> tuple[bytes, bool]:
    """Text of a module, and if names may only pass through it; no text if there is no such file."""
    place = _PACKAGE.parent.joinpath(*module.split("."))
    paths = [place.with_suffix(".py"), place / "__init__.py"]
    if module.partition(".")[0] != _PACKAGE.name:
        paths = [Path(getattr(sys.modules.get(module), "__file__", None) or "")]
    for path in paths:
        with contextlib.suppress(OSError):
            return path.read_bytes(), path.name == "__init__.py"
    return b"", False


def _imported(text: bytes) -> Iterator[str]:
    """Modules of this package that names in a source come from."""
    for origin, names in _IMPORT.findall(text):
        taken = [f"{origin.decode()}.{name.decode()}" for name in re.findall(rb"\w+", names)]
        modules = [name for name in taken if _source(name)[0]]
        yield from modules if modules and modules == taken else [*modules, origin.decode()]


@functools.cache
def _digest(module: str) -> str:
    """Digest of the sources that a module's kernels may be compiled from."""
    compiled_in, seen, waiting = {}, set(), {module}
    while waiting:
        name = waiting.pop()
        seen.add(name)
        text, passes_on = _source(name)
        if name == module or _MARK in name.encode() + text:
            compiled_in[name] = text
        elif not passes_on:
            continue
        waiting.update(set(_imported(text)) - seen)
    digest = hashlib.sha256()
    for name, text in sorted(compiled_in.items()):
        digest.update(name.encode() + text)
    return digest.hexdigest()[:16]


@contextlib.contextmanager
def compiling_alone(name: str) -> Iterator[None]:
    """Wait until no other process is compiling a kernel of this name into the cache folder.

    Numba stores a kernel's loop and its ufunc wrapper in two files, and the wrapper calls the loop
    by a name that differs between processes. If two processes wrote at once, the two files might
    not match, and every later process would call an address that does not exist.
    """
    folder = cache_folder()
    if folder is None or fcntl is None:
        yield
        return
    with contextlib.ExitStack() as stack:
        # numba recreates a folder that another version of the sources has just removed
        with contextlib.suppress(OSError):
            file = stack.enter_context((folder / f"{name}.lock").open("w"))
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


class KernelCache(Cache):
    """Numba's cache of one function, in the folders of this module.

    An error of reading or saving only means compiling again.
    """

    _suffix = ""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._py_func = function
        self._module = function.__module__
        name = re.sub("[<>]", "", function.__qualname__)
        self._file_name = f"{name}-{function.__code__.co_firstlineno}{self._suffix}"
        self.enable()  # type: ignore[no-untyped-call]

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a compiled function; None if no folder has it."""
        rtsys.initialize(target_context)  # all that code needs which is not compiled here
        types, processor, code = self._index_key(sig, target_context.codegen())  # type: ignore[no-untyped-call]
        shipped = processor[0], *PORTABLE_PROCESSORS.get(platform.machine(), ("", ""))
        for folder, kind in ((shipped_folder(), shipped), (cache_folder(), processor)):
            if folder is not None:
                try:
                    data = self._file(folder).load((types, kind, code))
                except OSError:
                    continue
                except Exception:  # whatever unpickling of a damaged file raises
                    self._discard(folder)
                    continue
                if data is not None:
                    # LLVM asks for the code by a callback; without an answer, calls would crash
                    with interrupts.postponed():
                        return self._rebuilt(target_context, data)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled function, if a folder can be written."""
        folder = cache_folder()
        reduced = None if folder is None else self._reduced(data)
        if folder is None or reduced is None:
            return
        place = self._place(folder)
        _written()[self._module] = place
        try:
            for outdated in folder.glob(f"{self._module}-*"):
                if outdated != place:
                    shutil.rmtree(outdated, ignore_errors=True)
            place.mkdir(parents=True, exist_ok=True)
            self._file(folder).save(self._index_key(sig, data.codegen), reduced)  # type: ignore[no-untyped-call]
        except OSError as error:
            _REPORTER.not_kept(error)

    def _discard(self, folder: Path) -> None:
        """Delete a kernel's files."""
        for path in self._place(folder).glob(f"{self._file_name}.*nb?"):
            with contextlib.suppress(OSError):
                path.unlink()

    def _place(self, folder: Path) -> Path:
        return folder / f"{self._module}-{_digest(self._module)}"

    def _file(self, folder: Path) -> IndexDataCacheFile:
        return IndexDataCacheFile(str(self._place(folder)), self._file_name, source_stamp="")

    def _reduced(self, data: Any) -> Any:
        """Data for the file; None if the code holds an address of this process."""
        return None if data.library.has_dynamic_globals else data._reduce()

    def _rebuilt(self, target_context: Any, data: Any) -> Any:
        return CompileResult._rebuild(target_context, *data)


class WrapperCache(KernelCache):
    """Cache of the code by which NumPy calls a kernel's loop."""

    _suffix = "-wrapper"

    def _reduced(self, data: Any) -> Any:
        return None if data.has_dynamic_globals else data.serialize_using_object_code()

    def _rebuilt(self, target_context: Any, data: Any) -> Any:
        return target_context.codegen().unserialize_library(data)


class _Reporter(event.Listener):
    """Reports once that kernels are being compiled, and once that they cannot be cached."""

    def __init__(self) -> None:
        self.start(None)
        event.register("numba:run_pass", self)

    def start(self, tell: Callable[[str], None] | None) -> None:
        self._tell = tell
        self._said: set[str] = set()

    def on_start(self, event: Any) -> None:
        self.compiling()

    def on_end(self, event: Any) -> None:
        pass

    def compiling(self) -> None:
        if cache_folder() is None:
            self._say("compiling", _UNCACHED_MESSAGE)
        else:
            self._say("compiling", _CACHED_MESSAGE)

    def not_kept(self, error: OSError) -> None:
        reason = error.strerror or str(error)
        self._say("kept", f"compiled kernels cannot be kept for the next call: {reason}")

    def _say(self, what: str, text: str) -> None:
        if self._tell is not None and what not in self._said:
            self._said.add(what)
            self._tell(text)


_COMPILE_TIME_TEXT: Final = "some ten seconds to a minute"
"""Compile time on most machines; it depends on the machine and the command (least for a gaze)."""
_CACHED_MESSAGE: Final = (
    f"compiling kernels: {_COMPILE_TIME_TEXT}, once; another command may need others"
)
_UNCACHED_MESSAGE: Final = (
    f"compiling kernels: {_COMPILE_TIME_TEXT} at every call, as no folder to keep them in can be "
    "written; NUMBA_CACHE_DIR names another"
)
_REPORTER: Final = _Reporter()


def set_compile_reporter(report: Callable[[str], None] | None) -> None:
    """Set the callback for messages that kernels are being compiled or cannot be cached.

    Args:
        report: called with a message when the first kernel is about to be compiled, and with one
            if compiled kernels cannot be cached; None for silence.
    """
    _REPORTER.start(report)


def report_compiling_if_uncached() -> None:
    """Report that kernels will be compiled if the cache holds none yet.

    Called before worker processes start, as these do not report it themselves.
    """
    folder = cache_folder()
    cached = folder is not None and any(folder.rglob("*.nbi"))
    if not cached and shipped_folder() is None:
        _REPORTER.compiling()
