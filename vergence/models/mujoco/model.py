"""The head as a MuJoCo model: a body per link, a servo per actuator, two cameras.

The world is frame 0. The z axis of a body's frame is the axis of its joint (the article's D-H
frames), the site `N` is frame N, and the cameras `left` and `right` look along z of `C_l` and
`C_r`.
"""

import ctypes
import functools
from collections.abc import Mapping, Sequence
from contextlib import suppress
from math import expm1
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.kernels import subroutine
from vergence.models.geometry import Body, chain_end
from vergence.models.head import HeadModel
from vergence.models.mujoco import mujoco
from vergence.models.mujoco.look import add_appearance, add_camera, add_scenery, pos_and_quat
from vergence.models.parts import EYE_NAMES, EYES, JOINTS, NECK, FloatArray
from vergence.models.posture import rest_poses

SUBSTEPS: Final = 4
"""Simulation steps per control period: 1/480 s at 120 Hz (chosen: accuracy against speed)."""
_BLOCKS: Final = {
    "neck_base": (0.30, (0.05, 0.09, 0.05)),  # two servos and a bracket
    "neck_middle": (0.20, (0.05, 0.05, 0.05)),  # a servo
    "skull": (0.30, (0.10, 0.10, 0.05)),  # the neck's last link, with its servos
    "eye_frame": (0.060, (0.025, 0.025, 0.025)),  # carries an eye, with a servo
    "eye": (0.030, (0.03, 0.03, 0.03)),  # the last link of an eye: its camera
}
"""Masses, kg, of the links, and the edges of solid boxes along their frames' axes, m (chosen:
assumed)."""
_NECK_ARMATURE: Final = 0.1
"""Reflected rotor inertia of the neck servos, kg m^2 (physical: MuJoCo Menagerie's value for the
joints of the SO-ARM100)."""
_EYE_ARMATURE: Final = 0.045
"""Reflected rotor inertia of the eye servos, kg m^2 (physical: MuJoCo Menagerie's value for the
ROBOTIS OP3 and its Dynamixel XM430). Smaller servos have less, but then joints that accelerate as
fast as these would disturb one another by more than the encoders' quantisation."""
_MIN_ROTOR_RATIO: Final = 19.0
"""Least ratio of a rotor's inertia to that of its links: 95 % of the load is rotor (chosen:
constant gains against realistic rotors)."""
_FACTOR_DECIMALS: Final = 12
"""Decimals to which factors between joints are rounded (numerical)."""
_RIGID_SOLIMP: Final = [0.9999, 0.9999, 0.001, 0.5, 2.0]
"""`solimp` of a coupling: as stiff as MuJoCo's solver allows (numerical)."""


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
    Actuators are the joints of the neck, then the actuators of the eyes, see `actuator_slots`; a
    `ctrl` is a commanded velocity in rad/s, clipped to its limits. Cameras are pinholes.

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
    bodies = _add_mechanism(spec, head, neck == "welded")
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
    places, slots, rotors = joint_index_by_name(head), actuator_slots(head), _rotor_slots(head)
    for first in (0, NECK.stop):
        moving = {name: place for name, place in places.items() if place >= first}
        driven = {name: slot for name, slot in slots.items() if slot >= first}
        expected = (*moving, *rotors)
        if joints == expected and actuators == tuple(driven) and model.nq == len(expected):
            index = {name: i for i, name in enumerate(moving)}
            of_joint = [index.get(name, -1) for name in head.joints]
            found = (of_joint, moving.values(), rotors.values(), driven.values())
            return ModelIndices(*(np.array([*numbers], dtype=np.intp) for numbers in found))
    raise ConfigurationError(
        f"MuJoCo model: expected the joints {tuple(places)} and the actuators "
        f"{tuple(slots)} in this order, with or without the neck's, got "
        f"joints {joints} and actuators {actuators}"
    )


