"""The mujoco plant: the heads' dynamics, in a batch of simulations stepped together in C.

For each substep, a physics engine is given a mean command, and its state is read at the end. The
joint angles at the exposure of a frame are interpolated between both ends of its substep.
"""

import dataclasses
from functools import partial
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.envs.plants import advance_in_threads, bounds
from vergence.envs.plants.cameras import (
    TIME_TOLERANCE_S,
    Exposures,
    Frames,
    TrueHeadsAndTargets,
    exposure_time,
    true_head_row,
)
from vergence.envs.plants.conditions import BACKLASH, GAIN, PackedConditions, unpack_conditions
from vergence.envs.plants.motors import (
    ActuatorCoupling,
    CommandBuffers,
    MotorStates,
    held_commands,
    interpolate_joint,
    joints_from_actuators,
    output_angle,
    output_speed,
)
from vergence.envs.plants.simulated import SimulatedPlant
from vergence.envs.plants.step import MOVE, StepArrays, begin_period, end_period
from vergence.envs.reading import Reading, check_count
from vergence.envs.streams import Arrays, IntArray
from vergence.errors import ConfigurationError
from vergence.kernels import compiled_for_threads, subroutine, unpack_table
from vergence.models.head import HeadModel
from vergence.models.kinematics import PackedHead, eye_actuator_angle, eye_actuator_velocity
from vergence.models.motion import damping_ratio, follow_second_order_joint, lag_decay
from vergence.models.mujoco import Batch, mujoco
from vergence.models.mujoco.model import (
    SUBSTEPS,
    compile_model,
    discrete_lag_rate,
    find_model_indices,
    simulate,
    simulation_functions,
)
from vergence.models.parts import FloatArray


@subroutine
def mean_substep_controls(
    ids: IntArray, substep: int, substeps: int, period_s: float, packed: PackedConditions,
    steps: IntArray, commands: CommandBuffers, motors: MotorStates, servo_slots: IntArray,
    control: FloatArray,
) -> None:  # fmt: skip
    """Compute the servos' controls for a substep of a period: the mean of its commands.

    A second-order servo is simulated as a first-order one with another control: the control that
    leads to the speed of the second-order response at the substep's end.
    """
    given, length = commands.velocities, period_s / substeps
    for n in ids:
        conditions = unpack_conditions(packed, n)
        first, second, change_s = held_commands(
            conditions.command_latency_s, steps[n], given.shape[1], period_s
        )
        before = min(max(change_s - substep * length, 0.0), length) / length
        for i in range(servo_slots.shape[0]):
            k = servo_slots[i]
            u = before * given[n, first, k] + (1.0 - before) * given[n, second, k]
            control[n, i] = u = packed.own[n, GAIN, k] * u
            if conditions.overshoot == 0.0:
                continue
            v, lag_s = motors.speeds[n, k], conditions.lag_s * motors.lag_ratios[k]
            a = conditions.acceleration_ratio * motors.acceleration_limits[k]
            falloff = conditions.torque_falloff / (packed.own[n, GAIN, k] * motors.speed_limits[k])
            _way, then, w = follow_second_order_joint(
                0.0, v, motors.accelerations[n, k], u, lag_s, damping_ratio(conditions.overshoot),
                a, falloff, length,
            )  # fmt: skip
            motors.accelerations[n, k] = w
            control[n, i] = v + (then - v) / (1.0 - lag_decay(length, lag_s))


