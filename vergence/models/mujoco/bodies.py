"""Bodies, inertias, servos and couplings of a head in its MuJoCo model."""

import ctypes
import functools
from collections.abc import Mapping, Sequence
from math import expm1
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from vergence.kernels import subroutine
from vergence.models.actuation import SLOTS
from vergence.models.geometry import Body, chain_end, rot_z
from vergence.models.head import HeadModel
from vergence.models.mujoco import mujoco
from vergence.models.parts import EYE_NAMES, EYES, JOINTS, NECK, FloatArray


class LinkInertia(NamedTuple):
    """Mass and inertia of a link in its own frame."""

    mass: float
    """Mass, kg."""
    centre: FloatArray
    """(3,) position of the centre of mass, m."""
    moments: FloatArray
    """(3,) moments of inertia about the centre of mass along the frame's axes, kg m^2; the
    products of inertia are zero."""
    box_edges: FloatArray
    """(3,) edges of the solid box with these moments, m."""


class _Block(NamedTuple):
    """A solid box."""

    mass: float
    """Mass, kg."""
    edges: tuple[float, float, float]
    """Edges along the axes of the link's frame, m."""


_NECK_BASE: Final = _Block(0.30, (0.05, 0.09, 0.05))
"""The neck's first link: two servos and a bracket (chosen: assumed)."""
_NECK_MIDDLE: Final = _Block(0.20, (0.05, 0.05, 0.05))
"""A link between the neck's first and last: a servo (chosen: assumed)."""
_SKULL: Final = _Block(0.30, (0.10, 0.10, 0.05))
"""The neck's last link: the skull with its servos (chosen: assumed)."""
_EYE_FRAME: Final = _Block(0.060, (0.025, 0.025, 0.025))
"""A link that carries an eye: a frame with a servo (chosen: assumed)."""
_EYE: Final = _Block(0.030, (0.03, 0.03, 0.03))
"""The last link of an eye: its camera (chosen: assumed)."""


def link_inertia(head: HeadModel, joint: str) -> LinkInertia:
    """Mass, centre of mass and moments of inertia of the link that a joint turns.

    Args:
        head: one head; its links determine the centres of mass.
        joint: the name of one of its joints.

    Returns:
        The link's inertia in its frame.
    """
    bodies = head.links.bodies()
    place = [body.name for body in bodies].index(joint)
    block = _block(bodies, place)
    edges = np.array(block.edges)
    moments = block.mass / 12.0 * (np.square(edges).sum() - np.square(edges))
    return LinkInertia(block.mass, _centre(bodies, place), moments, edges)


def _block(bodies: tuple[Body, ...], place: int) -> _Block:
    if place == chain_end(bodies, None):
        return _SKULL
    if bodies[place].joints[0] < NECK.stop:
        return _NECK_BASE if bodies[place].parent == -1 else _NECK_MIDDLE
    ends = [chain_end(bodies, eye) for eye in range(len(EYE_NAMES))]
    return _EYE if place in ends else _EYE_FRAME


def _centre(bodies: tuple[Body, ...], place: int) -> FloatArray:
    body, mass = bodies[place], _block(bodies, place).mass
    carried = [i for i, other in enumerate(bodies) if other.parent == place]
    if place == chain_end(bodies, None):
        balance = _balance(bodies, place)
        moment = mass * balance
        for child in carried:
            moment += _mass_from(bodies, child) * (balance - bodies[child].pose[:3, 3])
        return np.asarray(moment / mass)
    if body.joints[0] >= NECK.stop and carried:
        moments = [-_mass_from(bodies, i) / mass * bodies[i].pose[:3, 3] for i in carried]
        return np.asarray(sum(moments[1:], start=moments[0]))
    if body.joints[0] < NECK.stop and body.parent == -1:
        return np.asarray(0.5 * bodies[carried[0]].pose[:3, 3])
    return np.zeros(3)


def _mass_from(bodies: tuple[Body, ...], place: int) -> float:
    """Mass of a link and of all links that it carries, kg."""
    carried = [i for i, other in enumerate(bodies) if other.parent == place]
    own = _block(bodies, place).mass
    return own + sum(_mass_from(bodies, child) for child in carried)


