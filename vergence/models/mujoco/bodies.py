"""Bodies, inertias, servos and couplings of a head in its MuJoCo model."""

from collections.abc import Mapping, Sequence
from math import expm1
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vergence.models.geometry import Body, chain_end
from vergence.models.head import HeadModel
from vergence.models.mujoco import mujoco
from vergence.models.parts import EYE_NAMES, EYES, JOINTS, NECK, FloatArray

_BLOCKS: Final = {
    "neck_base": (0.30, (0.05, 0.09, 0.05)),  # two servos and a bracket
    "neck_middle": (0.20, (0.05, 0.05, 0.05)),  # a servo
    "skull": (0.30, (0.10, 0.10, 0.05)),  # the neck's last link, with its servos
    "eye_frame": (0.060, (0.025, 0.025, 0.025)),  # carries an eye, with a servo
    "eye": (0.030, (0.03, 0.03, 0.03)),  # the last link of an eye: its camera
}
"""Masses, kg, of the links, and the edges of solid boxes along their frames' axes, m (chosen:
assumed)."""


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
    carried = [[i for i, link in enumerate(links) if link.parent == k] for k in range(len(links))]
    blocks = []
    for place, link in enumerate(links):
        kind = "eye" if place in ends else "eye_frame"
        if link.joints[0] < NECK.stop:
            kind = "neck_base" if link.parent == -1 else "neck_middle"
        blocks.append(_BLOCKS["skull" if place == skull else kind])
    out, whole = [], [mass for mass, _ in blocks]  # whole: with all that it carries
    for place in reversed(range(len(links))):
        whole[place] += sum(whole[i] for i in carried[place])
    for place, (mass, edges) in enumerate(blocks):
        loads = [(whole[i], links[i].pose[:3, 3]) for i in carried[place]]
        centre = np.zeros(3)
        if place == skull:
            balance = _balance(links, skull)
            moment = mass * balance
            for load, at in loads:
                moment += load * (balance - at)
            centre = moment / mass
        elif links[place].joints[0] >= NECK.stop:
            centre = sum((-load / mass * at for load, at in loads), start=centre)
        elif links[place].parent == -1:
            centre = 0.5 * loads[0][1]
        squares = np.square(edges)
        moments = mass / 12.0 * (squares.sum() - squares)
        out.append(LinkInertia(mass, centre, moments, np.array(edges)))
    return out


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


_FACTOR_DECIMALS: Final = 12  # decimals to which factors are rounded (numerical)

Factors = Sequence[tuple[str, float]]
"""Names of joints with their factors in a weighted sum of their angles."""


class Drive(NamedTuple):
    """An actuator and its joints: its angle is a weighted sum of joint angles, less an offset."""

    name: str
    slot: int  # index in an array of the neck's joints and the four actuators of the eyes
    joints: Factors
    """Joints with their factors; a single one with the factor 1 is the actuator's own."""
    ends: tuple[float, float]  # least and greatest value of that sum, rad
    target: str
    """Joint that only this actuator turns, over the joint's whole range, or the actuator's rotor;
    empty for neither."""
    is_rotor: bool  # true if the rotor is a body of its own, see `_decoupling_inertias`


class Coupling(NamedTuple):
    """A coupled joint: its angle is an offset plus a weighted sum of other joint angles."""

    joint: str
    follows: Factors
    offset: float  # offset, rad


def joint_index_by_name(head: HeadModel) -> dict[str, int]:
    """First index of each joint by name in an array of all seven, in MuJoCo's order."""
    return {name: head.joints.index(name) for name in head.joints if name}


