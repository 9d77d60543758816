"""The mujoco plant: the head's dynamics, a batch of simulations stepped together in C."""

from typing import Any, Literal

import numpy as np
from mujoco.batch import Batch
from numpy.typing import ArrayLike

from vergence._jit import compiled
from vergence.envs.plants.motors import Motors, carry
from vergence.envs.plants.simulated import SimulatedPlant
from vergence.envs.reading import Reading
from vergence.envs.saved_state import Arrays
from vergence.envs.streams import IntArray
from vergence.errors import ConfigurationError
from vergence.models.actuation import SLOTS
from vergence.models.head import HeadModel
from vergence.models.mujoco.model import SUBSTEPS, addresses_of, compile_model
from vergence.models.mujoco.servos import servo_rate
from vergence.models.packed import PackedHead, actuator_at, actuator_rate
from vergence.models.parts import FloatArray


class MujocoPlant(SimulatedPlant):
    """Heads with masses, servos and joint limits, see `vergence.models.mujoco.model`.

    MuJoCo moves the joints; where the eyes look is then the true heads' own kinematics, so a
    population of true heads shares one model of masses. The acceleration limit is the servos'
    torque limit, the load's inertia times the preset's acceleration. Where actuators turn several
    joints, their angles are taken from MuJoCo's and the joints follow from these, exactly tied.

    Args:
        head: the model that a controller knows.
        num: how many heads move side by side.
        neck: `servo` moves and holds the neck by its servos, `welded` holds it rigidly at
            the trial's start, which is faster.
        nthread: threads that step the simulations; 0 for all processors.
        **options: those of `SimulatedPlant`.
    """

    def __init__(
        self,
        head: HeadModel,
        num: int = 1,
        *,
        neck: Literal["servo", "welded"] = "servo",
        nthread: int = 0,
        lag_s: ArrayLike | None = None,
        **options: Any,
    ) -> None:
        super().__init__(head, num, lag_s=lag_s, **options)
        variation = self._true_heads.variation
        drawn = variation.lag_s if variation is not None else None
        self._lags_vary = drawn is not None
        if not (self.conditions.lag_s > 0.0).all() or (drawn is not None and not drawn[0] > 0.0):
            raise ConfigurationError(
                f"lag_s: expected seconds above 0, got {lag_s if drawn is None else drawn!r}; "
                "a velocity that follows at once is what the kinematic plant simulates"
            )
        self._model = compile_model(head, neck=neck, target=None, visuals=False)
        addresses = addresses_of(self._model, head)
        self._joints, self._rotors = addresses.joints, addresses.rotors
        self._qpos_from = np.append(addresses.places, 7 + np.arange(len(addresses.rotors)))
        first, count = addresses.slots[0], len(addresses.slots)
        self._slots: slice | IntArray = slice(first, first + count)
        if (addresses.slots != np.arange(first, first + count)).any():
            self._slots = addresses.slots
        self._lag_ratios, self._which_lag = np.unique(
            head.actuation.lag_ratio[self._slots], return_inverse=True
        )
        # what has play is pushed along at every step, so that it does not miss where motors turn
        self._stride = 1 if head.actuation.backlash.any() else SUBSTEPS
        self._nthread = min(nthread, num) if nthread else (1 if num == 1 else 0)
        self._half_step = 0.5 * self._model.opt.timestep
        self._start_batch()

    def _start_batch(self) -> None:
        self._batch = Batch(self._model, self.num, self._nthread)
        self._qpos = self._batch.bind("qpos")
        self._qvel = self._batch.bind("qvel")
        self._ctrl = self._batch.bind("ctrl")
        # a simulation is its row of the state, and this is one that has not begun
        self._unstarted = self._batch.state[0].copy()
        if self._lags_vary or (self.conditions.lag_s != self.head.timing.lag_s).any():
            self._gain = self._batch.expand("actuator_gainprm")
            self._bias = self._batch.expand("actuator_biasprm")
            self._nominal_gain = self._gain[0, :, 0].copy()
            self._nominal_bias = self._bias[0, :, 2].copy()
            self._set_lags(np.arange(self.num))

    def _set_lags(self, ids: IntArray) -> None:
        """Give the servos of some places the gains of their lags."""
        step = self._model.opt.timestep
        # the gain is the inertia times the rate of the discretised lag
        ratio = np.array(
            [
                [servo_rate(lag * own, step) for own in self._lag_ratios]
                for lag in self.conditions.lag_s[ids]
            ]
        ).reshape(len(ids), len(self._lag_ratios))
        ratio /= [servo_rate(self.head.timing.lag_s * own, step) for own in self._lag_ratios]
        self._gain[ids, :, 0] = ratio[:, self._which_lag] * self._nominal_gain
        self._bias[ids, :, 2] = ratio[:, self._which_lag] * self._nominal_bias

    def _place(self, ids: IntArray) -> None:
        if self._lags_vary:
            self._set_lags(ids)
        self._batch.state[ids] = self._unstarted
        q = self._scene.positions[ids]
        if self._motors is not None:
            motors = self._motors.angles[ids]
            q = np.hstack([self.head.actuation.joints_of(motors), motors[:, self._rotors]])
        self._qpos[ids] = q[:, self._qpos_from]

    def _move(self) -> None:
        self._ctrl[:] = self.reading.command[:, self._slots]
        if self._turned is None:
            self._batch.step(None, SUBSTEPS)
            q, v = self._scene.positions, self._scene.velocities
            _take(self._qpos, self._qvel, self._half_step, self._joints, q, v)
            return
        for _ in range(SUBSTEPS // self._stride):
            self._batch.step(None, self._stride)
            head, half_step = self.head.packed, self._half_step
            _take_motors(self._qpos, self._qvel, half_step, self._joints, head, self._turned)
            carry(self._turned, self._state[0])

    def restore(self, state: Arrays) -> Reading:
        """See `Simulation.restore`."""
        reading = super().restore(state)
        if self._lags_vary:
            self._set_lags(self._all)
        return reading

    def _arrays(self) -> Arrays:
        return {**super()._arrays(), "simulations": self._batch.state}

    def __getstate__(self) -> dict[str, Any]:
        state = vars(self).copy()
        for live in (
            "_batch", "_qpos", "_qvel", "_ctrl", "_unstarted", "_gain", "_bias",
        ):  # fmt: skip
            state.pop(live, None)
        state["_rows"] = self._batch.state.copy()
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        rows = state.pop("_rows")
        vars(self).update(state)
        self._start_batch()
        self._batch.state[:] = rows


@compiled
def _take(
    qpos: FloatArray,
    qvel: FloatArray,
    half_step: float,
    addresses: IntArray,
    q: FloatArray,
    v: FloatArray,
) -> None:
    """Angles and velocities of the joints that move, at the end of the step.

    Semi-implicit integration leaves the angle half a step ahead of the velocity.
    """
    for n in range(q.shape[0]):
        for j in range(7):
            i = addresses[j]
            if i >= 0:
                v[n, j] = qvel[n, i]
                q[n, j] = qpos[n, i] - half_step * qvel[n, i]


@compiled
def _take_motors(
    qpos: FloatArray,
    qvel: FloatArray,
    half_step: float,
    addresses: IntArray,
    head: PackedHead,
    motors: Motors,
) -> None:
    """Angles and velocities of the motors at the end of the step, those nearest to the joints'."""
    motors = Motors(*motors)
    angles, rates = np.zeros(4), np.zeros(4)
    for n in range(motors.angles.shape[0]):
        for j in range(7):
            i = addresses[j]
            rate = qvel[n, i] if i >= 0 else 0.0
            angle = qpos[n, i] - half_step * rate if i >= 0 else 0.0
            if j >= 3:
                angles[j - 3], rates[j - 3] = angle, rate
            elif i >= 0:
                motors.angles[n, j], motors.speeds[n, j] = angle, rate
        for k in range(SLOTS):
            motors.angles[n, 3 + k] = actuator_at(head, k, angles)
            motors.speeds[n, 3 + k] = actuator_rate(head, k, rates)