def _balance(bodies: tuple[Body, ...], skull: int) -> FloatArray:
    """Common centre of mass of the skull and the eyes, on the skull's axis, in the skull's frame.

    It is the point of the axis nearest to the axis of the neck's joint before. For a neck of one
    joint, it is at the mean height of the bodies that the skull carries.
    """
    if bodies[skull].parent == -1:
        heights = [body.pose[2, 3] for body in bodies if body.parent == skull]
        return np.array([0.0, 0.0, np.mean(heights) if heights else 0.0])
    pose = bodies[skull].pose
    axis, origin = pose[2, :3], -pose[:3, :3].T @ pose[:3, 3]
    across = axis[:2]
    distance = -(origin[:2] @ across) / (across @ across) if across @ across > 1e-6 else 0.0
    return np.array([0.0, 0.0, origin[2] + distance * axis[2]])


_FROM_OPTICAL: Final = np.diag([1.0, -1.0, -1.0, 1.0])
"""Pose of MuJoCo's camera frame, which looks along -z with y up, in C: a turn by 180 degrees about
x (physical: MuJoCo's convention)."""
_PIXEL_M: Final = 3e-6
"""Edge of a sensor's pixel, m; it scales MuJoCo's focal lengths and cancels in the image (chosen:
typical of small cameras)."""

Bodies = Mapping[int, Any]
"""Bodies of a specification by their index in `Links.bodies`; -1 for the world."""


def add_bodies(
    spec: mujoco.MjSpec, head: HeadModel, welded_angles: Mapping[str, float], armature: FloatArray
) -> Bodies:
    """Add a body with its mass for each joint, and the site `N`.

    The joints are in the order of their first indices in an array of all seven.

    Args:
        spec: the specification to extend; its time step is set.
        head: one head.
        welded_angles: rigid joints by name, with their angles, rad.
        armature: (7,) inertia of the joints' rotors, kg m^2.

    Returns:
        The bodies.
    """
    bodies: dict[int, Any] = {-1: spec.worldbody}
    links = head.links.bodies()
    for place in sorted(range(len(links)), key=lambda i: links[i].joints[0]):
        link = links[place]
        pose = link.pose
        if link.name in welded_angles:
            pose = pose @ rot_z(np.array(welded_angles[link.name]))
        body = bodies[link.parent].add_body(
            name=body_name(link.name), gravcomp=1.0, **pos_and_quat(pose)
        )
        bodies[place] = body
        body.mass, body.ipos, body.inertia, _edges = link_inertia(head, link.name)
        body.explicitinertial = True
        if link.name not in welded_angles:
            _add_joint(body, link.name, link.joints[0], head, armature, spec.option.timestep)
    bodies[chain_end(links, None)].add_site(
        name="N", group=4, size=[0.002] * 3, **pos_and_quat(head.links.frame_n_pose())
    )
    return bodies


def body_name(joint: str) -> str:
    """Name of the body that a joint carries."""
    return f"{joint}_link"


def _add_joint(
    body: Any, name: str, place: int, head: HeadModel, armature: FloatArray, timestep_s: float
) -> None:
    body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0.0, 0.0, 1.0],
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        range=[head.limits.lower[place], head.limits.upper[place]],
        armature=armature[place],
        solref_limit=stiff_solref(timestep_s),
    )


def stiff_solref(timestep_s: float) -> list[float]:
    """`solref` of a limit or an equality constraint, as stiff as the solver allows."""
    return [2.0 * timestep_s, 1.0]  # the least time constant is two time steps


def add_cameras(spec: mujoco.MjSpec, head: HeadModel, bodies: Bodies) -> None:
    """Add the cameras `left` and `right` to the last bodies of both eyes."""
    links = head.links.bodies()
    for eye, (name, size) in enumerate(zip(EYE_NAMES, head.cameras.size, strict=True)):
        bodies[chain_end(links, eye)].add_camera(
            name=name,
            resolution=size,
            sensor_size=_PIXEL_M * size,
            focal_pixel=head.cameras.focal[eye],
            principal_pixel=mujoco_principal(head)[eye],
            **pos_and_quat(head.camera_in_last_link(eye) @ _FROM_OPTICAL),
        )
    buffer = spec.visual.global_
    buffer.offwidth, buffer.offheight = head.cameras.size.max(axis=0).tolist()