class LinkInertia(NamedTuple):
    """Mass, kg, centre of mass, m, and moments of inertia about it, kg m^2, in a link's frame."""

    mass: float
    centre: FloatArray
    moments: FloatArray
    edges: FloatArray  # (3,) edges of the solid box with these moments, m


def link_inertias(head: HeadModel) -> list[LinkInertia]:
    """Inertias of the links of one head, in the order of `Links.bodies`."""
    links = head.links.bodies()
    skull, *ends = (chain_end(links, eye) for eye in (None, 0, 1))
    out, whole = [], np.zeros(len(links))  # whole: masses with all that a link carries, kg
    for place in reversed(range(len(links))):
        link = links[place]
        loads = [(whole[i], one.pose[:3, 3]) for i, one in enumerate(links) if one.parent == place]
        kind, centre = "eye" if place in ends else "eye_frame", np.zeros(3)
        if link.joints[0] < NECK.stop:
            kind = "neck_base" if link.parent == -1 else "neck_middle"
        kind = "skull" if place == skull else kind
        mass, edges = _BLOCKS[kind]
        whole[place] = mass + sum(load for load, _ in loads)
        if kind == "skull":
            balance = _balance(links, skull)
            moment = mass * balance
            for load, at in loads:
                moment += load * (balance - at)
            centre = moment / mass
        elif kind in ("eye", "eye_frame"):
            centre = sum((-load / mass * at for load, at in loads), start=centre)
        elif kind == "neck_base":
            centre = 0.5 * loads[0][1]
        squares = np.square(edges)
        moments = mass / 12.0 * (squares.sum() - squares)
        out.append(LinkInertia(mass, centre, moments, np.array(edges)))
    return out[::-1]


def _balance(links: Sequence[Body], skull: int) -> FloatArray:
    """Common centre of mass of the skull and the eyes, on the skull's axis, in the skull's frame.

    It is the point of the axis nearest to the axis of the neck's joint before. For a neck of one
    joint, it is at the mean height of the bodies that the skull carries.
    """
    if links[skull].parent == -1:
        heights = [link.pose[2, 3] for link in links if link.parent == skull]
        return np.array([0.0, 0.0, np.mean(heights) if heights else 0.0])
    pose = links[skull].pose
    axis, origin = pose[2, :3], -pose[:3, :3].T @ pose[:3, 3]
    across = axis[:2]
    distance = -(origin[:2] @ across) / (across @ across) if across @ across > 1e-6 else 0.0
    return np.array([0.0, 0.0, origin[2] + distance * axis[2]])


class LoadInertias(NamedTuple):
    """Inertias that the servos accelerate with the head at rest, kg m^2."""

    joint_armature: FloatArray  # (J,) of the rotors at each joint, in MuJoCo's order
    joint_loads: FloatArray  # (J,) of the rotors and links at each joint
    actuator_loads: FloatArray
    """(7,) of the rotors and links at each joint of the neck and each actuator of the eyes; zero
    for a missing one."""
    separate_rotors: FloatArray
    """(7,) of the rotors that are bodies of their own, see `_decoupling_inertias`."""


def load_inertias(head: HeadModel) -> LoadInertias:
    """Compute the load inertias of the joints and actuators of one head."""
    places = joint_index_by_name(head)
    neck = np.array([place < NECK.stop for place in places.values()], dtype=bool)
    links = _links_inertia(head)
    least = np.where(neck, _NECK_ARMATURE, _EYE_ARMATURE)
    armature = np.maximum(least, _MIN_ROTOR_RATIO * np.diag(links))
    divided = _decoupling_inertias(head, armature[~neck])
    armature[~neck] = 0.0 if divided is None else divided
    # angle of each joint per angle of the neck's joints and the eyes' actuators
    turned, rotors = np.eye(len(JOINTS)), np.zeros(len(JOINTS))
    turned[EYES, EYES] = head.actuation.to_joints
    turned = turned[list(places.values())]
    if divided is None:
        least = _MIN_ROTOR_RATIO * np.diag(turned.T @ links @ turned)[EYES]
        used = turned[:, EYES].any(axis=0)
        rotors[EYES] = np.where(used, np.maximum(_EYE_ARMATURE, least), 0.0)
    back = np.linalg.pinv(turned)
    total = links + np.diag(armature)
    felt = total + back.T @ np.diag(rotors) @ back
    actuator_loads = np.diag(turned.T @ total @ turned) + rotors
    return LoadInertias(armature, np.diag(felt), actuator_loads, rotors)