@subroutine
def read_mujoco_joints(
    ids: IntArray, substep: int, simulations: "MujocoArrays", packed: PackedConditions,
    scene: TrueHeadsAndTargets, motors: MotorStates, coupling: ActuatorCoupling | None,
) -> None:  # fmt: skip
    """Read angles and velocities of motors and joints at the end of a substep.

    Semi-implicit integration leaves the angle half a step ahead of the velocity; this is corrected.
    The motor angles become those nearest to MuJoCo's joints.
    """
    qpos, qvel, half_step = simulations.qpos, simulations.qvel, simulations.half_step_s
    addresses, nominal_head = simulations.joints, simulations.nominal_head
    trajectory = simulations.trajectory
    angles, rates = np.zeros(7), np.zeros(7)
    for n in ids:
        for j in range(7):
            i = addresses[j]
            # a joint that does not move keeps its angle
            rates[j] = qvel[n, i] if i >= 0 else 0.0
            angles[j] = qpos[n, i] - half_step * rates[j] if i >= 0 else motors.angles[n, j]
            if coupling is not None and i < 0:
                angles[j] = 0.0
        for k in range(7):
            q, v = angles[k], rates[k]
            if coupling is not None and k >= 3:
                q = eye_actuator_angle(nominal_head, k - 3, angles[3:])
                v = eye_actuator_velocity(nominal_head, k - 3, rates[3:])
            motors.angles[n, k], motors.speeds[n, k] = q, v
            backlash = packed.own[n, BACKLASH, k]
            output = output_angle(motors.output_angles[n, k], q, backlash)
            motors.output_angles[n, k] = scene.positions[n, k] = output
            scene.velocities[n, k] = output_speed(q, v, output, backlash)
        if coupling is not None:
            true = true_head_row(scene, n)
            joints_from_actuators(
                coupling.scratch[n], true, scene.positions[n], scene.velocities[n]
            )
        for j in range(7):
            trajectory[n, substep + 1, 0, j] = scene.positions[n, j]
            trajectory[n, substep + 1, 1, j] = scene.velocities[n, j]


@subroutine
def expose_on_trajectory(
    ids: IntArray, period_s: float, packed: PackedConditions, steps: IntArray, frames: Frames,
    trajectory: FloatArray, exposures: Exposures,
) -> None:  # fmt: skip
    """Expose the frames of a period, with the joints interpolated within its substeps."""
    substeps = trajectory.shape[1] - 1
    length = period_s / substeps
    for n in ids:
        begin_s, count, conditions = steps[n] * period_s, 0, unpack_conditions(packed, n)
        while True:
            due = exposure_time(conditions, frames.next[n] + count) - begin_s
            if due > period_s + TIME_TOLERANCE_S:
                break
            substep = min(max(int(due / length), 0), substeps - 1)
            share = min(max(due / length - substep, 0.0), 1.0)
            last = share > 1.0 - TIME_TOLERANCE_S
            exposures.time_s[n, count] = begin_s + due
            for j in range(7):
                a, b = trajectory[n, substep, 0, j], trajectory[n, substep + 1, 0, j]
                va, vb = trajectory[n, substep, 1, j], trajectory[n, substep + 1, 1, j]
                q, v = interpolate_joint(a, va, b, vb, share, length)
                exposures.positions[n, count, j] = b if last else q
                exposures.velocities[n, count, j] = vb if last else v
            count += 1
        exposures.counts[n] = count


_HEADS_PER_THREAD: Final = 16
"""Number of heads from which a thread is worth its start (measured: some 40 us, of 10 us a
head)."""


class MujocoArrays(NamedTuple):
    """The simulations of a batch, and all else that moves its joints in a control period."""

    trajectory: FloatArray
    """(n, substeps + 1, 2, 7) angles, rad, and velocities, rad/s, of the joints at the beginning of
    the period and at the end of each substep."""
    qpos: FloatArray  # (n, nq) angles, rad
    qvel: FloatArray  # (n, nv) velocities, rad/s
    ctrl: FloatArray  # (n, nu) controls, rad/s
    joints: IntArray
    """(7,) indices of the joints in `qpos` and `qvel`; -1 for a joint that does not move."""
    slots: IntArray
    """(nu,) indices of the servos in an array of the neck's joints and the actuators."""
    nominal_head: PackedHead  # (PACKED,) the head that the controller knows
    half_step_s: float  # half a time step of the simulation, s
    steps_per_substep: int  # time steps of the simulation per substep
    functions: tuple[int, int, int, int]
    """Result of `simulation_functions`, or zeros if the simulations are stepped by the batch."""
    model: int  # address of the simulation's model
    data: IntArray
    """(n,) address of a working space for each simulation; those of a thread share one."""
    states: int  # address of the simulations' states
    state_size: int  # distance between two states, bytes