def mujoco_principal(head: HeadModel) -> FloatArray:
    """(2, 2) `principalpixel` of both cameras, in pixels.

    MuJoCo counts from the image's centre, with right and down negative. OpenCV's (0, 0) is the
    centre of the upper left pixel, hence `W / 2 - (u_0 + 1/2)`.
    """
    return np.asarray(head.cameras.size / 2.0 - (head.cameras.principal + 0.5))


def pos_and_quat(pose: FloatArray) -> dict[str, FloatArray]:
    """Convert a pose (4, 4) in the parent to MuJoCo's attributes `pos` and `quat`."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, pose[:3, :3].ravel())
    return {"pos": pose[:3, 3], "quat": np.copysign(1.0, quat[0]) * quat}


_FACTOR_DECIMALS: Final = 12
"""Decimals to which factors are rounded (numerical)."""


class Transmission(NamedTuple):
    """An actuator and its joints: its angle is a weighted sum of joint angles, less an offset."""

    name: str
    """Name of the actuator."""
    slot: int
    """Index in an array of the neck's joints and the four actuators of the eyes."""
    joints: tuple[tuple[str, float], ...]
    """Joints with their factors in the sum; a single joint with the factor 1 is the actuator's
    own."""
    lower: float
    """Least value of that sum, rad."""
    upper: float
    """Greatest value of that sum, rad."""
    joint_or_rotor: str
    """Joint that only this actuator turns, over the joint's whole range, or the actuator's rotor,
    see `needs_rotor_bodies`; empty for neither."""


class JointCoupling(NamedTuple):
    """A coupled joint: its angle is an offset plus a weighted sum of other joint angles."""

    joint: str
    follows: tuple[tuple[str, float], ...]
    """Names of the other joints, with their factors."""
    offset: float
    """Offset, rad."""


def joint_index_by_name(head: HeadModel) -> dict[str, int]:
    """Index of each joint by name in an array of all seven, in MuJoCo's order.

    A joint that both eyes share has two indices; the first one is taken.
    """
    places: dict[str, int] = {}
    for place, name in enumerate(head.joints):
        if name:
            places.setdefault(name, place)
    return places


def transmissions_of(head: HeadModel) -> tuple[Transmission, ...]:
    """List the drives of a head: the neck's motors, then the actuators of the eyes.

    An actuator of the eyes with the name of a neck joint gets the prefix `eyes_`.
    """
    own, limits = head.actuation, head.limits
    out = []
    for place, name in enumerate(head.joints[NECK]):
        if name:
            sides = float(limits.lower[place]), float(limits.upper[place])
            out.append(Transmission(name, place, ((name, 1.0),), *sides, name))
    names, matrix, offset = _map(head)
    places = joint_index_by_name(head)
    for k, actuator in enumerate(own.names):
        factors = dict.fromkeys(names, 0.0)
        for joint, factor in zip(head.joints[EYES], own.to_actuators[k], strict=True):
            if joint:
                factors[joint] += float(factor)
        slot = NECK.stop + k
        row = np.round(list(factors.values()), _FACTOR_DECIMALS)
        shift = float(row @ offset)
        lower, upper = own.lower[slot] + shift, own.upper[slot] + shift
        turned = [(name, float(f)) for name, f in zip(names, row, strict=True) if f]
        joint_or_rotor = ""
        if len(turned) == 1 and turned[0][1] == 1.0:
            joint = turned[0][0]
            place, column = places[joint], matrix[names.index(joint)]
            same = (lower, upper) == (limits.lower[place], limits.upper[place])
            joint_or_rotor = joint if same and np.count_nonzero(column) == 1 else ""
        name = f"eyes_{actuator}" if actuator in head.joints[NECK] else actuator
        if needs_rotor_bodies(head):
            joint_or_rotor, lower, upper = rotor_name(name), own.lower[slot], own.upper[slot]
        out.append(
            Transmission(name, slot, tuple(turned), float(lower), float(upper), joint_or_rotor)
        )
    return tuple(out)


def couplings_of(head: HeadModel) -> tuple[JointCoupling, ...]:
    """List the coupled joints of the eyes; empty if every joint can move by itself."""
    names, matrix, offset = _map(head)
    leading: list[int] = []
    for joint in range(len(names)):
        if np.linalg.matrix_rank(matrix[[*leading, joint]]) > len(leading):
            leading.append(joint)
    out = []
    for joint in sorted(set(range(len(names))) - set(leading)):
        solved = np.linalg.lstsq(matrix[leading].T, matrix[joint], rcond=None)[0]
        factors = np.asarray(np.round(solved, _FACTOR_DECIMALS))
        follows = [(names[i], float(f)) for i, f in zip(leading, factors, strict=True) if f]
        rest = float(offset[joint] - factors @ offset[leading])
        out.append(JointCoupling(names[joint], tuple(follows), rest))
    return tuple(out)


