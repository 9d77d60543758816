"""MuJoCo's C functions, called by their addresses from compiled code.

A call of `mj_step` from Python costs a tenth of the step of a head, and one from a compiled loop
nothing. Functions are called by address, as numba would not cache code with a `ctypes` function.
"""

import ctypes
import functools
from pathlib import Path
from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from vergence._jit import subroutine
from vergence.models.mujoco.library import mujoco

_LIBRARIES: Final = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")
"""Names of MuJoCo's library in the folder of its Python package."""


@functools.cache
def simulation_functions() -> tuple[int, int, int, int]:
    """Addresses of `mj_setState`, `mj_step` and `mj_getState`, and the components of a state.

    All are zero if the functions cannot be found. The components are not a constant of compiled
    code, as its caches do not know MuJoCo's version.
    """
    folder = Path(mujoco.__file__).parent
    for library in (path for name in _LIBRARIES for path in sorted(folder.glob(name))):
        try:
            found = ctypes.CDLL(str(library))
            load, step, save = (
                ctypes.cast(function, ctypes.c_void_p).value or 0
                for function in (found.mj_setState, found.mj_step, found.mj_getState)
            )
        except (OSError, AttributeError):
            continue
        return load, step, save, int(mujoco.mjtState.mjSTATE_INTEGRATION)  # as mujoco.batch
    return 0, 0, 0, 0


@intrinsic
def _call_c(typingctx: Any, address: Any, operands: Any) -> Any:
    """Call a C function of addresses and integers that returns nothing."""

    def call(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        made = [context.get_value_type(kind) for kind in operands]
        function = builder.inttoptr(arguments[0], ir.FunctionType(ir.VoidType(), made).as_pointer())
        builder.call(function, cgutils.unpack_tuple(builder, arguments[1]))
        return context.get_dummy_value()

    return types.none(address, operands), call


_call: Any = _call_c


@subroutine
def simulate(
    functions: tuple[int, int, int, int], model: int, data: int, state: int, nstep: int
) -> None:
    """Advance a simulation by a number of steps, as `mujoco.batch.Batch.step` does.

    Args:
        functions: result of `simulation_functions`.
        model: address of its `mjModel`.
        data: address of an `mjData` of this model, whose contents are lost.
        state: address of the row of its state, updated in place.
        nstep: number of steps.
    """
    components = np.int32(functions[3])
    _call(functions[0], (model, data, state, components))
    for _ in range(nstep):
        _call(functions[1], (model, data))
    _call(functions[2], (model, data, state, components))
