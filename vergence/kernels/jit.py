"""Compile kernels with numba, configured here once; `vergence.kernels.cache` keeps them.

Functions are compiled when they are called, none at import, and anew for each combination of
argument types. Kernels therefore use loops over scalars (assigning a slice costs seconds for
NumPy's rules), and a number passed to a helper has the same type whether it is a constant or not.
"""

import contextlib
import functools
import gc
import inspect
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, TypeVar, cast

import numba
from llvmlite.binding import parse_assembly
from llvmlite.ir import Constant, GlobalVariable, IntType
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

__all__ = [
    "GufuncKernel",
    "compiled",
    "compiled_for_threads",
    "inlined",
    "kernel",
    "subroutine",
    "untyped_tuple",
]

_Function = TypeVar("_Function", bound=Callable[..., Any])
_Group = TypeVar("_Group", bound=tuple[Any, ...])


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
        with compiling_alone(name), _quicker_compiler():
            for signature in self._signatures:
                builder.add(signature)  # type: ignore[no-untyped-call]
            builder.signature = self.layout
            ufunc: Callable[..., Any] = builder.build_ufunc()
        return ufunc


_COMPILE_LOCK: Final = threading.RLock()
_OPTIMISATION: Final = 1
"""LLVM's level of optimisation, of 0 to 3 (measured: benchmarks.start, benchmarks.throughput)."""


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
        super().__init__(function, targetoptions=targetoptions, pipeline_class=_KernelCompiler)
        self._cache = KernelCache(function)
        self._part: Any = subroutine(function)

    @property
    def _numba_type_(self) -> types.Dispatcher:
        """Type by which other kernels call this function: as a helper, a part of their code."""
        return types.Dispatcher(self._part)

    def compile(self, sig: Any) -> Any:
        name = f"{self.py_func.__module__}.{self.py_func.__qualname__}"
        with compiling_alone(name), _quicker_compiler():
            return super().compile(sig)


@contextlib.contextmanager
def _quicker_compiler() -> Iterator[None]:
    """Have LLVM optimise little, and pause Python's search for cyclic garbage.

    Further optimisation made no measured kernel faster: they are loops over heads with many
    branches, and scalars. The search for garbage takes a quarter of the time of compiling: a
    compiler makes millions of objects that live until it ends, and Python goes through them again
    and again.
    """
    level, enabled = config.OPT, gc.isenabled()  # type: ignore[attr-defined]
    config.OPT = type(level)(min(level, _OPTIMISATION))  # type: ignore[attr-defined]
    gc.disable()
    try:
        yield
    finally:
        config.OPT = level  # type: ignore[attr-defined]
        if enabled:
            gc.enable()


class _KernelLibrary(JITCodeLibrary):
    """Code of a kernel with that of all its helpers, optimised once.

    Numba would do so twice, to find more references that need not be counted. It would also store
    the code from before the generation of machine code, for other kernels to link; these link
    helpers instead.
    """

    def _optimize_final_module(self) -> None:
        passes, builder = self._codegen._module_pass_manager()
        passes.run(self._final_module, builder)

    def serialize_using_object_code(self) -> tuple[str, str, tuple[bytes, bytes]]:
        code: bytes = self._get_compiled_object()  # type: ignore[no-untyped-call]
        # numba reads there which symbols the machine code defines
        names: Any = self._codegen._create_empty_module(self.name)
        module, byte = self._final_module, IntType(8)
        for symbol in (*module.functions, *module.global_variables):
            if not symbol.is_declaration:
                GlobalVariable(names, byte, symbol.name).initializer = Constant(byte, 0)
        return self.name, "object", (code, parse_assembly(str(names)).as_bitcode())


class _HelperLibrary(JITCodeLibrary):
    """Code of a helper, which runs only as a part of the kernels that it is linked into.

    Numba would optimise it, with all that it calls, in two rounds and generate machine code that is
    never called. A helper that is called over five others would so be optimised six times.
    """

    def _optimize_final_module(self) -> None:
        """Leave this to the kernels."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _KernelLowering(NativeLowering):
    """Generation of a kernel's code."""

    _name = "kernel_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _KernelLibrary(state.targetctx.codegen(), state.func_id.func_qualname)  # type: ignore[no-untyped-call]
        state.library.enable_object_caching()
        return super().run_pass(state)  # type: ignore[no-untyped-call, no-any-return]


@register_pass(mutates_CFG=True, analysis_only=False)
class _HelperLowering(NativeLowering):
    """Generation of a helper's code, to be linked and never to be run by itself."""

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


class _Compiler(CompilerBase):
    """Numba's compiler, but for the last step.

    Attributes:
        lowering: pass that generates the code.
    """

    lowering: type[NativeLowering]

    def define_pipelines(self) -> list[PassManager]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [
            (self.lowering if each is NativeLowering else each, description)
            for each, description in passes.passes
        ]
        passes.finalize()
        return [passes]


class _KernelCompiler(_Compiler):
    """Compiler of kernels."""

    lowering = _KernelLowering


class _HelperCompiler(_Compiler):
    """Compiler of helpers."""

    lowering = _HelperLowering


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


class _GufuncBuilder(GUFuncBuilder):
    """Numba's builder of generalized ufuncs, with the caches of this module."""

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
