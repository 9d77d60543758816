"""How actuators move the joints of the eyes in a simulator that knows only joints and tendons.

An actuator turns a joint of its own, or it turns several, such as a version. Where fewer actuators
than joints move the eyes, some joints follow others: these are ties.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import linprog

from vergence.models.actuation import SLOTS
from vergence.models.head import HeadModel
from vergence.models.joints import EYES, NECK
from vergence.models.parts import FloatArray

_DIGITS: Final = 12
"""Decimals of a factor that rounding in its derivation leaves."""


class Drive(NamedTuple):
    """What one actuator turns: its angle is the sum of joints times factors, less an offset."""

    name: str
    """The actuator's."""
    slot: int
    """Its place in an array of the neck's joints and the four actuators of the eyes."""
    joints: tuple[tuple[str, float], ...]
    """The joints with their factors; a single one with the factor 1 is its own."""
    lower: float
    """Least of that sum, rad."""
    upper: float
    """Greatest of that sum, rad."""
    own_joint: str
    """The joint that it turns alone, as far as that joint's limits go, or its rotor, see
    `has_rotors`; empty for none."""


class Tie(NamedTuple):
    """A joint whose angle is an offset and the angles of others times factors."""

    joint: str
    follows: tuple[tuple[str, float], ...]
    """The others with their factors."""
    offset: float
    """rad."""


def joint_places(head: HeadModel) -> dict[str, int]:
    """A head's joints in MuJoCo's order, each with its first place in an array of all seven."""
    places: dict[str, int] = {}
    for place, name in enumerate(head.joints):
        if name:
            places.setdefault(name, place)
    return places


def drives_of(head: HeadModel) -> tuple[Drive, ...]:
    """What moves the joints: the neck's motors and the actuators of the eyes.

    An actuator that has the name of a joint of the neck is called `eyes_` and its name.
    """
    own, limits = head.actuation, head.limits
    out = []
    for place, name in enumerate(head.joints[NECK]):
        if name:
            sides = float(limits.lower[place]), float(limits.upper[place])
            out.append(Drive(name, place, ((name, 1.0),), *sides, name))
    names, matrix, offset = _map(head)
    places = joint_places(head)
    for k, actuator in enumerate(own.names):
        factors = dict.fromkeys(names, 0.0)
        for joint, factor in zip(head.joints[EYES], own.to_actuators[k], strict=True):
            if joint:
                factors[joint] += float(factor)
        slot = NECK.stop + k
        row = np.round(list(factors.values()), _DIGITS)
        shift = float(row @ offset)
        lower, upper = own.lower[slot] + shift, own.upper[slot] + shift
        turned = [(name, float(f)) for name, f in zip(names, row, strict=True) if f]
        alone = ""
        if len(turned) == 1 and turned[0][1] == 1.0:
            joint = turned[0][0]
            place, column = places[joint], matrix[names.index(joint)]
            same = (lower, upper) == (limits.lower[place], limits.upper[place])
            alone = joint if same and np.count_nonzero(column) == 1 else ""
        name = f"eyes_{actuator}" if actuator in head.joints[NECK] else actuator
        if has_rotors(head):
            alone, lower, upper = rotor_name(name), own.lower[slot], own.upper[slot]
        out.append(Drive(name, slot, tuple(turned), float(lower), float(upper), alone))
    return tuple(out)


def ties_of(head: HeadModel) -> tuple[Tie, ...]:
    """The joints of the eyes that follow others; none where each can be moved by itself."""
    names, matrix, offset = _map(head)
    leading: list[int] = []
    for joint in range(len(names)):
        if np.linalg.matrix_rank(matrix[[*leading, joint]]) > len(leading):
            leading.append(joint)
    out = []
    for joint in sorted(set(range(len(names))) - set(leading)):
        solved = np.linalg.lstsq(matrix[leading].T, matrix[joint], rcond=None)[0]
        factors = np.asarray(np.round(solved, _DIGITS))
        follows = [(names[i], float(f)) for i, f in zip(leading, factors, strict=True) if f]
        rest = float(offset[joint] - factors @ offset[leading])
        out.append(Tie(names[joint], tuple(follows), rest))
    return tuple(out)


def coupled(head: HeadModel) -> list[str]:
    """The eyes' joints whose angle is not that of one actuator, each as an equation."""
    own = head.actuation
    names, matrix, offset = _map(head)
    out = []
    for name, row, start in zip(names, matrix, offset, strict=True):
        if np.count_nonzero(row) > 1:
            terms = [f"{f:+g} {a}" for a, f in zip(own.names, row, strict=True) if f]
            ends = [f"{start:+g}"] if start else []
            out.append(f"{name} = {' '.join(terms + ends).removeprefix('+')}")
    return out


def has_rotors(head: HeadModel) -> bool:
    """Whether a simulator needs the actuators' rotors as bodies of their own.

    It does where actuators would disturb one another however their rotors are divided among the
    joints, such as a pan of both eyes and a vergence of one of them.
    """
    names, _matrix, _offset = _map(head)
    return divided_rotors(head, np.ones(len(names))) is None


def rotor_name(drive: str) -> str:
    """The name of a rotor, and of its joint, from that of its drive."""
    return f"{drive}_rotor"


def rotor_ties(head: HeadModel, drives: Sequence[Drive]) -> tuple[Tie, ...]:
    """The eyes' joints as they follow the rotors of a head that has some."""
    names, matrix, offset = _map(head)
    rotors = [drive.own_joint for drive in drives if drive.slot >= NECK.stop]
    return tuple(
        Tie(name, tuple((r, float(f)) for r, f in zip(rotors, row, strict=True) if f), float(start))
        for name, row, start in zip(names, matrix, offset, strict=True)
    )


def divided_rotors(head: HeadModel, least: FloatArray) -> FloatArray | None:
    """Rotors' inertia by joint that leaves actuators undisturbed by one another.

    Actuator k feels `S^T diag(r) S` of the rotors r, S being the joints by actuator; off the
    diagonal that is zero where the joints' rotors share the work rightly.

    Args:
        head: the head.
        least: (J,) what each distinct joint of the eyes must have at least, kg m^2.

    Returns:
        (J,) the smallest ones, kg m^2; None where none do.
    """
    _names, matrix, _offset = _map(head)
    count = matrix.shape[1]
    pairs = [(i, k) for i in range(count) for k in range(i)]
    if not any((matrix[:, i] * matrix[:, k]).any() for i, k in pairs):
        return least
    products = np.array([matrix[:, i] * matrix[:, k] for i, k in pairs])
    found = linprog(
        np.ones(len(least)),
        A_eq=products,
        b_eq=np.zeros(len(pairs)),
        bounds=[(low, None) for low in least],
    )
    return np.asarray(found.x) if found.success else None


def _map(head: HeadModel) -> tuple[list[str], FloatArray, FloatArray]:
    """The eyes' joints, each once: names, (J, m) angles by actuator, (J,) rad at zero."""
    places = {name: at - EYES.start for name, at in joint_places(head).items() if at >= EYES.start}
    rows = list(places.values())
    own = head.actuation
    assert own.to_joints.shape == (SLOTS, SLOTS)
    return list(places), own.to_joints[rows, : own.count], own.offset[rows]