def _links_inertia(head: HeadModel) -> FloatArray:
    """(J, J) mass matrix of the links alone, in MuJoCo's order of the joints."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    _add_bodies(spec, head, np.zeros(len(JOINTS)))
    model = spec.compile()
    inertia = np.zeros((model.nv, model.nv))
    if model.nv:
        data = mujoco.MjData(model)
        data.qpos[:] = head.rest()[list(joint_index_by_name(head).values())]
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, inertia)
    return inertia


def joint_index_by_name(head: HeadModel) -> dict[str, int]:
    """First index of each joint by name in an array of all seven, in MuJoCo's order."""
    return {name: head.joints.index(name) for name in head.joints if name}


def eye_joints(head: HeadModel) -> tuple[list[str], FloatArray, FloatArray]:
    """Distinct joints of the eyes: names, angles per actuator angle (J, m), offsets (J,), rad."""
    own, places = head.actuation, joint_index_by_name(head)
    names = [name for name, at in places.items() if at >= EYES.start]
    rows = [places[name] - EYES.start for name in names]
    return names, own.to_joints[rows, : own.count], own.offset[rows]


def _decoupling_inertias(head: HeadModel, least: FloatArray) -> FloatArray | None:
    """Least rotor inertias (J,) of the eyes' joints, above `least`, that decouple the actuators.

    Rotor inertias r at the joints give the inertia matrix `S^T diag(r) S` at the actuators, with S
    the joint angles per actuator angle. The actuators are decoupled if it is diagonal. None if
    there are no such inertias, as for a pan of both eyes and a vergence of one of them: the rotors
    are then bodies of their own.
    """
    _, matrix, _ = eye_joints(head)
    pairs = [(i, k) for i in range(matrix.shape[1]) for k in range(i)]
    products = np.array([matrix[:, i] * matrix[:, k] for i, k in pairs])
    if not products.any():
        return least
    from scipy.optimize import linprog

    bounds = [(low, None) for low in least]
    found = linprog(np.ones(len(least)), A_eq=products, b_eq=np.zeros(len(pairs)), bounds=bounds)
    return np.asarray(found.x) if found.success else None


def actuator_slots(head: HeadModel) -> dict[str, int]:
    """Index of each actuator in an array of the neck's joints and the eyes' four, by its name.

    An actuator of the eyes with the name of a neck joint gets the prefix `eyes_`.
    """
    neck = head.joints[NECK]
    eyes = (f"eyes_{name}" if name in neck else name for name in head.actuation.names)
    return {name: slot for slot, name in enumerate((*neck, *eyes)) if name}


def _rotor_slots(head: HeadModel) -> dict[str, int]:
    """The same of each rotor that is a body of its own, see `_decoupling_inertias`."""
    if _decoupling_inertias(head, np.ones(len(eye_joints(head)[0]))) is not None:
        return {}
    slots = actuator_slots(head).items()
    return {f"{name}_rotor": slot for name, slot in slots if slot >= EYES.start}


Factors = Sequence[tuple[str, float]]
"""Names of joints with their factors in a weighted sum of their angles."""


def _factors(names: Sequence[str], row: FloatArray) -> Factors:
    return tuple((name, float(f)) for name, f in zip(names, row, strict=True) if f)


