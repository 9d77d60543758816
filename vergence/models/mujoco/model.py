"""The head as a MuJoCo model: the tree of links as bodies, a servo a joint, two cameras.

World is frame 0. The body of a moving link carries its D-H frame (joint axis z), the site `N`
is frame N, and the cameras `left` and `right` look along z of `C_l` and `C_r`.
"""

from typing import Any, Final, Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from vergence.errors import ConfigurationError
from vergence.models.boards import PlanarTarget
from vergence.models.head import HeadModel
from vergence.models.joints import EYE_NAMES, JOINTS, LINKS, NECK
from vergence.models.links import T_3_N
from vergence.models.mujoco import scene as mujoco_scene
from vergence.models.mujoco.inertia import armature, link_inertia
from vergence.models.mujoco.servos import add_servos
from vergence.models.parts import FloatArray

SUBSTEPS: Final = 4
"""Steps of the simulation per control period by default: 1/480 s at 120 Hz."""

_FROM_OPTICAL: Final = np.diag([1.0, -1.0, -1.0, 1.0])
"""MuJoCo's cameras look along -z with y up: C turned by 180 degrees about x."""
_PIXEL_M: Final = 3e-6
"""Edge of a sensor's pixel: scales MuJoCo's focal lengths, cancels in the image."""


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
        neck: `welded` holds the neck rigidly and leaves the four joints of the eyes.
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
            nothing, so that it moves the same without, and faster.
        timestep_s: step of the simulation; None for a quarter of the control period.

    Returns:
        The specification. Joints and actuators have the names and the order of `JOINTS`;
        `ctrl` is the commanded joint velocity in rad/s, clipped to the head's limits.

    Raises:
        ConfigurationError: the head is a population or has no lag, or an option has a value
            that cannot work.
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
    if visuals:
        mujoco_scene.add_scenery(spec)
    if target is not None:
        mujoco_scene.add_target(spec, target, board)
    if fixed_pair:
        mujoco_scene.add_fixed_pair(spec)
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
    _set_options(spec, timestep_s, gravity)
    held = np.broadcast_to(np.asarray(neck_position, np.float64), (3,))
    bodies = _add_links(spec, head, dict(zip(JOINTS[NECK], held, strict=True)), neck == "welded")
    _add_cameras(spec, head, bodies)
    add_servos(spec, head, simulated_joints(neck), rest_inertia(head))
    if visuals:
        mujoco_scene.add_appearance(spec, bodies, head)
    return spec


def compile_model(head: HeadModel, **options: Any) -> mujoco.MjModel:
    """The head as a compiled model; see `build_spec` for the arguments and errors."""
    model = build_spec(head, **options).compile()
    joint_addresses(model)
    return model


def simulated_joints(neck: Literal["servo", "welded"]) -> tuple[str, ...]:
    """The joints that move, in MuJoCo's order, which is that of `JOINTS`."""
    return JOINTS if neck == "servo" else JOINTS[NECK.stop :]


def joint_addresses(model: mujoco.MjModel) -> slice:
    """Where a model's joints lie in arrays of all joints; `qpos[i]` is `q[addresses][i]`.

    Args:
        model: a model that `build_spec` made.

    Returns:
        All of `JOINTS`, or the eyes' where the neck is welded.

    Raises:
        ConfigurationError: the joints or the actuators are not those of `JOINTS`, in order.
    """
    joints = tuple(model.joint(i).name for i in range(model.njnt))
    actuators = tuple(model.actuator(i).name for i in range(model.nu))
    for neck in (0, NECK.stop):
        expected = JOINTS[neck:]
        if joints == actuators == expected and model.nq == model.nv == len(expected):
            return slice(neck, len(JOINTS))
    raise ConfigurationError(
        f"MuJoCo model: expected the joints and actuators {JOINTS} in this order, with or "
        f"without the neck's, got joints {joints} and actuators {actuators}"
    )


def mujoco_principal(head: HeadModel) -> FloatArray:
    """(2, 2) `principalpixel` of both cameras, in pixels.

    MuJoCo counts from the image's centre, right and down being negative, and OpenCV's (0, 0)
    is the centre of the upper left pixel: `W / 2 - (u_0 + 1/2)`.
    """
    return np.asarray(head.cameras.size / 2.0 - (head.cameras.principal + 0.5))


