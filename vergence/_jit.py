"""Compile kernels with numba, configured here once, with an on-disk cache that is never stale.

Numba stores machine code beside a function's source and recompiles if that file changes. It does
not notice a change in another module whose function or constant was compiled in, so a kernel would
keep running the old code of an edited helper. Here the cache's folder is named by a digest of all
modules that import this one, so that a change of any of them discards the cache. A constant that is
compiled in must therefore be in such a module.

A wheel may carry compiled kernels in a second folder, which is only read; `make wheel` fills it. It
serves the sources, Python and numba that it was made with, on every processor of its kind;
elsewhere kernels are compiled when they are called.

If no folder can be written, kernels still work: each process then compiles them for itself.

Functions are compiled when they are called, none at import. Most of the time goes into type
inference, which treats a function anew for each combination of argument types. Kernels therefore
use loops over scalars (assigning a slice costs seconds for NumPy's rules), and a number passed to a
helper has the same type whether it is a constant or not.
"""

import atexit
import contextlib
import functools
import gc
import hashlib
import inspect
import os
import platform
import re
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numba
from llvmlite.binding import get_host_cpu_features
from numba.core import event, types
from numba.core.caching import Cache, IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, CompileResult, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.registry import CPUDispatcher
from numba.core.runtime.nrt import rtsys
from numba.core.typed_passes import NativeLowering
from numba.np.numpy_support import as_dtype
from numba.np.ufunc.ufuncbuilder import GUFuncBuilder
from numba.np.ufunc.wrappers import _GufuncWrapper

from vergence.errors import ConfigurationError
from vergence.operands import as_operand

try:
    import fcntl
except ImportError:  # Windows: no lock, so the first run there should be a single process
    fcntl = None  # type: ignore[assignment]

__all__ = [
    "GufuncKernel",
    "cache_folder",
    "compiled",
    "compiled_for_threads",
    "inlined",
    "kernel",
    "set_compile_reporter",
    "subroutine",
    "untyped_tuple",
]

_Function = TypeVar("_Function", bound=Callable[..., Any])
_Group = TypeVar("_Group", bound=tuple[Any, ...])

_PACKAGE = Path(__file__).resolve().parent
SHIPPED: Final = _PACKAGE / "kernels"
"""Folder of the compiled kernels that a wheel carries; a clone has none."""


class GufuncKernel:
    """A broadcasting loop over core dimensions, compiled at its first call.

    Args:
        function: the loop.
        signatures: see `kernel`.
        layout: see `kernel`.
    """

    def __init__(
        self, function: Callable[..., None], signatures: Sequence[str], layout: str
    ) -> None:
        functools.update_wrapper(self, function)
        self._function = function
        self._signatures = list(signatures)
        self.layout = layout
        self._ufunc: Callable[..., Any] = self._compile_and_call

    def __call__(self, *operands: Any, **options: Any) -> Any:
        """Call the generalized ufunc with the inputs alone, or with ``out=``.

        Raises:
            ConfigurationError: an operand has another shape or type than the layout requires.
        """
        try:
            return self._ufunc(*operands, **options)
        except (TypeError, ValueError) as error:  # NumPy checks all shapes before the loop
            raise self._refusal(operands, error) from error

    @property
    def input_core_dimensions(self) -> dict[str, tuple[int | str, ...]]:
        """Core dimensions of each input, numbers or names, by the argument's name."""
        cores = re.findall(r"\(([\w,]*)\)", self.layout.partition("->")[0])
        names = list(inspect.signature(self._function).parameters)
        return {
            name: tuple(int(size) if size.isdecimal() else size for size in core.split(",") if size)
            for name, core in zip(names, cores, strict=False)
        }

    def _refusal(self, operands: Sequence[Any], error: Exception) -> ConfigurationError:
        """Error that names the first operand that does not fit; NumPy's error only numbers it."""
        name = self._function.__name__
        leading = []
        for (argument, core), operand in zip(
            self.input_core_dimensions.items(), operands, strict=False
        ):
            try:
                array = as_operand(f"{name}: {argument}", operand, *core)
            except ConfigurationError as refusal:
                return refusal
            if array.ndim > len(core):
                leading.append(f"{argument} {array.shape[: array.ndim - len(core)]}")
        if leading:
            shapes = ", ".join(leading)
            return ConfigurationError(f"{name}: expected shapes that broadcast, got {shapes}")
        return ConfigurationError(f"{name}: {error}")

    def __reduce__(self) -> str:
        return self._function.__qualname__  # pickled by name, as functions are

    def compile(self) -> None:
        """Compile the kernel, or load it from the cache, unless this has been done."""
        with _COMPILE_LOCK:
            if self._ufunc == self._compile_and_call:
                self._ufunc = self._compile()

    def _compile_and_call(self, *operands: Any, **options: Any) -> Any:
        self.compile()
        return self._ufunc(*operands, **options)

    def _compile(self) -> Callable[..., Any]:
        name = f"{self.__module__}.{self._function.__qualname__}"
        # numba does not support fixed dimensions: it gets names instead, and NumPy the numbers
        builder = _GufuncBuilder(self._function, re.sub(r"\b(?=\d)", "size", self.layout))
        with _alone(name), _paused_garbage_collection():
            for signature in self._signatures:
                builder.add(signature)  # type: ignore[no-untyped-call]
            builder.signature = self.layout
            ufunc: Callable[..., Any] = builder.build_ufunc()
        return ufunc