def drives_of(head: HeadModel) -> tuple[Drive, ...]:
    """List the drives of a head: the neck's motors, then the actuators of the eyes.

    An actuator of the eyes with the name of a neck joint gets the prefix `eyes_`.
    """
    own, limits = head.actuation, head.limits
    ranges = [*zip(limits.lower.tolist(), limits.upper.tolist(), strict=True)]
    out = [
        Drive(name, place, ((name, 1.0),), ranges[place], name, False)
        for place, name in enumerate(head.joints[NECK])
        if name
    ]
    names, matrix, offset = _eye_joints(head)
    rotors = _decoupling_inertias(head, np.ones(len(names))) is None
    for k, actuator in enumerate(own.names):
        row, slot = np.zeros(len(names)), NECK.stop + k
        for joint, factor in zip(head.joints[EYES], own.to_actuators[k], strict=True):
            if joint:
                row[names.index(joint)] += factor
        row = row.round(_FACTOR_DECIMALS)
        joints, shift = _factors(names, row), 0.0 if rotors else float(row @ offset)
        ends = float(own.lower[slot] + shift), float(own.upper[slot] + shift)
        name = f"eyes_{actuator}" if actuator in head.joints[NECK] else actuator
        target = f"{name}_rotor" if rotors else ""
        if not rotors and len(joints) == 1 and joints[0][1] == 1.0:
            joint = joints[0][0]
            alone = np.count_nonzero(matrix[names.index(joint)]) == 1
            target = joint if alone and ends == ranges[head.joints.index(joint)] else ""
        out.append(Drive(name, slot, joints, ends, target, rotors))
    return tuple(out)


def _factors(names: Sequence[str], row: FloatArray) -> Factors:
    return tuple((name, float(f)) for name, f in zip(names, row, strict=True) if f)


def couplings_of(head: HeadModel, rotors: Sequence[str] = ()) -> tuple[Coupling, ...]:
    """List the coupled joints of the eyes; all of them, coupled to the rotors, if there are any."""
    names, matrix, offset = _eye_joints(head)
    if rotors:
        rows = zip(names, matrix, offset.tolist(), strict=True)
        return tuple(Coupling(name, _factors(rotors, row), start) for name, row, start in rows)
    leading: list[int] = []
    for joint in range(len(names)):
        if np.linalg.matrix_rank(matrix[[*leading, joint]]) > len(leading):
            leading.append(joint)
    out = []
    for joint in sorted(set(range(len(names))) - set(leading)):
        solved = np.asarray(np.linalg.lstsq(matrix[leading].T, matrix[joint], rcond=None)[0])
        factors = solved.astype(np.float64).round(_FACTOR_DECIMALS)
        follows = _factors([names[i] for i in leading], factors)
        rest = float(offset[joint] - factors @ offset[leading])
        out.append(Coupling(names[joint], follows, rest))
    return tuple(out)


def coupled_joint_equations(head: HeadModel) -> list[str]:
    """Equations, as text, of the eyes' joints that more than one actuator moves."""
    out = []
    for name, row, start in zip(*_eye_joints(head), strict=True):
        if np.count_nonzero(row) > 1:
            terms = [f"{f:+g} {a}" for a, f in zip(head.actuation.names, row, strict=True) if f]
            ends = [f"{start:+g}"] if start else []
            out.append(f"{name} = {' '.join(terms + ends).removeprefix('+')}")
    return out


def _decoupling_inertias(head: HeadModel, least: FloatArray) -> FloatArray | None:
    """Least rotor inertias (J,) of the eyes' joints, above `least`, that decouple the actuators.

    Rotor inertias r at the joints give the inertia matrix `S^T diag(r) S` at the actuators, with S
    the joint angles per actuator angle. The actuators are decoupled if it is diagonal. None if
    there are no such inertias, as for a pan of both eyes and a vergence of one of them: the rotors
    are then bodies of their own.
    """
    _, matrix, _ = _eye_joints(head)
    pairs = [(i, k) for i in range(matrix.shape[1]) for k in range(i)]
    products = np.array([matrix[:, i] * matrix[:, k] for i, k in pairs])
    if not products.any():
        return least
    from scipy.optimize import linprog

    bounds = [(low, None) for low in least]
    found = linprog(np.ones(len(least)), A_eq=products, b_eq=np.zeros(len(pairs)), bounds=bounds)
    return np.asarray(found.x) if found.success else None