def coupled_joint_equations(head: HeadModel) -> list[str]:
    """Equations, as text, of the eyes' joints that more than one actuator moves."""
    own = head.actuation
    names, matrix, offset = _map(head)
    out = []
    for name, row, start in zip(names, matrix, offset, strict=True):
        if np.count_nonzero(row) > 1:
            terms = [f"{f:+g} {a}" for a, f in zip(own.names, row, strict=True) if f]
            ends = [f"{start:+g}"] if start else []
            out.append(f"{name} = {' '.join(terms + ends).removeprefix('+')}")
    return out


def needs_rotor_bodies(head: HeadModel) -> bool:
    """True if a simulator needs the actuators' rotors as bodies of their own.

    This is so if no division of the rotors' inertia among the joints keeps the actuators from
    disturbing one another, as for a pan of both eyes and a vergence of one of them.
    """
    names, _matrix, _offset = _map(head)
    return decoupling_rotor_inertias(head, np.ones(len(names))) is None


def rotor_name(drive: str) -> str:
    """Name of a drive's rotor and of the rotor's joint."""
    return f"{drive}_rotor"


def rotor_couplings(head: HeadModel, drives: Sequence[Transmission]) -> tuple[JointCoupling, ...]:
    """Couplings of the eyes' joints to the rotors, for a head with rotors as bodies."""
    names, matrix, offset = _map(head)
    rotors = [drive.joint_or_rotor for drive in drives if drive.slot >= NECK.stop]
    return tuple(
        JointCoupling(
            name, tuple((r, float(f)) for r, f in zip(rotors, row, strict=True) if f), float(start)
        )
        for name, row, start in zip(names, matrix, offset, strict=True)
    )


def decoupling_rotor_inertias(head: HeadModel, least_inertias: FloatArray) -> FloatArray | None:
    """Solve for rotor inertias by joint that decouple the actuators.

    Rotor inertias r at the joints give the inertia matrix `S^T diag(r) S` at the actuators, with S
    the joint angles per actuator angle. The actuators are decoupled if it is diagonal.

    Args:
        head: the head.
        least_inertias: (J,) least inertia of each distinct joint of the eyes, kg m^2.

    Returns:
        (J,) inertias with the least sum, kg m^2; None if there are none.
    """
    _names, matrix, _offset = _map(head)
    count = matrix.shape[1]
    pairs = [(i, k) for i in range(count) for k in range(i)]
    if not any((matrix[:, i] * matrix[:, k]).any() for i, k in pairs):
        return least_inertias
    from scipy.optimize import linprog

    products = np.array([matrix[:, i] * matrix[:, k] for i, k in pairs])
    found = linprog(
        np.ones(len(least_inertias)),
        A_eq=products,
        b_eq=np.zeros(len(pairs)),
        bounds=[(low, None) for low in least_inertias],
    )
    return np.asarray(found.x) if found.success else None


def _map(head: HeadModel) -> tuple[list[str], FloatArray, FloatArray]:
    """Distinct joints of the eyes: names, angles per actuator angle (J, m), offsets (J,), rad."""
    places = {
        name: at - EYES.start for name, at in joint_index_by_name(head).items() if at >= EYES.start
    }
    rows = list(places.values())
    own = head.actuation
    assert own.to_joints.shape == (SLOTS, SLOTS)
    return list(places), own.to_joints[rows, : own.count], own.offset[rows]


_RIGID_SOLIMP: Final = [0.9999, 0.9999, 0.001, 0.5, 2.0]
"""`solimp` of a coupling: as stiff as MuJoCo's solver allows (numerical)."""

# MuJoCo requires a mass and an inertia of a rotor's body; only its armature matters (numerical).
_ROTOR_MASS: Final = 1e-3  # kg
_ROTOR_INERTIA: Final = 1e-6  # kg m^2


