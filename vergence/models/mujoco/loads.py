"""Load inertia of the servos: the links, and the servos' own rotors reflected through the gears.

The rotors are nearly all of a servo's load, so constant gains suit every posture and joints disturb
one another little. The rotors have `NECK_ARMATURE` and `EYE_ARMATURE`, or more if the links are
heavier or longer than such servos are made for.
"""

from typing import Final, NamedTuple

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.joints import EYES, JOINTS, NECK
from vergence.models.mujoco.bodies import add_bodies
from vergence.models.mujoco.drives import (
    decoupling_rotor_inertias,
    joint_index_by_name,
    needs_rotor_bodies,
)
from vergence.models.mujoco.library import mujoco
from vergence.models.parts import FloatArray

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
