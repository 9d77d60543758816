"""The head as a MuJoCo model: the tree of links as bodies, a servo an actuator, two cameras.

World is frame 0. The body of a joint carries a frame whose z is the joint's axis (the article's
D-H frames), the site `N` is frame N, and the cameras `left` and `right` look along z of `C_l` and
`C_r`.
"""

from typing import Any, Final, Literal, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.models.boards import PlanarTarget
from vergence.models.head import HeadModel
from vergence.models.joints import NECK
from vergence.models.mujoco import scene as mujoco_scene
from vergence.models.mujoco.appearance import add_appearance
from vergence.models.mujoco.bodies import add_bodies, add_cameras
from vergence.models.mujoco.drives import (
    drives_of,
    has_rotors,
    joint_places,
    rotor_ties,
    ties_of,
)
from vergence.models.mujoco.loads import loads_of
from vergence.models.mujoco.servos import add_rotors, add_servos, add_ties

SUBSTEPS: Final = 4
"""Steps of the simulation per control period by default: 1/480 s at 120 Hz."""


def build_spec(
    head: HeadModel,
    *,
    neck: Literal["servo", "welded"] = "servo",
    neck_position: ArrayLike = 0.0,
    target: Literal["tag", "checkerboard"] | None = "tag",
    board: PlanarTarget | None = None,
    fixed_pair: bool = False,
    visuals: bool = True,
    gravity: bool = False,
    timestep_s: float | None = None,
) -> mujoco.MjSpec:
    """The head in its surroundings as an editable MuJoCo specification.

    Args:
        head: one head, not a population.
        neck: `welded` holds the neck rigidly and leaves the joints of the eyes.
        neck_position: (3,) or a scalar, the angles of a welded neck, rad.
        target: name of the mocap body that carries the board; None for no target. The body's
            frame is T: origin at the measured point, x right and y down as seen from in
            front, z into the board.
        board: what the target shows; None for the default board of that name.
        fixed_pair: whether the body `fixed_pair` with the cameras `fixed_left` and
            `fixed_right` looks over the head.
        visuals: whether there are shapes, a stand, a floor and lights, for pictures; a model
            without them steps faster and moves the same.
        gravity: whether gravity, contacts, springs and constraints act, for those who add
            bodies of their own. The head is compensated for its weight and collides with
            nothing, so that it moves the same without, and faster. Joints that follow others
            do so either way.
        timestep_s: step of the simulation; None for a quarter of the control period.

    Returns:
        The specification. Joints have the head's names, in the order of their first places in
        `HeadModel.joints`; actuators are those joints of the neck and the head's actuators, see
        `drives_of`. `ctrl` is an actuator's commanded velocity in rad/s, clipped to its limits.

    Raises:
        ConfigurationError: the head is a population, or moves without a lag, or an option has a
            value that cannot work.
        UnknownNameError: there is no default board of the target's name.

    MuJoCo's cameras are pinholes: a lens's distortion is not part of the model.
    """
    spec = head_spec(
        head,
        neck=neck,
        neck_position=neck_position,
        visuals=visuals,
        gravity=gravity,
        timestep_s=timestep_s,
    )
    around = mujoco_scene.surroundings_of(head)
    if visuals:
        mujoco_scene.add_scenery(spec, around)
    if target is not None:
        mujoco_scene.add_target(spec, target, board, around=around)
    if fixed_pair:
        mujoco_scene.add_fixed_pair(spec, around)
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
    """The head alone, without surroundings; see `build_spec` for the arguments and errors."""
    _check(head, neck)
    spec = mujoco.MjSpec()
    spec.modelname = head.name
    timestep_s = head.timing.period_s / SUBSTEPS if timestep_s is None else timestep_s
    drives, rotors = drives_of(head), has_rotors(head)
    ties = rotor_ties(head, drives) if rotors else ties_of(head)
    _set_options(spec, timestep_s, gravity, bool(ties))
    angles = np.broadcast_to(np.asarray(neck_position, np.float64), (3,)).tolist()
    named = zip(head.joints[NECK], angles, strict=True)
    held = {name: angle for name, angle in named if name and neck == "welded"}
    loads = loads_of(head)
    bodies = add_bodies(spec, head, held, loads.armature)
    add_cameras(spec, head, bodies)
    if rotors:
        add_rotors(spec, drives, loads.rotors)
    moving = [drive for drive in drives if drive.own_joint not in held]
    add_servos(spec, head, moving, loads.actuators)
    add_ties(spec, ties)
    spec.option.gravity = mujoco_scene.surroundings_of(head).gravity
    if visuals:
        add_appearance(spec, bodies, head)
    return spec


def compile_model(head: HeadModel, **options: Any) -> mujoco.MjModel:
    """The head as a compiled model; see `build_spec` for the arguments and errors."""
    model = build_spec(head, **options).compile()
    addresses_of(model, head)
    return model


class Addresses(NamedTuple):
    """Where a head's joints and actuators lie in the arrays of a model of it."""

    joints: NDArray[np.intp]
    """(7,) of each joint its index in `qpos` and `qvel`, -1 for one that does not move; a joint
    that both eyes share has its index twice."""
    places: NDArray[np.intp]
    """(J,) of each number in `qpos` its first place in an array of all seven joints, so that
    `qpos[: len(places)] = q[places]`; all of `qpos`, unless the head has rotors."""
    rotors: NDArray[np.intp]
    """Of the other numbers in `qpos` their places in an array as for `slots`, see `has_rotors`."""
    slots: NDArray[np.intp]
    """(nu,) of each number in `ctrl` its place among the neck's joints and the four actuators of
    the eyes."""


def addresses_of(model: mujoco.MjModel, head: HeadModel) -> Addresses:
    """Where a head's joints and actuators lie in a model that `build_spec` made of it.

    Args:
        model: the model, with the neck or with a welded one.
        head: the head.

    Raises:
        ConfigurationError: the model has other joints or actuators than the head, or in another
            order.
    """
    joints = tuple(model.joint(i).name for i in range(model.njnt))
    actuators = tuple(model.actuator(i).name for i in range(model.nu))
    places, drives = joint_places(head), drives_of(head)
    for first in (0, NECK.stop):
        moving = {name: place for name, place in places.items() if place >= first}
        driven = {drive.name: drive.slot for drive in drives if drive.slot >= first}
        rotors = {
            drive.own_joint: drive.slot
            for drive in drives
            if drive.slot >= NECK.stop and has_rotors(head)
        }
        expected = (*moving, *rotors)
        if joints == expected and actuators == tuple(driven) and model.nq == len(expected):
            index = {name: i for i, name in enumerate(moving)}
            return Addresses(
                joints=np.array([index.get(name, -1) for name in head.joints], dtype=np.intp),
                places=np.array([*moving.values()], dtype=np.intp),
                rotors=np.array([*rotors.values()], dtype=np.intp),
                slots=np.array([*driven.values()], dtype=np.intp),
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