def discrete_lag_rate(lag_s: float, timestep_s: float) -> float:
    """Rate, 1/s, at which explicit steps reproduce the exact lag: `(1 - exp(-h / tau)) / h`."""
    return -expm1(-timestep_s / lag_s) / timestep_s if lag_s > 0.0 else 1.0 / timestep_s


def add_servos(
    spec: mujoco.MjSpec, head: HeadModel, drives: Sequence[Transmission], load_inertias: FloatArray
) -> None:
    """Add an actuator for each drive; its control is the commanded velocity, rad/s.

    Args:
        spec: the specification to extend; its time step is set.
        head: the head; it supplies limits and lags.
        drives: the actuators and their joints.
        load_inertias: (7,) load inertias of the actuators, kg m^2.
    """
    own = head.actuation
    for drive in drives:
        speed = own.velocity[drive.slot]
        torque = load_inertias[drive.slot] * own.acceleration[drive.slot]
        rate = discrete_lag_rate(
            head.timing.lag_s * own.lag_ratio[drive.slot], spec.option.timestep
        )
        if not drive.joint_or_rotor:
            _add_tendon(spec, drive)
        joint, tendon = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_TENDON
        servo = spec.add_actuator(
            name=drive.name,
            target=drive.joint_or_rotor or drive.name,
            trntype=joint if drive.joint_or_rotor else tendon,
            ctrllimited=mujoco.mjtLimited.mjLIMITED_TRUE,
            ctrlrange=[-speed, speed],
        )
        servo.set_to_velocity(kv=load_inertias[drive.slot] * rate)
        if np.isfinite(torque):
            servo.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            servo.forcerange = [-torque, torque]


def _add_tendon(spec: mujoco.MjSpec, drive: Transmission) -> None:
    """Add a tendon whose length is the drive's sum of joint angles, with the drive's limits."""
    tendon = _tendon(spec, drive.name, drive.joints)
    tendon.limited = mujoco.mjtLimited.mjLIMITED_TRUE
    tendon.range = [drive.lower, drive.upper]
    tendon.solref_limit = stiff_solref(spec.option.timestep)


def _tendon(spec: mujoco.MjSpec, name: str, joints: Sequence[tuple[str, float]]) -> Any:
    tendon = spec.add_tendon(name=name, limited=mujoco.mjtLimited.mjLIMITED_FALSE)
    for joint, factor in joints:
        tendon.wrap_joint(joint, factor)
    return tendon


def add_rotors(spec: mujoco.MjSpec, drives: Sequence[Transmission], inertia: FloatArray) -> None:
    """Add a body that can only rotate for each rotor of the eyes' actuators.

    Args:
        spec: the specification to extend; its time step is set.
        drives: the actuators and their joints.
        inertia: (7,) inertia of the rotors, kg m^2.
    """
    for drive in drives:
        if drive.slot >= NECK.stop:
            body = spec.worldbody.add_body(name=drive.joint_or_rotor)
            body.mass, body.ipos, body.inertia = _ROTOR_MASS, np.zeros(3), [_ROTOR_INERTIA] * 3
            body.explicitinertial = True
            body.add_joint(
                name=drive.joint_or_rotor,
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=[0.0, 0.0, 1.0],
                limited=mujoco.mjtLimited.mjLIMITED_TRUE,
                range=[drive.lower, drive.upper],
                armature=inertia[drive.slot],
                solref_limit=stiff_solref(spec.option.timestep),
            )


def add_couplings(spec: mujoco.MjSpec, couplings: Sequence[JointCoupling]) -> None:
    """Add equality constraints for coupled joints.

    Args:
        spec: the specification to extend; its time step is set.
        couplings: the coupled joints.
    """
    objects = {
        mujoco.mjtEq.mjEQ_JOINT: mujoco.mjtObj.mjOBJ_JOINT,
        mujoco.mjtEq.mjEQ_TENDON: mujoco.mjtObj.mjOBJ_TENDON,
    }
    for coupling in couplings:
        name, polynomial = f"{coupling.joint}_tie", np.zeros(mujoco.mjNEQDATA)
        if len(coupling.follows) < 2:
            kind, first = mujoco.mjtEq.mjEQ_JOINT, coupling.joint
            polynomial[:2] = coupling.offset, coupling.follows[0][1] if coupling.follows else 0.0
            second = coupling.follows[0][0] if coupling.follows else ""
        else:
            kind, first, second = mujoco.mjtEq.mjEQ_TENDON, name, ""
            polynomial[0] = coupling.offset
            others = [(joint, -factor) for joint, factor in coupling.follows]
            _tendon(spec, name, [(coupling.joint, 1.0), *others])
        spec.add_equality(
            name=name,
            type=kind,
            objtype=objects[kind],
            name1=first,
            name2=second,
            data=polynomial,
            solref=stiff_solref(spec.option.timestep),
            solimp=_RIGID_SOLIMP,
        )