def _eye_joints(head: HeadModel) -> tuple[list[str], FloatArray, FloatArray]:
    """Distinct joints of the eyes: names, angles per actuator angle (J, m), offsets (J,), rad."""
    own, places = head.actuation, joint_index_by_name(head)
    names = [name for name, at in places.items() if at >= EYES.start]
    rows = [places[name] - EYES.start for name in names]
    return names, own.to_joints[rows, : own.count], own.offset[rows]


Bodies = Mapping[int, Any]
"""Bodies of a specification by their index in `Links.bodies`; -1 for the world."""


def add_mechanism(spec: mujoco.MjSpec, head: HeadModel, welded: bool) -> Bodies:
    """Add all of a head but its looks, with a welded neck or not; the time step is set.

    The site `N` is frame N; `left` and `right` are the cameras. An actuator's control is its
    commanded velocity, rad/s.
    """
    own, cameras, links = head.actuation, head.cameras, head.links.bodies()
    drives, loads = drives_of(head), load_inertias(head)
    bodies = _add_bodies(spec, head, loads.joint_armature, head.joints[NECK] if welded else ())
    for eye, name in enumerate(EYE_NAMES):
        optics = cameras.size[eye], cameras.focal[eye], cameras.principal[eye]
        body, pose = bodies[chain_end(links, eye)], head.camera_in_last_link(eye)
        add_camera(body, name, pose, optics)
    buffer = spec.visual.global_
    buffer.offwidth, buffer.offheight = cameras.size.max(axis=0).tolist()
    for name, slot, joints, ends, target, is_rotor in drives:
        if welded and slot < NECK.stop:
            continue
        kind = mujoco.mjtTrn.mjTRN_JOINT
        if is_rotor:  # MuJoCo requires a mass and moments of a body; only the armature matters
            body = spec.worldbody.add_body(name=target, explicitinertial=True)
            body.mass, body.ipos, body.inertia = 1e-3, np.zeros(3), [1e-6] * 3
            _add_joint(spec, body, target, ends, loads.separate_rotors[slot])
        elif not target:
            kind, tendon = mujoco.mjtTrn.mjTRN_TENDON, _add_tendon(spec, name, joints)
            tendon.limited, tendon.range = True, ends
            tendon.solref_limit = _stiff_solref(spec)
        speed, load, lag_s = own.velocity[slot], loads.actuator_loads[slot], head.timing.lag_s
        fastest = {"ctrllimited": True, "ctrlrange": [-speed, speed]}
        servo = spec.add_actuator(name=name, target=target or name, trntype=kind, **fastest)
        rate = discrete_lag_rate(lag_s * own.lag_ratio[slot], spec.option.timestep)
        servo.set_to_velocity(kv=load * rate)
        if np.isfinite(torque := load * own.acceleration[slot]):
            servo.forcelimited, servo.forcerange = True, [-torque, torque]
    for coupling in couplings_of(head, [drive.target for drive in drives if drive.is_rotor]):
        _add_coupling(spec, coupling)
    return bodies


def _add_bodies(
    spec: mujoco.MjSpec, head: HeadModel, armature: FloatArray, welded: Sequence[str] = ()
) -> Bodies:
    """Add a body for each joint, in the order of their first indices in an array of all seven."""
    bodies: dict[int, Any] = {-1: spec.worldbody}
    links, inertias = head.links.bodies(), link_inertias(head)
    for place in sorted(range(len(links)), key=lambda i: links[i].joints[0]):
        link, joint = links[place], links[place].joints[0]
        body = bodies[link.parent].add_body(name=f"{link.name}_link", **pos_and_quat(link.pose))
        body.explicitinertial, body.gravcomp = True, 1.0
        body.mass, body.ipos, body.inertia, _ = inertias[place]
        bodies[place] = body
        if link.name not in welded:
            ends = head.limits.lower[joint], head.limits.upper[joint]
            _add_joint(spec, body, link.name, ends, armature[joint])
    site = bodies[chain_end(links, None)].add_site(name="N", group=4, size=[0.002] * 3)
    site.pos, site.quat = pos_and_quat(head.links.frame_n_pose()).values()
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