class MujocoPlant(SimulatedPlant):
    """Heads with masses, servos and joint limits, see `vergence.models.mujoco.model`.

    MuJoCo moves the joints. The gaze follows from the joint angles by each true head's own
    kinematics, so a population of true heads shares one model of masses. The acceleration limit is
    the servos' torque limit: the load's inertia times the preset's acceleration. If actuators move
    several joints, the actuator angles are computed from MuJoCo's joints and the joint angles from
    these, so that the coupling is exact.

    Args:
        head: the model that a controller knows.
        num: number of heads.
        neck: `servo` moves and holds the neck by its servos, `welded` holds it rigidly at
            the trial's start, which is faster.
        nthread: threads that step the simulations; 0 for all processors.
        **options: options of `SimulatedPlant`.
    """

    def __init__(
        self, head: HeadModel, num: int = 1, *, neck: Literal["servo", "welded"] = "servo",
        nthread: int = 0, lag_s: ArrayLike | None = None, **options: Any,
    ) -> None:  # fmt: skip
        nthread = check_count("nthread", nthread, minimum=0)
        super().__init__(head, num, lag_s=lag_s, **options)
        variation = self._true_heads.variation
        drawn = variation.lag_s if variation is not None else None
        self._lags_vary = drawn is not None
        if not (self.conditions.lag_s > 0.0).all() or (drawn is not None and not drawn[0] > 0.0):
            raise ConfigurationError(
                f"lag_s: expected seconds above 0, got {lag_s if drawn is None else drawn!r}; "
                "a velocity that follows at once is what the kinematic plant simulates"
            )
        true, whole = self._true_heads.given, self._true_heads
        moved = dataclasses.replace(head, limits=true.limits, actuators=true.actuators)
        self._model = compile_model(moved, neck=neck, visuals=False)
        # the plant limits commands itself; an actuator's speed gain may exceed the limit
        self._model.actuator_ctrllimited[:] = 0
        indices = find_model_indices(self._model, head)
        self._joints, self._rotors = indices.qpos_of_joint, indices.slot_of_rotor
        self._qpos_from = np.append(
            indices.joint_of_qpos, 7 + np.arange(len(indices.slot_of_rotor))
        )
        self._slots = np.asarray(indices.slot_of_ctrl)
        self._lag_ratios, self._which_lag = np.unique(
            true.actuation.lag_ratio[self._slots], return_inverse=True
        )
        has_backlash = whole.largest_value("backlash_rad") > 0.0
        self._motors_apart = has_backlash or self._coupling is not None
        has_falloff = whole.largest_value("torque_falloff") > 0.0
        self._forces_vary = has_falloff or self._varies_at_all("acceleration_ratio", 1.0)
        # a period is one substep unless something happens within it; outputs behind backlash are
        # pushed at every step, so that they do not miss the motors' turning points
        rate = head.timing.control_rate_hz / whole.largest_value("frame_rate_hz")
        acts = ("backlash_rad", "torque_falloff", "command_latency_s", "overshoot", "skew_s")
        within = (
            any(whole.largest_value(name) > 0.0 for name in acts)
            or self._varies_at_all("frame_phase", 0.0)
            or self._varies_at_all("clock_drift", 0.0)
            or self._varies_at_all("frame_rate_hz", whole.largest_value("frame_rate_hz"))
            or abs(rate - round(rate)) > TIME_TOLERANCE_S
            or rate < 0.5
        )
        self._substeps = SUBSTEPS if within else 1
        self._track = np.zeros((num, self._substeps + 1, 2, 7))
        self._nthread = min(nthread, num) if nthread else (1 if num == 1 else 0)
        self._half_step = 0.5 * self._model.opt.timestep
        self._start_batch()

    def _varies_at_all(self, name: str, plain: float) -> bool:
        """True if an imperfection differs from `plain` in some trial, or may do so later."""
        variation = self._true_heads.variation
        drawn = variation is not None and getattr(variation, name) is not None
        return drawn or bool((getattr(self.conditions, name) != plain).any())

    def _start_batch(self) -> None:
        self._batch = Batch(self._model, self.num, self._nthread)
        self._qpos = self._batch.bind("qpos")
        self._qvel = self._batch.bind("qvel")
        self._ctrl = self._batch.bind("ctrl")
        # the state row of a simulation that has not begun; a row is a whole simulation
        self._unstarted = self._batch.state[0].copy()
        own_lags = self._lags_vary or bool((self.conditions.lag_s != self.head.timing.lag_s).any())
        # a single simulation is stepped without the batch, whose calls cost as much as its physics,
        # and many of one model too, so that threads sense what they have moved
        at = bounds(self.num, _HEADS_PER_THREAD, self._nthread)
        alone = self.num == 1 or (len(at) > 2 and not own_lags)
        self._inside = alone and not self._forces_vary and all(simulation_functions())
        if self._inside:
            self._own_model = self._batch.get_model(0)
            counts = np.diff(at)
            self._own_data = [mujoco.MjData(self._own_model) for _ in counts]
            self._data_addresses = np.repeat([one._address for one in self._own_data], counts)
        if own_lags:
            self._gain = self._batch.expand("actuator_gainprm")
            self._bias = self._batch.expand("actuator_biasprm")
            self._nominal_gain = self._gain[0, :, 0].copy()
            self._nominal_bias = self._bias[0, :, 2].copy()
            self._set_lags(np.arange(self.num))
        if self._forces_vary:
            self._force = self._batch.expand("actuator_forcerange")
            self._max_force = self._force[0, :, 1].copy()

    def _set_lags(self, ids: IntArray) -> None:
        """Set the servo gains of some environments from their lags."""
        step = self._model.opt.timestep
        # the gain is the inertia times the rate of the discretised lag
        ratio = np.array(
            [
                [discrete_lag_rate(lag * own, step) for own in self._lag_ratios]
                for lag in self.conditions.lag_s[ids]
            ]
        ).reshape(len(ids), len(self._lag_ratios))
        ratio /= [discrete_lag_rate(self.head.timing.lag_s * own, step) for own in self._lag_ratios]
        self._gain[ids, :, 0] = ratio[:, self._which_lag] * self._nominal_gain
        self._bias[ids, :, 2] = ratio[:, self._which_lag] * self._nominal_bias
        if self._inside:
            self._batch.get_model(0, self._own_model)

    def _put_at_rest(self, ids: IntArray) -> None:
        if self._lags_vary:
            self._set_lags(ids)
        self._batch.state[ids] = self._unstarted
        q = self._scene.positions[ids]
        if self._motors_apart:
            motors = self._motors.angles[ids]
            q = np.hstack([self.head.actuation.joints_of(motors), motors[:, self._rotors]])
        self._qpos[ids] = q[:, self._qpos_from]

    def _motion_arrays(self) -> MujocoArrays:
        return MujocoArrays(
            trajectory=self._track, qpos=self._qpos, qvel=self._qvel, ctrl=self._ctrl,
            joints=self._joints, slots=self._slots, nominal_head=self.head.packed,
            half_step_s=self._half_step, steps_per_substep=SUBSTEPS // self._substeps,
            functions=simulation_functions() if self._inside else (0, 0, 0, 0),
            model=self._own_model._address if self._inside else 0,
            data=self._data_addresses if self._inside else np.zeros(self.num, dtype=np.int64),
            states=self._batch.state.ctypes.data, state_size=self._batch.state.strides[0],
        )  # fmt: skip

    def _advance(self, ids: IntArray, phases: int) -> bool:
        if self.num == 1 and self._inside:  # as below, without its cost
            return advance_mujoco(self._table, ids, phases, 0)
        at = bounds(len(ids), _HEADS_PER_THREAD, self._nthread)
        advance = partial(advance_in_threads, advance_mujoco, self._table, ids, phases, at=at)
        if not phases & MOVE or self._inside:
            return advance(0)
        for substep in range(self._substeps):
            if not advance(substep):
                return False
            if self._forces_vary:
                self._limit_forces()
            self._batch.step(None, SUBSTEPS // self._substeps)
        return advance(self._substeps)

    def _limit_forces(self) -> None:
        """Set the servos' force limits from their trials' conditions and their present speeds."""
        most = self.conditions.acceleration_ratio[:, None] * self._max_force
        top = self.conditions.speed_gain[:, self._slots] * self._motors.speed_limits[self._slots]
        falloff = self.conditions.torque_falloff[:, None] / top
        speeds = self._motors.speeds[:, self._slots]
        self._force[:, :, 1] = most * (1.0 - falloff * np.maximum(speeds, 0.0))
        self._force[:, :, 0] = -most * (1.0 - falloff * np.maximum(-speeds, 0.0))

    def restore(self, state: Arrays) -> Reading:
        """See `Simulation.restore`."""
        reading = super().restore(state)
        if self._lags_vary:
            self._set_lags(self._all)
        return reading

    def _arrays(self) -> Arrays:
        return {**super()._arrays(), "simulations": self._batch.state}

    def __getstate__(self) -> dict[str, Any]:
        state = super().__getstate__()
        for live in (
            "_batch", "_qpos", "_qvel", "_ctrl", "_unstarted", "_gain", "_bias", "_force",
            "_own_model", "_own_data", "_data_addresses",
        ):  # fmt: skip
            state.pop(live, None)
        state["_rows"] = self._batch.state.copy()
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        rows = state.pop("_rows")
        vars(self).update(state)
        self._start_batch()
        self._batch.state[:] = rows


@compiled_for_threads
def advance_mujoco(table: NDArray[np.void], ids: IntArray, phases: int, substep: int) -> bool:
    """Run phases of a control period, or a part of them.

    If the simulations are not stepped inside, this is to be called once before each substep and
    once after the last one. False for a nan, see `vergence.envs.plants.step`.
    """
    if substep == 0 and not begin_period(table, ids, phases):
        return False
    if phases & MOVE:
        own: StepArrays = unpack_table(table)
        of, steps, period_s = own.motion, own.scene.step, own.timing.control_period_s
        substeps = of.trajectory.shape[1] - 1
        if substep == 0:  # the track begins with the present joint states
            for n in ids:
                for j in range(7):
                    of.trajectory[n, 0, 0, j] = own.scene.positions[n, j]
                    of.trajectory[n, 0, 1, j] = own.scene.velocities[n, j]
        for k in range(substep, substeps + 1):
            if k > 0:
                read_mujoco_joints(ids, k - 1, of, own.packed, own.scene, own.motors, own.coupling)
            if k == substeps:
                break
            mean_substep_controls(
                ids, k, substeps, period_s, own.packed, steps, own.commands, own.motors, of.slots,
                of.ctrl,
            )  # fmt: skip
            if of.functions[0] == 0:
                return True
            for n in ids:
                state = of.states + n * of.state_size
                simulate(of.functions, of.model, of.data[n], state, of.steps_per_substep)
        expose_on_trajectory(
            ids, period_s, own.packed, steps, own.frames, of.trajectory, own.exposures
        )
    end_period(table, ids, phases)
    return True