_COMPILE_LOCK: Final = threading.RLock()


def kernel(
    signatures: Sequence[str], layout: str
) -> Callable[[Callable[..., None]], Callable[..., Any]]:
    """Compile a loop over core dimensions into a generalized ufunc that broadcasts.

    The same compiled code serves one head and a batch of them. Floating-point flags behave as in
    NumPy: a division by zero inside the kernel warns at the call, so guard it in the kernel.

    Args:
        signatures: numba signatures, one per dtype, such as ``["void(float64[:], float64[:])"]``.
            They are tried in order, so the narrowest dtypes come first.
        layout: the core dimensions in NumPy's notation, such as ``"(n),(n)->()"``: a number if the
            loop relies on that size, a name if it reads the size from the array. Every dimension
            occurs in an input. Outputs are the last arguments of the function; a scalar output is
            written through ``out[0]``.

    Returns:
        A decorator. The decorated function is called with the inputs alone, or with ``out=``; it
        is compiled at its first call.
    """
    return lambda function: GufuncKernel(function, signatures, layout)


def compiled(function: _Function) -> _Function:
    """Compile a function on its first call with given argument types, and keep it on disk.

    Division follows NumPy (``inf`` and ``nan``, no ZeroDivisionError) and no reassociation of
    floating-point operations is allowed, so results do not depend on the vector width.
    """
    return _kernel(function)


def compiled_for_threads(function: _Function) -> _Function:
    """Compile a function as `compiled` does; other threads run Python while it runs."""
    return _kernel(function, nogil=True)


def _kernel(function: _Function, **more: Any) -> _Function:
    options = {
        "nopython": True,
        "error_model": "numpy",
        "fastmath": False,
        "no_cfunc_wrapper": True,
    }
    return cast("_Function", _Kernel(function, targetoptions=options | more))


def inlined(function: _Function) -> _Function:
    """Inline a small helper into the kernels that call it.

    It is not cached itself, as its code is part of its callers. Called from Python, it runs as the
    plain Python function.
    """
    return _helper(function, forceinline=True)


def subroutine(function: _Function) -> _Function:
    """Compile a helper that kernels call, instead of inlining its code at each call.

    Use it for long helpers that are called rarely: callers stay small, which decides how long they
    take to compile. In all other respects it is like `inlined`.
    """
    return _helper(function)


