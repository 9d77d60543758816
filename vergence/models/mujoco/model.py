"""The head as a MuJoCo model: a body per link, a servo per actuator, two cameras.

The world is frame 0. The z axis of a body's frame is the axis of its joint (the article's D-H
frames), the site `N` is frame N, and the cameras `left` and `right` look along z of `C_l` and
`C_r`.
"""

import ctypes
import functools
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.kernels import subroutine
from vergence.models.head import HeadModel
from vergence.models.mujoco import mujoco
from vergence.models.mujoco.bodies import add_mechanism, drives_of, joint_index_by_name
from vergence.models.mujoco.look import add_appearance, add_scenery
from vergence.models.parts import NECK
from vergence.models.posture import rest_poses

SUBSTEPS: Final = 4
"""Simulation steps per control period: 1/480 s at 120 Hz (chosen: accuracy against speed)."""


def build_spec(
    head: HeadModel,
    *,
    neck: Literal["servo", "welded"] = "servo",
    visuals: bool = True,
    scenery: bool = True,
    gravity: bool = False,
    timestep_s: float | None = None,
) -> mujoco.MjSpec:
    """Build one head in its surroundings as an editable MuJoCo specification.

    Joints have the head's names, in the order of their first indices in `HeadModel.joints`.
    Actuators are the joints of the neck, then the actuators of the eyes, see `drives_of`; `ctrl` is
    an actuator's commanded velocity in rad/s, clipped to its limits. Cameras are pinholes.

    A `welded` neck is rigid at zero. Visuals are shapes and a stand, and with scenery a floor and
    lights: they slow a simulation down. So does gravity, which stands for contacts, springs and
    constraints too, for models with additional bodies: it is compensated in the head, whose motion
    is the same. The time step, s, is a quarter of the control period by default.
    """
    if head.batch_shape:
        raise ConfigurationError(
            f"MuJoCo model: expected one head, got a population of shape {head.batch_shape}"
        )
    if neck not in ("servo", "welded"):
        raise ConfigurationError(f"neck: expected 'servo' or 'welded', got {neck!r}")
    if any(head.joints) and not head.timing.lag_s > 0.0:
        raise ConfigurationError(
            f"MuJoCo model: expected a head with timing.lag_s > 0, got {head.timing.lag_s}; "
            "a velocity that follows at once is what the kinematic plant simulates"
        )
    timestep_s = head.timing.period_s / SUBSTEPS if timestep_s is None else timestep_s
    if not (np.isfinite(timestep_s) and timestep_s > 0.0):
        raise ConfigurationError(f"timestep_s: expected seconds above 0, got {timestep_s!r}")
    spec, posture = mujoco.MjSpec(), rest_poses(head)
    spec.modelname = head.name
    spec.compiler.degree = spec.compiler.autolimits = False
    spec.option.timestep = timestep_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.gravity = 0.0 - 9.81 * posture.upright_frame[:3, 2]
    bodies = add_mechanism(spec, head, neck == "welded")
    if not gravity:
        bit = mujoco.mjtDisableBit
        unused = bit.mjDSBL_CONTACT | bit.mjDSBL_SPRING | bit.mjDSBL_DAMPER | bit.mjDSBL_GRAVITY
        spec.option.disableflags = int(unused if spec.equalities else unused | bit.mjDSBL_EQUALITY)
    if visuals:
        add_appearance(spec, bodies, head, posture)
        if scenery:
            add_scenery(spec, posture)
    return spec


def compile_model(head: HeadModel, **options: Any) -> mujoco.MjModel:
    """Compile the model of a head; see `build_spec` for the arguments and errors."""
    model = build_spec(head, **options).compile()
    find_model_indices(model, head)
    return model


class ModelIndices(NamedTuple):
    """Indices of a head's joints and actuators in the arrays of its MuJoCo model."""

    qpos_of_joint: NDArray[np.intp]
    """(7,) index of each joint in `qpos` and `qvel`; -1 for a joint that does not move. A joint
    that both eyes share has its index twice."""
    joint_of_qpos: NDArray[np.intp]
    """(J,) first index, in an array of all seven joints, of each joint in `qpos`, so that
    `qpos[: len(joint_of_qpos)] = q[joint_of_qpos]`; the rest of `qpos` are rotors."""
    slot_of_rotor: NDArray[np.intp]  # index of each rotor in the same array as for `slot_of_ctrl`
    slot_of_ctrl: NDArray[np.intp]
    """(nu,) index of each number in `ctrl` in an array of the neck's joints and the four actuators
    of the eyes."""


def find_model_indices(model: mujoco.MjModel, head: HeadModel) -> ModelIndices:
    """Find a head's joints and actuators in a model with a moving or a welded neck.

    Raises:
        ConfigurationError: the names or the order of the model's joints or actuators differ from
            the head's.
    """
    joints = tuple(model.joint(i).name for i in range(model.njnt))
    actuators = tuple(model.actuator(i).name for i in range(model.nu))
    places, drives = joint_index_by_name(head), drives_of(head)
    rotors = {drive.target: drive.slot for drive in drives if drive.is_rotor}
    for first in (0, NECK.stop):
        moving = {name: place for name, place in places.items() if place >= first}
        driven = {drive.name: drive.slot for drive in drives if drive.slot >= first}
        expected = (*moving, *rotors)
        if joints == expected and actuators == tuple(driven) and model.nq == len(expected):
            index = {name: i for i, name in enumerate(moving)}
            of_joint = [index.get(name, -1) for name in head.joints]
            found = (of_joint, moving.values(), rotors.values(), driven.values())
            return ModelIndices(*(np.array([*numbers], dtype=np.intp) for numbers in found))
    raise ConfigurationError(
        f"MuJoCo model: expected the joints {tuple(places)} and the actuators "
        f"{tuple(drive.name for drive in drives)} in this order, with or without the neck's, got "
        f"joints {joints} and actuators {actuators}"
    )


@functools.cache
def simulation_functions() -> tuple[int, int, int, int]:
    """Addresses of `mj_setState`, `mj_step` and `mj_getState`, and the components of a state.

    All are zero if the functions cannot be found. The components are not a constant of compiled
    code, as its caches do not know MuJoCo's version.
    """
    folder, names = (
        Path(mujoco.__file__).parent,
        ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll"),
    )
    for library in (path for name in names for path in sorted(folder.glob(name))):
        with suppress(OSError, AttributeError):
            found = ctypes.CDLL(str(library))
            functions = (found.mj_setState, found.mj_step, found.mj_getState)
            load, step, save = (ctypes.cast(f, ctypes.c_void_p).value or 0 for f in functions)
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

    The arguments are the result of `simulation_functions` and addresses: of an `mjModel`, of an
    `mjData` of it, whose contents are lost, and of the row of its state, updated in place.
    """
    components = np.int32(functions[3])
    _call(functions[0], (model, data, state, components))
    for _ in range(nstep):
        _call(functions[1], (model, data))
    _call(functions[2], (model, data, state, components))
