"""Compiled kernels on disk: as fresh as Python's byte code, and also where a wheel carries them.

What names the folders, and why numba's own cache does not do, is in `vergence.kernels`. If no
folder can be written, each process compiles for itself. An edit that keeps a file's size and second
of change is missed by Python's byte code, and so here.
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
from typing import Any, Final

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
    """Folder of the machine code, in the first place that can be written; None if none can."""
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
    **dict.fromkeys(("x86_64", "AMD64"), ("x86-64-v3", "")),
    **dict.fromkeys(("aarch64", "arm64"), ("generic", "")),
}
"""LLVM's processor and features that shipped kernels are compiled for, by the kind of machine."""
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
    wanted = _X86_64_V3 if platform.machine() in ("x86_64", "AMD64") else ()
    fits = folder.is_dir() and all(get_host_cpu_features().get(name) for name in wanted)
    return folder if fits else None


def _cache_parents() -> Iterator[Path]:
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        yield Path(chosen)
    yield _PACKAGE / "__pycache__"
    if cache_home := os.environ.get("XDG_CACHE_HOME"):
        yield Path(cache_home) / "vergence"
    with contextlib.suppress(RuntimeError):  # no home folder is known for this user
        yield Path.home() / ".cache" / "vergence"


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


_WRITTEN: Final[dict[str, Path]] = {}  # folders that this process writes, by module


@atexit.register
def _discard_mixed() -> None:
    """Delete the folders of modules whose sources have changed since this process read them."""
    _source.cache_clear()
    for module, folder in _WRITTEN.items():
        if not folder.name.endswith(_digest.__wrapped__(module)):
            shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def compiling_alone(function: Callable[..., Any]) -> Iterator[None]:
    """Wait until no other process is compiling this function into the cache folder."""
    folder = cache_folder()
    with contextlib.ExitStack() as stack:
        if folder is not None and fcntl is not None:
            name = f"{function.__module__}.{function.__qualname__}.lock"
            with contextlib.suppress(OSError):  # compile without the lock
                fcntl.flock(stack.enter_context((folder / name).open("w")), fcntl.LOCK_EX)
        yield


class KernelCache(Cache):
    """Numba's cache of one function; an error of reading or saving only means compiling again."""

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
            if folder is None:
                continue
            try:
                data = self._file(folder).load((types, kind, code))
            except OSError:
                continue
            except Exception:  # whatever unpickling of a damaged file raises
                for path in self._place(folder).glob(f"{self._file_name}.*nb?"):
                    with contextlib.suppress(OSError):
                        path.unlink()
                continue
            if data is not None:
                # LLVM asks for the code by a callback; without an answer, calls would crash
                with interrupts.postponed():
                    return self._rebuilt(target_context, data)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled function, if a folder can be written."""
        folder = cache_folder()
        if folder is None or (reduced := self._reduced(data)) is None:
            return
        place = self._place(folder)
        _WRITTEN[self._module] = place
        try:
            for outdated in {*folder.glob(f"{self._module}-*")} - {place}:
                shutil.rmtree(outdated, ignore_errors=True)
            place.mkdir(parents=True, exist_ok=True)
            self._file(folder).save(self._index_key(sig, data.codegen), reduced)  # type: ignore[no-untyped-call]
        except OSError as error:
            what = "compiled kernels cannot be kept for the next call"
            _REPORTER.say(what, error.strerror or error)

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
        self.report_to(None)
        event.register("numba:run_pass", self)

    def report_to(self, report: Callable[[str], None] | None) -> None:
        """Set what is told, once each, that kernels are compiled and that they cannot be kept."""
        self._report, self._said = report, set[str]()

    def on_start(self, event: Any) -> None:
        when = ", once; another command may need others"
        if cache_folder() is None:
            when = " at every call, as no folder to keep them in can be written; "
            when += "NUMBA_CACHE_DIR names another"
        self.say("compiling kernels", f"some ten seconds to a minute{when}")

    def on_end(self, event: Any) -> None: ...

    def say(self, what: str, text: object) -> None:
        if self._report is not None and what not in self._said:
            self._said.add(what)
            self._report(f"{what}: {text}")


_REPORTER: Final = _Reporter()
set_compile_reporter: Final = _REPORTER.report_to


def report_compiling_if_uncached() -> None:
    """Report that worker processes will compile, who do not say so, if no kernels are cached."""
    folder = cache_folder()
    cached = folder is not None and any(folder.rglob("*.nbi"))
    if not cached and shipped_folder() is None:
        _REPORTER.on_start(None)