def couplings_of(head: HeadModel) -> list[tuple[str, Factors, float]]:
    """List the coupled joints of the eyes: the joint, the others that it follows, its offset, rad.

    Its angle is a weighted sum of the others' plus the offset.
    """
    names, matrix, offset = eye_joints(head)
    out, leading = [], list[int]()
    for joint, name in enumerate(names):
        if np.linalg.matrix_rank(matrix[[*leading, joint]]) > len(leading):
            leading.append(joint)
            continue
        solved = np.asarray(np.linalg.lstsq(matrix[leading].T, matrix[joint], rcond=None)[0])
        factors = solved.astype(np.float64).round(_FACTOR_DECIMALS)
        rest = float(offset[joint] - factors @ offset[leading])
        out.append((name, _factors([names[i] for i in leading], factors), rest))
    return out


def _add_mechanism(spec: mujoco.MjSpec, head: HeadModel, welded: bool) -> Mapping[int, Any]:
    """Add all of a head but its looks, with a welded neck or not, and return `_add_bodies`."""
    own, cameras, links = head.actuation, head.cameras, head.links.bodies()
    loads, rotors = load_inertias(head), _rotor_slots(head)
    bodies = _add_bodies(spec, head, loads.joint_armature, head.joints[NECK] if welded else ())
    for eye, name in enumerate(EYE_NAMES):
        optics = cameras.size[eye], cameras.focal[eye], cameras.principal[eye]
        body, pose = bodies[chain_end(links, eye)], head.camera_in_last_link(eye)
        add_camera(body, name, pose, optics)
    buffer = spec.visual.global_
    buffer.offwidth, buffer.offheight = cameras.size.max(axis=0).tolist()
    names, matrix, offset = eye_joints(head)
    # a joint of both eyes counts twice
    shares = [[float(joint == name) for name in names] for joint in head.joints[EYES]]
    sums = (own.to_actuators @ np.array(shares)).round(_FACTOR_DECIMALS)
    for name, slot in actuator_slots(head).items():
        if welded and slot < NECK.stop:
            continue
        kind, target = mujoco.mjtTrn.mjTRN_JOINT, name
        ends = float(own.lower[slot]), float(own.upper[slot])
        if f"{name}_rotor" in rotors:
            target = f"{name}_rotor"
            # MuJoCo requires a mass and moments of a body; only the armature matters
            body = spec.worldbody.add_body(name=target, explicitinertial=True)
            body.mass, body.ipos, body.inertia = 1e-3, np.zeros(3), [1e-6] * 3
            _add_joint(spec, body, target, ends, loads.separate_rotors[slot])
        elif slot >= EYES.start:
            row = sums[slot - EYES.start]
            shift = float(row @ offset)
            ends = ends[0] + shift, ends[1] + shift
            joint = int(row.argmax())
            place = head.joints.index(names[joint])
            own_ends = float(head.limits.lower[place]), float(head.limits.upper[place])
            alone = np.count_nonzero(row) == np.count_nonzero(matrix[joint]) == 1
            if alone and row[joint] == 1.0 and ends == own_ends:
                target = names[joint]
            else:
                kind = mujoco.mjtTrn.mjTRN_TENDON
                tendon = _add_tendon(spec, name, _factors(names, row))
                tendon.limited, tendon.range = True, ends
                tendon.solref_limit = _stiff_solref(spec)
        speed, load, lag_s = own.velocity[slot], loads.actuator_loads[slot], head.timing.lag_s
        fastest = {"ctrllimited": True, "ctrlrange": [-speed, speed]}
        servo = spec.add_actuator(name=name, target=target, trntype=kind, **fastest)
        rate = discrete_lag_rate(lag_s * own.lag_ratio[slot], spec.option.timestep)
        servo.set_to_velocity(kv=load * rate)
        if np.isfinite(torque := load * own.acceleration[slot]):
            servo.forcelimited, servo.forcerange = True, [-torque, torque]
    couplings = couplings_of(head)
    if rotors:
        rows = zip(names, matrix, offset.tolist(), strict=True)
        couplings = [(name, _factors([*rotors], row), start) for name, row, start in rows]
    for coupling in couplings:
        _add_coupling(spec, *coupling)
    return bodies