def _helper(function: _Function, **more: Any) -> _Function:
    config: Any = numba.config
    if config.DISABLE_JIT:
        return function
    options = {
        "nopython": True,
        "error_model": "numpy",
        "fastmath": False,
        "no_cpython_wrapper": True,
        "no_cfunc_wrapper": True,
    }
    return cast("_Function", _Helper(function, targetoptions=options | more))


class _Kernel(CPUDispatcher):
    """A function that Python calls."""

    def __init__(self, function: Callable[..., Any], targetoptions: dict[str, Any]) -> None:
        super().__init__(function, targetoptions=targetoptions)
        self._cache = _KernelCache(function)

    def compile(self, sig: Any) -> Any:
        with _paused_garbage_collection():
            return super().compile(sig)


@contextlib.contextmanager
def _paused_garbage_collection() -> Iterator[None]:
    """Pause Python's search for cyclic garbage, a quarter of the time of compiling.

    A compiler makes millions of objects that live until it ends, and Python goes through all of
    them again and again.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


class _HelperLibrary(JITCodeLibrary):
    """Code of a helper, which runs only as a part of the kernels that it is linked into.

    Numba would optimise it in three rounds and generate machine code that is never called. One
    round is left, which keeps the kernels small; they are optimised as a whole anyway.
    """

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        passes, builder = self._codegen._module_pass_manager()
        passes.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _HelperLowering(NativeLowering):
    """Generation of a helper's code, to be linked and never to be run by itself."""

    _name = "helper_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _HelperLibrary(state.targetctx.codegen(), state.func_id.func_qualname)  # type: ignore[no-untyped-call]
        state.library.enable_object_caching()
        state.flags.no_compile = True
        super().run_pass(state)  # type: ignore[no-untyped-call]
        key = object()  # by which calls find the code; numba's own is the function for Python
        state.targetctx.insert_user_function(key, state.cr.fndesc, [state.library])
        state.reload_init.extend(state.library._reload_init)
        state.cr = state.cr._replace(cfunc=key)
        return True


class _HelperCompiler(CompilerBase):
    """Numba's compiler, but for the last step."""

    def define_pipelines(self) -> list[PassManager]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [
            (_HelperLowering if each is NativeLowering else each, description)
            for each, description in passes.passes
        ]
        passes.finalize()
        return [passes]


