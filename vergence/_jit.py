"""How kernels are compiled: numba, configured once, with an on-disk cache that goes stale safely.

Numba stores machine code beside the source of a function and notices when that one file changes.
It does not notice a change in another module whose function or constant was compiled in, so an
edited or upgraded helper would leave a kernel running its former code. Here the cache lies in a
folder named by a digest of all modules that import this one, so changed kernels never meet old
code. A constant that is compiled in must therefore live in such a module.

Where no folder can be written, kernels still work: each process then compiles them for itself.
"""

import atexit
import contextlib
import functools
import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

try:
    import fcntl
except ImportError:  # Windows: no lock, so begin there with one process
    fcntl = None  # type: ignore[assignment]

__all__ = ["bare", "cache_folder", "compiled", "device", "kernel"]

_Function = TypeVar("_Function", bound=Callable[..., Any])
_Group = TypeVar("_Group", bound=tuple[Any, ...])

_PACKAGE = Path(__file__).resolve().parent


def kernel(
    signatures: Sequence[str], layout: str
) -> Callable[[Callable[..., None]], Callable[..., Any]]:
    """Compile a loop over core dimensions into a generalized ufunc that broadcasts.

    The same compiled code serves one head and a batch of them. Floating-point flags behave as in
    NumPy: a division by zero inside the kernel warns at the call, so guard it in the kernel.

    Args:
        signatures: numba signatures, one per dtype, tried in this order: those of the narrowest
            dtypes come first, such as ``["void(float64[:], float64[:])"]``.
        layout: the core dimensions in NumPy's notation, such as ``"(n),(n)->()"``. Outputs are the
            last arguments of the function; a scalar output is written through ``out[0]``.

    Returns:
        A decorator. The decorated function is called with the inputs alone, or with ``out=``.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., Any]:
        with _alone(), _caching() as cache:
            make = numba.guvectorize(list(signatures), layout, nopython=True, cache=cache)
            decorated: Callable[..., Any] = make(function)
        return decorated

    return decorate


def compiled(function: _Function) -> _Function:
    """Compile a function on its first call with given argument types, and keep it on disk.

    Division follows NumPy (``inf`` and ``nan``, no ZeroDivisionError) and no reassociation of
    floating-point operations is allowed, so results do not depend on the vector width.
    """
    with _caching() as cache:
        decorate = numba.njit(cache=cache, error_model="numpy", fastmath=False)
        return cast("_Function", decorate(function))


def device(function: _Function) -> _Function:
    """Compile a small helper into the kernels that call it.

    It has no cache of its own, as its code is part of its callers'.
    """
    decorate = numba.njit(error_model="numpy", fastmath=False, forceinline=True)
    return cast("_Function", decorate(function))


def bare(group: _Group) -> _Group:
    """A named tuple without its names, as an argument of a `compiled` function.

    Numba recognises the type of a plain tuple four times as fast at each call. The function names
    the fields again, which costs nothing: ``joints = Joints(*joints)``.
    """
    return cast("_Group", tuple(group))


@functools.cache
def cache_folder() -> Path | None:
    """Where this version of the sources keeps its machine code.

    The first of these that can be written: ``NUMBA_CACHE_DIR``, the package's own ``__pycache__``,
    the user's cache folder.

    Returns:
        An existing folder, or None where none can be written: nothing is cached then.
    """
    if not Path(__file__).is_file():  # imported from an archive, whose sources numba cannot watch
        return None
    place = hashlib.sha256(os.fsencode(_PACKAGE)).hexdigest()[:8]
    name = f"kernels-{place}-{_source_digest()}"
    for parent in _cache_parents():
        folder = parent / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
        except OSError:
            continue
        for outdated in parent.glob(f"kernels-{place}-*"):
            if outdated != folder:
                shutil.rmtree(outdated, ignore_errors=True)
        atexit.register(_discard_mixed, folder, name)
        return folder
    return None


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


def _discard_mixed(folder: Path, name: str) -> None:
    """Throw the cache away if the sources changed while this process compiled from them."""
    if not name.endswith(_source_digest()):
        shutil.rmtree(folder, ignore_errors=True)


def _source_digest() -> str:
    """A digest of the modules that compile anything, which are those that name this one."""
    digest = hashlib.sha256()
    for source in sorted(_PACKAGE.rglob("*.py")):
        text = source.read_bytes()
        if b"_jit" in text:
            digest.update(source.relative_to(_PACKAGE).as_posix().encode())
            digest.update(text)
    return digest.hexdigest()[:16]


@contextlib.contextmanager
def _caching() -> Iterator[bool]:
    """Point numba at the cache folder while a function is decorated; yield whether to cache.

    Numba reads the setting when it decorates, so other packages' functions keep their own place.
    """
    folder = cache_folder()
    if folder is None:
        yield False
        return
    config: Any = numba.config
    former = config.CACHE_DIR
    config.CACHE_DIR = str(folder)
    try:
        yield True
    finally:
        config.CACHE_DIR = former


@contextlib.contextmanager
def _alone() -> Iterator[None]:
    """Wait until no other process is compiling a kernel into the cache folder.

    Numba keeps a kernel's loop and its ufunc wrapper in two files, and the wrapper calls the loop
    by a name that differs from process to process. Written by two processes at once, the two may
    not belong together, and every later process would call an address that does not exist.
    """
    folder = cache_folder()
    if folder is None or fcntl is None:
        yield
        return
    with contextlib.ExitStack() as stack:
        # a folder that another version of the sources has just cleared is made again by numba
        with contextlib.suppress(OSError):
            file = stack.enter_context((folder / "lock").open("w"))
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def kernels_are_cached() -> bool:
    """Whether machine code for this version of the sources is on disk already."""
    folder = cache_folder()
    return folder is not None and any(folder.rglob("*.nbi"))
