r"""The servos of the MuJoCo model: velocity control with the head's lag and acceleration limit.

A servo turns a commanded velocity u into the torque `clip(k_v (u - v), +-M a_max)`, M being
the joint's inertia, nearly all of it the rotor's seen through the gear. That is the preset's
actuator `dv/dt = clip((u - v) / tau, +-a_max)` if `k_v = M / tau`. MuJoCo's semi-implicit Euler
advances the velocity by `h k_v / M (u - v)`, so `k_v = M (1 - exp(-h / tau)) / h` makes a step of
length h exact, and puts the switch from the acceleration limit to the lag where the exact motion
has it, to second order; the implicit integrators clip earlier and cannot. The angle is advanced
with the velocity at the end of the step, which leaves it half a step ahead: `q - h v / 2` is the
angle of the exact actuator, to second order in h.
"""

from collections.abc import Sequence
from math import expm1

import mujoco
import numpy as np

from vergence.models.head import HeadModel
from vergence.models.joints import JOINTS
from vergence.models.parts import FloatArray


def servo_rate(lag_s: float, timestep_s: float) -> float:
    """The rate in 1/s with which explicit steps follow the exact lag: `(1 - exp(-h / tau)) / h`."""
    return -expm1(-timestep_s / lag_s) / timestep_s


def add_servos(
    spec: mujoco.MjSpec, head: HeadModel, joints: Sequence[str], inertia: FloatArray
) -> None:
    """Add an actuator for each joint, whose control is the commanded velocity in rad/s.

    Args:
        spec: the specification to extend; its time step is set.
        head: whose limits and lag the servos have.
        joints: those that move, in MuJoCo's order.
        inertia: (7,) what each joint turns, kg m^2.
    """
    rate = servo_rate(head.timing.lag_s, spec.option.timestep)
    for name in joints:
        index = JOINTS.index(name)
        speed = head.limits.velocity[index]
        torque = inertia[index] * head.limits.acceleration[index]
        servo = spec.add_actuator(
            name=name,
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            ctrllimited=mujoco.mjtLimited.mjLIMITED_TRUE,
            ctrlrange=[-speed, speed],
        )
        servo.set_to_velocity(kv=inertia[index] * rate)
        if np.isfinite(torque):
            servo.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            servo.forcerange = [-torque, torque]
