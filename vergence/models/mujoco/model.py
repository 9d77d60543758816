"""The head as a MuJoCo model: a body per link, a servo per actuator, two cameras.

The world is frame 0. The z axis of a body's frame is the axis of its joint (the article's D-H
frames), the site `N` is frame N, and the cameras `left` and `right` look along z of `C_l` and
`C_r`.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.mujoco import mujoco
from vergence.models.mujoco.bodies import (
    add_bodies,
    add_cameras,
    add_couplings,
    add_rotors,
    add_servos,
    couplings_of,
    joint_index_by_name,
    load_inertias,
    needs_rotor_bodies,
    rotor_couplings,
    transmissions_of,
)
from vergence.models.mujoco.look import (
    Board,
    add_appearance,
    add_observer_cameras,
    add_scenery,
    add_target,
    surroundings_of,
)
from vergence.models.parts import NECK

SUBSTEPS: Final = 4
"""Default number of simulation steps per control period: 1/480 s at 120 Hz (chosen: accuracy
against speed)."""


def build_spec(
    head: HeadModel,
    *,
    neck: Literal["servo", "welded"] = "servo",
    neck_position: ArrayLike = 0.0,
    targets: Mapping[str, Board] = MappingProxyType({}),
    observer_cameras: bool = False,
    visuals: bool = True,
    gravity: bool = False,
    timestep_s: float | None = None,
) -> mujoco.MjSpec:
    """Build the head in its surroundings as an editable MuJoCo specification.

    Args:
        head: one head, not a population.
        neck: `servo` for a neck that moves, `welded` for a rigid neck.
        neck_position: (3,) or a scalar, the angles of a welded neck, rad.
        targets: the boards by the names of the mocap bodies that carry them. A body's frame is T:
            origin at the measured point, x right and y down as seen from in front, z into the
            board.
        observer_cameras: True to add the body `fixed_pair`, which looks over the head, with the
            cameras `fixed_left` and `fixed_right`.
        visuals: True to add shapes, a stand, a floor and lights, for rendering. Without them the
            motion is the same and the simulation is faster.
        gravity: True to enable gravity, contacts, springs and constraints, for models with
            additional bodies. The head's weight is compensated and it has no contacts, so without
            them its motion is the same and the simulation is faster. Coupled joints stay coupled
            either way.
        timestep_s: time step of the simulation, s; None for a quarter of the control period.

    Returns:
        The specification. Joints have the head's names, in the order of their first indices in
        `HeadModel.joints`. Actuators are the joints of the neck, then the actuators of the eyes,
        see `transmissions_of`. `ctrl` is an actuator's commanded velocity in rad/s, clipped to its
        limits.

    Raises:
        ConfigurationError: the head is a population, or moves without a lag, or an option has an
            invalid value.

    MuJoCo's cameras are pinholes: the model does not include lens distortion.
    """
    spec = head_spec(
        head,
        neck=neck,
        neck_position=neck_position,
        visuals=visuals,
        gravity=gravity,
        timestep_s=timestep_s,
    )
    around = surroundings_of(head)
    if visuals:
        add_scenery(spec, around)
    for name, board in targets.items():
        add_target(spec, name, board, around)
    if observer_cameras:
        add_observer_cameras(spec, around)
    return spec


def head_spec(
    head: HeadModel,
    *,
    neck: Literal["servo", "welded"] = "servo",
    neck_position: ArrayLike = 0.0,
    visuals: bool = True,
    gravity: bool = False,
    timestep_s: float | None = None,
) -> mujoco.MjSpec:
    """Build the head without surroundings; see `build_spec` for the arguments and errors."""
    _check(head, neck)
    spec = mujoco.MjSpec()
    spec.modelname = head.name
    timestep_s = head.timing.period_s / SUBSTEPS if timestep_s is None else timestep_s
    drives, rotors = transmissions_of(head), needs_rotor_bodies(head)
    couplings = rotor_couplings(head, drives) if rotors else couplings_of(head)
    _set_options(spec, timestep_s, gravity, bool(couplings))
    angles = np.broadcast_to(np.asarray(neck_position, np.float64), (3,)).tolist()
    named = zip(head.joints[NECK], angles, strict=True)
    held = {name: angle for name, angle in named if name and neck == "welded"}
    loads = load_inertias(head)
    bodies = add_bodies(spec, head, held, loads.joint_armature)
    add_cameras(spec, head, bodies)
    if rotors:
        add_rotors(spec, drives, loads.separate_rotors)
    moving = [drive for drive in drives if drive.joint_or_rotor not in held]
    add_servos(spec, head, moving, loads.actuator_loads)
    add_couplings(spec, couplings)
    spec.option.gravity = surroundings_of(head).gravity
    if visuals:
        add_appearance(spec, bodies, head)
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
    `qpos[: len(joint_of_qpos)] = q[joint_of_qpos]`. This is all of `qpos`, unless the head has
    rotors."""
    slot_of_rotor: NDArray[np.intp]
    """Index of each rotor in the same array as for `slot_of_ctrl`; rotors are the rest of `qpos`,
    see `needs_rotor_bodies`."""
    slot_of_ctrl: NDArray[np.intp]
    """(nu,) index of each number in `ctrl` in an array of the neck's joints and the four actuators
    of the eyes."""