NECK_ARMATURE: Final = 0.1
"""Reflected rotor inertia of the neck servos, kg m^2 (physical: MuJoCo Menagerie's value for the
joints of the SO-ARM100)."""

EYE_ARMATURE: Final = 0.045
"""Reflected rotor inertia of the eye servos, kg m^2 (physical: MuJoCo Menagerie's value for the
ROBOTIS OP3 and its Dynamixel XM430). Smaller servos have less, but then joints that accelerate as
fast as these would disturb one another by more than the encoders' quantisation."""

_MIN_ROTOR_RATIO: Final = 19.0
"""Least ratio of a rotor's inertia to that of its links: 95 % of the load is rotor (chosen:
constant gains against realistic rotors)."""


class LoadInertias(NamedTuple):
    """Inertias that the servos accelerate with the head at rest, kg m^2; zero if missing."""

    joint_armature: FloatArray
    """(7,) rotor inertia at each joint."""
    joint_loads: FloatArray
    """(7,) total load of each joint: rotors and links."""
    actuator_loads: FloatArray
    """(7,) total load of each joint of the neck and each actuator of the eyes."""
    separate_rotors: FloatArray
    """(7,) inertia of the rotors that are bodies of their own, see `needs_rotor_bodies`."""


def load_inertias(head: HeadModel) -> LoadInertias:
    """Compute the load inertias of the joints and actuators of one head."""
    places = list(joint_index_by_name(head).values())
    links = _links_inertia(head)
    own = np.diag(links)
    least = np.array([NECK_ARMATURE if place < NECK.stop else EYE_ARMATURE for place in places])
    armature = np.maximum(least, _MIN_ROTOR_RATIO * own)
    eyes = np.array(places) >= EYES.start if places else np.zeros(0, dtype=bool)
    if not head.actuation.direct:
        divided = decoupling_rotor_inertias(head, armature[eyes])
        armature[eyes] = 0.0 if divided is None else divided
    turned = _turned(head, places)
    seven = np.zeros((3, len(JOINTS)))
    if needs_rotor_bodies(head):
        used = turned[:, EYES].any(axis=0)
        least = _MIN_ROTOR_RATIO * np.diag(turned.T @ links @ turned)[EYES]
        seven[2, EYES] = np.where(used, np.maximum(EYE_ARMATURE, least), 0.0)
    back = np.linalg.pinv(turned)
    total = links + np.diag(armature)
    felt = total + back.T @ np.diag(seven[2]) @ back if seven[2].any() else total
    for i, name in enumerate(joint_index_by_name(head)):
        at = [place for place, joint in enumerate(head.joints) if joint == name]
        seven[0, at], seven[1, at] = armature[i], felt[i, i]
    actuators = np.diag(turned.T @ total @ turned) + seven[2]
    return LoadInertias(
        joint_armature=seven[0],
        joint_loads=seven[1],
        actuator_loads=actuators,
        separate_rotors=seven[2],
    )


def _turned(head: HeadModel, places: list[int]) -> FloatArray:
    """(J, 7) angle of each joint per angle of the neck's joints and the eyes' actuators."""
    out = np.zeros((len(places), len(JOINTS)))
    for i, place in enumerate(places):
        if place < NECK.stop:
            out[i, place] = 1.0
        else:
            out[i, EYES] = head.actuation.to_joints[place - EYES.start]
    return out


def _links_inertia(head: HeadModel) -> FloatArray:
    """(J, J) mass matrix of the links alone, in the order of `joint_index_by_name`."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    add_bodies(spec, head, {}, np.zeros(len(JOINTS)))
    model = spec.compile()
    inertia = np.zeros((model.nv, model.nv))
    if model.nv:
        data = mujoco.MjData(model)
        data.qpos[:] = head.rest()[list(joint_index_by_name(head).values())]
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, inertia)
    return inertia


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
