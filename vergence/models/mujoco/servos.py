r"""The servos of the MuJoCo model: velocity control with the actuators' lags and accelerations.

A servo turns a commanded velocity u into the torque `clip(k_v (u - v), +-M a_max)`. M is its load
inertia, nearly all of it rotors reflected through the gear. With `k_v = M / tau` this is the
preset's actuator `dv/dt = clip((u - v) / tau, +-a_max)`. MuJoCo's semi-implicit Euler integrator
advances the velocity by `h k_v / M (u - v)`. With `k_v = M (1 - exp(-h / tau)) / h` a step of
length h is therefore exact, and the switch from the acceleration limit to the lag is where the
exact motion has it, to second order in h. The implicit integrators clip earlier, so they cannot do
this. The angle is advanced with the velocity at the end of the step, which puts it half a step
ahead: `q - h v / 2` is the angle of the exact actuator, to second order in h.

An actuator that turns several joints acts on a tendon, whose length is the weighted sum of the
joint angles. Equality constraints hold coupled joints to the joints, or to the rotors with bodies
of their own, that they follow.
"""

from collections.abc import Sequence
from math import expm1
from typing import Any, Final

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.joints import NECK
from vergence.models.mujoco.bodies import stiff_solref
from vergence.models.mujoco.drives import JointCoupling, Transmission
from vergence.models.mujoco.library import mujoco
from vergence.models.parts import FloatArray

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