def find_model_indices(model: mujoco.MjModel, head: HeadModel) -> ModelIndices:
    """Find a head's joints and actuators in a model from `build_spec`.

    Args:
        model: the model, with a moving or a welded neck.
        head: the head.

    Raises:
        ConfigurationError: the names or the order of the model's joints or actuators differ from
            the head's.
    """
    joints = tuple(model.joint(i).name for i in range(model.njnt))
    actuators = tuple(model.actuator(i).name for i in range(model.nu))
    places, drives = joint_index_by_name(head), transmissions_of(head)
    for first in (0, NECK.stop):
        moving = {name: place for name, place in places.items() if place >= first}
        driven = {drive.name: drive.slot for drive in drives if drive.slot >= first}
        rotors = {
            drive.joint_or_rotor: drive.slot
            for drive in drives
            if drive.slot >= NECK.stop and needs_rotor_bodies(head)
        }
        expected = (*moving, *rotors)
        if joints == expected and actuators == tuple(driven) and model.nq == len(expected):
            index = {name: i for i, name in enumerate(moving)}
            return ModelIndices(
                qpos_of_joint=np.array(
                    [index.get(name, -1) for name in head.joints], dtype=np.intp
                ),
                joint_of_qpos=np.array([*moving.values()], dtype=np.intp),
                slot_of_rotor=np.array([*rotors.values()], dtype=np.intp),
                slot_of_ctrl=np.array([*driven.values()], dtype=np.intp),
            )
    raise ConfigurationError(
        f"MuJoCo model: expected the joints {tuple(places)} and the actuators "
        f"{tuple(drive.name for drive in drives)} in this order, with or without the neck's, got "
        f"joints {joints} and actuators {actuators}"
    )


def _check(head: HeadModel, neck: str) -> None:
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


def _set_options(
    spec: mujoco.MjSpec, timestep_s: float, surroundings_act: bool, tied: bool
) -> None:
    if not (np.isfinite(timestep_s) and timestep_s > 0.0):
        raise ConfigurationError(f"timestep_s: expected seconds above 0, got {timestep_s!r}")
    spec.compiler.degree = False
    spec.compiler.autolimits = False
    spec.option.timestep = timestep_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    if not surroundings_act:
        bit = mujoco.mjtDisableBit
        unused = bit.mjDSBL_CONTACT | bit.mjDSBL_SPRING | bit.mjDSBL_DAMPER | bit.mjDSBL_GRAVITY
        if not tied:
            unused |= bit.mjDSBL_EQUALITY
        spec.option.disableflags = int(unused)