def _add_coupling(spec: mujoco.MjSpec, coupling: Coupling) -> None:
    """Add an equality constraint for a coupled joint."""
    joint, follows, offset = coupling
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


_RIGID_SOLIMP: Final = [0.9999, 0.9999, 0.001, 0.5, 2.0]
"""`solimp` of a coupling: as stiff as MuJoCo's solver allows (numerical)."""


def _stiff_solref(spec: mujoco.MjSpec) -> list[float]:
    """`solref` of a limit or an equality constraint, as stiff as the solver allows."""
    return [2.0 * spec.option.timestep, 1.0]  # the least time constant is two time steps


def discrete_lag_rate(lag_s: float, timestep_s: float) -> float:
    """Rate, 1/s, at which explicit steps reproduce the exact lag: `(1 - exp(-h / tau)) / h`."""
    return -expm1(-timestep_s / lag_s) / timestep_s if lag_s > 0.0 else 1.0 / timestep_s


_FROM_OPTICAL: Final = np.diag([1.0, -1.0, -1.0, 1.0])
"""Pose of MuJoCo's camera frame, which looks along -z with y up, in C: a turn by 180 degrees about
x (physical: MuJoCo's convention)."""


def add_camera(
    body: Any, name: str, pose: FloatArray, optics: Sequence[ArrayLike], pixel_m: float = 3e-6
) -> None:
    """Add a camera by its optical frame; optics are its size, focal length and principal point, px.

    The edge of a pixel, m, cancels in the image.
    MuJoCo counts the principal point from the image's centre, with right and down negative.
    OpenCV's (0, 0) is the centre of the upper left pixel, hence `W / 2 - (u_0 + 1/2)`.
    """
    size, focal, principal = map(np.asarray, optics)
    seen = {"focal_pixel": focal, "principal_pixel": size / 2.0 - (principal + 0.5)}
    seen |= {"resolution": size, "sensor_size": pixel_m * size}
    body.add_camera(name=name, **seen, **pos_and_quat(pose @ _FROM_OPTICAL))


def pos_and_quat(pose: FloatArray) -> dict[str, FloatArray]:
    """Convert a pose (4, 4) in the parent to MuJoCo's attributes `pos` and `quat`."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, pose[:3, :3].ravel())
    return {"pos": pose[:3, 3], "quat": np.copysign(1.0, quat[0]) * quat}


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


class LoadInertias(NamedTuple):
    """Inertias that the servos accelerate with the head at rest, (7,) kg m^2; zero if missing."""

    joint_armature: FloatArray  # of the rotors at each joint
    joint_loads: FloatArray  # of the rotors and links at each joint
    actuator_loads: FloatArray
    """Of the rotors and links at each joint of the neck and each actuator of the eyes."""
    separate_rotors: FloatArray
    """Of the rotors that are bodies of their own, see `_decoupling_inertias`."""


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
    turned = np.eye(len(JOINTS))
    turned[EYES, EYES] = head.actuation.to_joints
    turned = turned[list(places.values())]
    joint_armature, joint_loads, rotors = np.zeros((3, len(JOINTS)))
    if divided is None:
        used = turned[:, EYES].any(axis=0)
        least = _MIN_ROTOR_RATIO * np.diag(turned.T @ links @ turned)[EYES]
        rotors[EYES] = np.where(used, np.maximum(_EYE_ARMATURE, least), 0.0)
    back = np.linalg.pinv(turned)
    total = links + np.diag(armature)
    felt = total + back.T @ np.diag(rotors) @ back
    for i, name in enumerate(places):
        at = [place for place, joint in enumerate(head.joints) if joint == name]
        joint_armature[at], joint_loads[at] = armature[i], felt[i, i]
    actuator_loads = np.diag(turned.T @ total @ turned) + rotors
    return LoadInertias(joint_armature, joint_loads, actuator_loads, rotors)


def _links_inertia(head: HeadModel) -> FloatArray:
    """(J, J) mass matrix of the links alone, in the order of `joint_index_by_name`."""
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