def _add_bodies(
    spec: mujoco.MjSpec, head: HeadModel, armature: FloatArray, welded: Sequence[str] = ()
) -> Mapping[int, Any]:
    """Add a body for each joint, in MuJoCo's order.

    Returns:
        The bodies by their index in `Links.bodies`, with -1 for the world.
    """
    bodies: dict[int, Any] = {-1: spec.worldbody}
    links, inertias, limits = head.links.bodies(), link_inertias(head), head.limits
    order = sorted(range(len(links)), key=lambda i: links[i].joints[0])
    for place, inertia in zip(order, armature[: len(order)], strict=True):
        link = links[place]
        body = bodies[link.parent].add_body(name=f"{link.name}_link", **pos_and_quat(link.pose))
        body.explicitinertial, body.gravcomp = True, 1.0
        body.mass, body.ipos, body.inertia, _ = inertias[place]
        bodies[place] = body
        if link.name not in welded:
            ends = limits.lower[link.joints[0]], limits.upper[link.joints[0]]
            _add_joint(spec, body, link.name, ends, inertia)
    site = bodies[chain_end(links, None)].add_site(name="N", group=4, size=[0.002] * 3)
    site.pos, site.quat = pos_and_quat(head.links.frame).values()
    return bodies


def _add_joint(
    spec: mujoco.MjSpec, body: Any, name: str, ends: Sequence[float], armature: float
) -> None:
    """Add a hinge about z with its limits, rad."""
    solref = _stiff_solref(spec)
    body.add_joint(name=name, limited=True, range=ends, armature=armature, solref_limit=solref)


def _add_tendon(spec: mujoco.MjSpec, name: str, joints: Factors) -> Any:
    """Add a tendon whose length is a weighted sum of joint angles."""
    tendon = spec.add_tendon(name=name, limited=False)
    for joint, factor in joints:
        tendon.wrap_joint(joint, factor)
    return tendon


def _add_coupling(spec: mujoco.MjSpec, joint: str, follows: Factors, offset: float) -> None:
    """Add an equality constraint for a coupled joint."""
    name, polynomial = f"{joint}_tie", np.zeros(mujoco.mjNEQDATA)
    kind, of, tied = mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtObj.mjOBJ_JOINT, (joint, "")
    polynomial[0] = offset
    if len(follows) > 1:
        kind, of, tied = mujoco.mjtEq.mjEQ_TENDON, mujoco.mjtObj.mjOBJ_TENDON, (name, "")
        _add_tendon(spec, name, [(joint, 1.0), *((other, -f) for other, f in follows)])
    elif follows:
        tied, polynomial[1] = (joint, follows[0][0]), follows[0][1]
    stiff = {"solref": _stiff_solref(spec), "solimp": _RIGID_SOLIMP}
    names = {"name": name, "name1": tied[0], "name2": tied[1]}
    spec.add_equality(type=kind, objtype=of, data=polynomial, **names, **stiff)


def _stiff_solref(spec: mujoco.MjSpec) -> list[float]:
    """`solref` of a limit or an equality constraint, as stiff as the solver allows."""
    return [2.0 * spec.option.timestep, 1.0]  # the least time constant is two time steps


def discrete_lag_rate(lag_s: float, timestep_s: float) -> float:
    """Rate, 1/s, at which explicit steps reproduce the exact lag: `(1 - exp(-h / tau)) / h`."""
    return -expm1(-timestep_s / lag_s) / timestep_s if lag_s > 0.0 else 1.0 / timestep_s


@functools.cache
def simulation_functions() -> tuple[int, int, int, int]:
    """Addresses of `mj_setState`, `mj_step` and `mj_getState`, and the components of a state.

    All are zero if the functions cannot be found. The components are not a constant of compiled
    code, as its caches do not know MuJoCo's version.
    """
    folder = Path(mujoco.__file__).parent
    names = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")
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
