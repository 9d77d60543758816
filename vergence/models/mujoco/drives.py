"""Actuators of the eyes for a simulator that has only joints and tendons.

An actuator turns one joint of its own, or several, as a version does. If the eyes have fewer
actuators than joints, some joints follow others; a `JointCoupling` describes such a coupled joint.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from vergence.models.actuation import SLOTS
from vergence.models.head import HeadModel
from vergence.models.joints import EYES, NECK
from vergence.models.parts import FloatArray

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