class _Helper(CPUDispatcher):
    """A function that only other compiled functions call.

    The wrappers that make a function callable from Python and C take a fifth of the time of
    compiling it, so this function has none.
    """

    def __init__(self, function: Callable[..., Any], targetoptions: dict[str, Any]) -> None:
        super().__init__(function, targetoptions=targetoptions, pipeline_class=_HelperCompiler)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Type constant arguments like variables, so that numba compiles one function for both."""
        plain = {name: types.unliteral(kind) for name, kind in dict(kws).items()}
        return super().get_call_template([types.unliteral(kind) for kind in args], plain)

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        return self.py_func  # a call from Python runs the plain function

    def _insert(self, *args: Any, **kws: Any) -> None:
        """Do nothing: calls from Python must not reach the compiled code, which has no wrapper."""


def untyped_tuple(group: _Group) -> _Group:
    """Convert a named tuple to a plain one, as an argument of a `compiled` function.

    At each call, numba recognises the type of a plain tuple four times as fast. The function
    restores the names at no cost: ``joints = Joints(*joints)``.
    """
    return cast("_Group", tuple(group))


@functools.cache
def cache_folder() -> Path | None:
    """Folder of the machine code of this version of the sources.

    It is in the first of these that can be written: ``NUMBA_CACHE_DIR``, the package's own
    ``__pycache__``, the user's cache folder.

    Returns:
        An existing folder, or None if none can be written: nothing is cached then.
    """
    if not Path(__file__).is_file():  # imported from an archive, whose files numba cannot check
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
    """Name of the folder of shipped kernels for these sources, this Python, numba and machine."""
    made_with = f"{sys.implementation.cache_tag}-numba-{numba.__version__}"
    return f"{_source_digest()}-{made_with}-{sys.platform}-{platform.machine()}"


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
def _discard_mixed_at_exit(folder: Path) -> None:
    """Delete the cache at exit if the sources have changed while this process compiled them."""

    def discard() -> None:
        if _source_digest() != _source_digest.__wrapped__():
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(discard)


@functools.cache
def _source_digest() -> str:
    """Digest of all modules that may be compiled: those whose text names this module."""
    digest = hashlib.sha256()
    for source in sorted(_PACKAGE.rglob("*.py")):
        text = source.read_bytes()
        if b"_jit" in text:
            digest.update(source.relative_to(_PACKAGE).as_posix().encode())
            digest.update(text)
    return digest.hexdigest()[:16]


@contextlib.contextmanager
def _alone(name: str) -> Iterator[None]:
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


class _KernelCache(Cache):
    """Numba's cache of one function, in the folders of this module.

    An error of reading or saving only means compiling again.
    """

    _suffix = ""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._py_func = function
        name = re.sub("[<>]", "", function.__qualname__)
        self._file_name = f"{name}-{function.__code__.co_firstlineno}{self._suffix}"
        self.enable()  # type: ignore[no-untyped-call]

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        rtsys.initialize(target_context)  # all that code needs which is not compiled here
        types, processor, code = self._index_key(sig, target_context.codegen())  # type: ignore[no-untyped-call]
        shipped = processor[0], *PORTABLE_PROCESSORS.get(platform.machine(), ("", ""))
        for folder, kind in ((shipped_folder(), shipped), (cache_folder(), processor)):
            if folder is not None:
                with contextlib.suppress(OSError):
                    data = self._file(folder).load((types, kind, code))
                    if data is not None:
                        return self._rebuilt(target_context, data)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        folder = cache_folder()
        reduced = None if folder is None else self._reduced(data)
        if folder is None or reduced is None:
            return
        _discard_mixed_at_exit(folder)
        try:
            (folder / self._py_func.__module__).mkdir(parents=True, exist_ok=True)
            self._file(folder).save(self._index_key(sig, data.codegen), reduced)  # type: ignore[no-untyped-call]
        except OSError as error:
            _REPORTER.not_kept(error)

    def _file(self, folder: Path) -> IndexDataCacheFile:
        place = str(folder / self._py_func.__module__)
        return IndexDataCacheFile(place, self._file_name, source_stamp="")

    def _reduced(self, data: Any) -> Any:
        """Data for the file; None if the code holds an address of this process."""
        return None if data.library.has_dynamic_globals else data._reduce()

    def _rebuilt(self, target_context: Any, data: Any) -> Any:
        return CompileResult._rebuild(target_context, *data)


class _WrapperCache(_KernelCache):
    """Cache of the code by which NumPy calls a kernel's loop."""

    _suffix = "-wrapper"

    def _reduced(self, data: Any) -> Any:
        return None if data.has_dynamic_globals else data.serialize_using_object_code()

    def _rebuilt(self, target_context: Any, data: Any) -> Any:
        return target_context.codegen().unserialize_library(data)


class _GufuncBuilder(GUFuncBuilder):
    """Numba's builder of generalized ufuncs, with the caches of this module."""

    def __init__(self, function: Callable[..., Any], layout: str) -> None:
        super().__init__(function, layout)  # type: ignore[no-untyped-call]
        self.nb_func.cache = _KernelCache(function)

    def build(self, cres: Any) -> Any:
        wrapper = _GufuncWrapper(self.py_func, cres, self.sin, self.sout, False, False)
        wrapper.cache = _WrapperCache(self.py_func)
        built = wrapper.build()
        numbers = [as_dtype(getattr(kind, "dtype", kind)).num for kind in cres.signature.args]
        return numbers, built.library.get_pointer_to_function(built.name), built.env


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
