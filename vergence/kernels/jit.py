"""Kernels and their helpers, compiled by numba when they are called; see `vergence.kernels`.

Functions are compiled anew for each combination of argument types. Kernels therefore use loops
over scalars (assigning a slice costs seconds for NumPy's rules), and a number passed to a helper
has the same type whether it is a constant or not.
"""

import contextlib
import functools
import gc
import inspect
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, TypeVar, cast

from numba.core import config, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import NativeLowering
from numba.np.numpy_support import as_dtype
from numba.np.ufunc.ufuncbuilder import GUFuncBuilder
from numba.np.ufunc.wrappers import _GufuncWrapper

from vergence import interrupts
from vergence.errors import ConfigurationError
from vergence.kernels.cache import KernelCache, WrapperCache, compiling_alone
from vergence.operands import as_operand

_Function = TypeVar("_Function", bound=Callable[..., Any])
_COMPILE_LOCK: Final = threading.RLock()
_OPTIMISATION: Final = 1
"""LLVM's level of optimisation, of 0 to 3 (measured: benchmarks.start, benchmarks.throughput)."""
_OPTIONS: Final = {"nopython": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_HELPER_OPTIONS: Final = _OPTIONS | {"no_cpython_wrapper": True}


class GufuncKernel:
    """A broadcasting loop over core dimensions, compiled at its first call; see `kernel`."""

    def __init__(
        self, function: Callable[..., None], signatures: Sequence[str], layout: str
    ) -> None:
        functools.update_wrapper(self, function)
        self._function = function
        self._signatures = list(signatures)
        self.layout = layout
        self._ufunc: Callable[..., Any] | None = None

    def __call__(self, *operands: Any, **options: Any) -> Any:
        """Call the generalized ufunc with the inputs alone, or with ``out=``.

        Raises:
            ConfigurationError: an operand has another shape or type than the layout requires.
        """
        try:
            return (self._ufunc or self.compile())(*operands, **options)
        except (TypeError, ValueError) as error:  # NumPy checks all shapes before the loop
            raise self._refusal(operands, error) from error

    @property
    def input_core_dimensions(self) -> dict[str, tuple[int | str, ...]]:
        """Core dimensions of each input, numbers or names, by the argument's name."""
        cores = re.findall(r"\(([\w,]*)\)", self.layout.partition("->")[0])
        return {
            name: tuple(int(size) if size.isdecimal() else size for size in core.split(",") if size)
            for name, core in zip(inspect.signature(self._function).parameters, cores, strict=False)
        }

    def _refusal(self, operands: Sequence[Any], error: Exception) -> ConfigurationError:
        """Error that names the first operand that does not fit; NumPy's error only numbers it."""
        name = self._function.__name__
        leading = []
        inputs = self.input_core_dimensions.items()
        for (argument, core), operand in zip(inputs, operands, strict=False):
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

    def compile(self) -> Callable[..., Any]:
        """Compile the kernel, or load it from the cache, unless this has been done."""
        with _COMPILE_LOCK, compiling_alone(self._function), _quicker_compiler():
            if self._ufunc is None:
                # numba does not support fixed dimensions: it gets names, and NumPy the numbers
                builder = _GufuncBuilder(self._function, re.sub(r"\b(?=\d)", "size", self.layout))
                for signature in self._signatures:
                    builder.add(signature)  # type: ignore[no-untyped-call]
                builder.signature = self.layout
                self._ufunc = builder.build_ufunc()
            return self._ufunc


def kernel(
    signatures: Sequence[str], layout: str
) -> Callable[[Callable[..., None]], Callable[..., Any]]:
    """Compile a loop over core dimensions into a generalized ufunc that broadcasts.

    The decorated function is called with the inputs alone, or with ``out=``, for one head or a
    batch. A division by zero inside it warns at the call, as in NumPy, so guard it in the kernel.

    Args:
        signatures: numba signatures, one per dtype, such as ``["void(float64[:], float64[:])"]``.
            They are tried in order, so the narrowest dtypes come first.
        layout: the core dimensions in NumPy's notation, such as ``"(n),(n)->()"``: a number if the
            loop relies on that size, a name if it reads the size from the array. Every dimension
            occurs in an input. Outputs are the last arguments of the function; a scalar output is
            written through ``out[0]``.
    """
    return lambda function: GufuncKernel(function, signatures, layout)


def compiled(function: _Function) -> _Function:
    """Compile a function that Python calls.

    Division follows NumPy (``inf`` and ``nan``, no ZeroDivisionError) and no reassociation of
    floating-point operations is allowed, so results do not depend on the vector width.
    """
    return cast("_Function", _Kernel(function, _OPTIONS))


def compiled_for_threads(function: _Function) -> _Function:
    """Compile a function as `compiled` does; other threads run Python while it runs."""
    return cast("_Function", _Kernel(function, _OPTIONS | {"nogil": True}))


def inlined(function: _Function) -> _Function:
    """Inline a small helper into the kernels that call it; from Python, it is a plain function."""
    return cast("_Function", _Helper(function, _HELPER_OPTIONS | {"forceinline": True}))


def subroutine(function: _Function) -> _Function:
    """Compile a long helper that kernels call, like `inlined` but once: callers stay small."""
    return cast("_Function", _Helper(function, _HELPER_OPTIONS))


@contextlib.contextmanager
def _quicker_compiler() -> Iterator[None]:
    """Have LLVM optimise little, and pause Python's search for cyclic garbage."""
    level, enabled = config.OPT, gc.isenabled()  # type: ignore[attr-defined]
    config.OPT = type(level)(min(level, _OPTIMISATION))  # type: ignore[attr-defined]
    gc.disable()
    try:
        yield
    finally:
        config.OPT = level  # type: ignore[attr-defined]
        if enabled:
            gc.enable()


class _HelperLibrary(JITCodeLibrary):
    """Code of a helper, neither optimised nor made machine code before kernels link it."""

    def _optimize_final_module(self) -> None: ...

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _HelperLowering(NativeLowering):
    _name = "helper_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _HelperLibrary(state.targetctx.codegen(), state.func_id.func_qualname)  # type: ignore[no-untyped-call]
        state.flags.no_compile = True
        super().run_pass(state)  # type: ignore[no-untyped-call]
        key = object()  # by which calls find the code; numba's own is the function for Python
        state.targetctx.insert_user_function(key, state.cr.fndesc, [state.library])
        state.reload_init.extend(state.library._reload_init)
        state.cr = state.cr._replace(cfunc=key)
        return True


class _HelperCompiler(CompilerBase):
    def define_pipelines(self) -> list[PassManager]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [
            (_HelperLowering if each is NativeLowering else each, description)
            for each, description in passes.passes
        ]
        passes.finalize()
        return [passes]


class _Kernel(CPUDispatcher):
    """A function that Python calls."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        super().__init__(function, targetoptions=options)
        self._cache = KernelCache(function)
        self._part: Any = subroutine(function)

    @property
    def _numba_type_(self) -> types.Dispatcher:
        """Type by which other kernels call this function: as a helper, a part of their code."""
        return types.Dispatcher(self._part)

    def compile(self, sig: Any) -> Any:
        with compiling_alone(self.py_func), _quicker_compiler():
            return super().compile(sig)


class _Helper(CPUDispatcher):
    """A function that only other compiled functions call, without wrappers for Python and C."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        super().__init__(function, targetoptions=options, pipeline_class=_HelperCompiler)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Type constant arguments like variables, so that numba compiles one function for both."""
        plain = {name: types.unliteral(kind) for name, kind in dict(kws).items()}
        return super().get_call_template([types.unliteral(kind) for kind in args], plain)

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        return self.py_func  # a call from Python runs the plain function

    def _insert(self, *args: Any, **kws: Any) -> None:
        """Do nothing: calls from Python must not reach the compiled code, which has no wrapper."""


class _GufuncBuilder(GUFuncBuilder):
    def __init__(self, function: Callable[..., Any], layout: str) -> None:
        super().__init__(function, layout)  # type: ignore[no-untyped-call]
        self.nb_func.cache = KernelCache(function)

    def build(self, cres: Any) -> Any:
        wrapper = _GufuncWrapper(self.py_func, cres, self.sin, self.sout, False, False)
        wrapper.cache = WrapperCache(self.py_func)
        built = wrapper.build()
        numbers = [as_dtype(getattr(kind, "dtype", kind)).num for kind in cres.signature.args]
        with interrupts.postponed():  # as in `KernelCache.load_overload`
            return numbers, built.library.get_pointer_to_function(built.name), built.env