def _check(head: HeadModel, neck: str) -> None:
    if head.batch_shape:
        raise ConfigurationError(
            f"MuJoCo model: expected one head, got a population of shape {head.batch_shape}"
        )
    if neck not in ("servo", "welded"):
        raise ConfigurationError(f"neck: expected 'servo' or 'welded', got {neck!r}")
    if not head.timing.lag_s > 0.0:
        raise ConfigurationError(
            f"MuJoCo model: expected a head with timing.lag_s > 0, got {head.timing.lag_s}; "
            "a velocity that follows at once is what the kinematic plant simulates"
        )


def _set_options(spec: mujoco.MjSpec, timestep_s: float, surroundings_act: bool) -> None:
    if not (np.isfinite(timestep_s) and timestep_s > 0.0):
        raise ConfigurationError(f"timestep_s: expected seconds above 0, got {timestep_s!r}")
    spec.compiler.degree = False
    spec.compiler.autolimits = False
    spec.option.timestep = timestep_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    if not surroundings_act:
        bit = mujoco.mjtDisableBit
        unused = bit.mjDSBL_CONTACT | bit.mjDSBL_EQUALITY | bit.mjDSBL_SPRING | bit.mjDSBL_DAMPER
        spec.option.disableflags = int(unused | bit.mjDSBL_GRAVITY)


def _add_links(
    spec: mujoco.MjSpec, head: HeadModel, held: dict[str, float], welded: bool
) -> dict[int, Any]:
    """One body per moving link, by its frame; frames 6 and 9 are fixed to 5 and 8."""
    bodies: dict[int, Any] = {0: spec.worldbody}
    for frame, parent, name in LINKS:
        if not name:
            continue
        pose = np.matmul(*head.links.transforms(frame))
        is_held = welded and name in held
        if is_held:
            pose = pose @ _turn_z(held[name])
        body = bodies[parent].add_body(name=f"{name}_link", gravcomp=1.0, **_placement(pose))
        bodies[frame] = body
        body.mass, body.ipos, body.inertia, _edges = link_inertia(head, name)
        body.explicitinertial = True
        if not is_held:
            _add_joint(body, name, head, spec.option.timestep)
    bodies[3].add_site(name="N", group=4, size=[0.002] * 3, **_placement(T_3_N))
    return bodies


def _add_joint(body: Any, name: str, head: HeadModel, timestep_s: float) -> None:
    index = JOINTS.index(name)
    body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0.0, 0.0, 1.0],
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        range=[head.limits.lower[index], head.limits.upper[index]],
        armature=armature(name),
        # as stiff as the solver allows: the least time constant is two steps
        solref_limit=[2.0 * timestep_s, 1.0],
    )


def rest_inertia(head: HeadModel) -> FloatArray:
    """(7,) the inertia that each joint turns with the head at rest, kg m^2."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    _add_links(spec, head, {}, welded=False)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = head.rest()
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    return np.diag(inertia).copy()


def camera_in_pan_link(head: HeadModel, eye: int) -> FloatArray:
    """(4, 4) the pose of a camera (C_l or C_r) in its pan link's frame (5 or 8), metres."""
    fixed = np.matmul(*head.links.transforms(6 + 3 * eye))
    return np.asarray(fixed @ head.head_eye[eye])


def _add_cameras(spec: mujoco.MjSpec, head: HeadModel, bodies: dict[int, Any]) -> None:
    for eye, (name, size) in enumerate(zip(EYE_NAMES, head.cameras.size, strict=True)):
        bodies[5 + 3 * eye].add_camera(
            name=name,
            resolution=size,
            sensor_size=_PIXEL_M * size,
            focal_pixel=head.cameras.focal[eye],
            principal_pixel=mujoco_principal(head)[eye],
            **_placement(camera_in_pan_link(head, eye) @ _FROM_OPTICAL),
        )
    buffer = spec.visual.global_
    buffer.offwidth, buffer.offheight = head.cameras.size.max(axis=0).tolist()


def _turn_z(angle: float) -> FloatArray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
    return pose


def _placement(pose: FloatArray) -> dict[str, FloatArray]:
    quat = Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True, scalar_first=True)
    return {"pos": pose[:3, 3], "quat": quat}
