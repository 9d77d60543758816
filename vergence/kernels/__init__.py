"""Loops compiled by numba, kept on disk, and called with many arrays at little cost.

`kernel` makes a generalized ufunc; `compiled` and `compiled_for_threads` a function that Python
calls; `inlined` and `subroutine` a helper of these. Everything compiles when it is called.

Each trick below may be taken out alone. Factors are CPU seconds of a first `vergence gaze`, nearly
all of it compiling, without the trick over with it (numba 0.68.1, two idle cores); to measure one,
take it out and run ``python -m benchmarks.start first --base HEAD``. Times are of a call. In
brackets stand the inner names of numba that a trick needs, whose parameters
`tests/test_packaging.py` checks.

- Fixed core dimensions, and errors that name the argument (`_GufuncBuilder`, `GufuncKernel`)
  [GUFuncBuilder, _GufuncWrapper]: numba has neither. Out: return ``numba.guvectorize(signatures,
  layout)`` with a name for each number of a layout; loops must then check these sizes.
- Helpers linked before they are optimised (`_HelperLibrary`, `_HelperLowering`): 1.1
  [CPUDispatcher, NativeLowering, JITCodeLibrary, insert_user_function]. Out: drop
  ``pipeline_class`` of `_Helper`.
- Helpers without wrappers for Python and C: 1.5 with the last one. Out: after that one, drop
  ``no_cpython_wrapper`` and ``no_cfunc_wrapper``.
- Numbers typed alike, constant or not (`_Helper.get_call_template`): 1.1. Out: delete it.
- LLVM's level 1 of optimisation (`_OPTIMISATION`): 1.1; docs/performance.md has no case that a
  higher one made faster [config.OPT]. Out: set 3.
- No search for garbage while compiling (`_quicker_compiler`): 1.1. Out: no ``gc.disable()``.
- An own cache (`vergence.kernels.cache`): numba's looks at a kernel's own file, and runs old code
  after an edit of a helper elsewhere. A folder is named by a digest of the module and of those
  that it imports, directly or not, and that name ``vergence.kernels``: constants and functions
  must come from such modules [Cache, IndexDataCacheFile, CompileResult,
  serialize_using_object_code, rtsys]. Out: numba's FunctionCache in place of `KernelCache`; clear
  it after each edit.
- Kernels in a wheel (`shipped_folder`), for x86-64-v3 or any 64-bit ARM, and the same sources,
  Python and numba: a first gaze takes 4 s in place of 38 (docs/performance.md, ``--wheel``). Out:
  return None.
- One process compiles a name (`compiling_alone`): numba stores a loop and its wrapper in two files,
  and the pair of two writers may not fit, which crashes. Out: one process at a time only.
- Named numbers of one head are views of a row, and named arrays of a batch are a named tuple; see
  `vergence.kernels.records`, which says when to use which.
- Tables of addresses (`make_table`): a call with 75 arrays takes 0.4 us in place of 7 or more
  [populate_array, lower_builtin, type_callable]. Out: pass the tuple itself.
- Tuple readers (`make_tuple_reader`) [load_item]: 1.0, so only shorter sources. Out: write
  ``(row[i], row[i + 1], ...)``.
"""

from vergence.kernels.jit import (
    GufuncKernel,
    compiled,
    compiled_for_threads,
    inlined,
    kernel,
    subroutine,
)
from vergence.kernels.records import (
    Layout,
    make_row,
    make_table,
    make_tuple_reader,
    record_view,
    row_layout,
    row_size,
    unpack_table,
)

__all__ = ["GufuncKernel", "Layout", "compiled", "compiled_for_threads", "inlined", "kernel",
           "make_row", "make_table", "make_tuple_reader", "record_view", "row_layout", "row_size",
           "subroutine", "unpack_table"]  # fmt: skip
