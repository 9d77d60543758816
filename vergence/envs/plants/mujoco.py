"""The mujoco plant: the head's dynamics, a batch of simulations stepped together in C."""

from typing import Any, Literal

import numpy as np
from mujoco.batch import Batch
from numpy.typing import ArrayLike

from vergence._jit import compiled
from vergence.envs.plants.simulated import SimulatedPlant
from vergence.envs.reading import Reading
from vergence.envs.saved_state import Arrays
from vergence.envs.streams import IntArray
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.mujoco.model import SUBSTEPS, compile_model, joint_addresses
from vergence.models.mujoco.servos import servo_rate
from vergence.models.parts import FloatArray


class MujocoPlant(SimulatedPlant):
    """Heads with masses, servos and joint limits, see `vergence.models.mujoco.model`.

    MuJoCo moves the joints; where the eyes look is then the true heads' own kinematics, so a
    population of true heads shares one model of masses. The acceleration limit is the servos'
    torque limit, the joint's inertia times the preset's acceleration.

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
        self._joints = joint_addresses(self._model)
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
        self._moving_command = self.reading.command[:, self._joints]
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
        ratio = np.array([servo_rate(lag, step) for lag in self.conditions.lag_s[ids]])
        ratio /= servo_rate(self.head.timing.lag_s, step)
        self._gain[ids, :, 0] = ratio[:, None] * self._nominal_gain
        self._bias[ids, :, 2] = ratio[:, None] * self._nominal_bias

    def _place(self, ids: IntArray) -> None:
        if self._lags_vary:
            self._set_lags(ids)
        self._batch.state[ids] = self._unstarted
        self._qpos[ids] = self._scene.positions[ids, self._joints]

    def _move(self) -> None:
        self._ctrl[:] = self._moving_command
        self._batch.step(None, SUBSTEPS)
        q, v = self._scene.positions, self._scene.velocities
        _take(self._qpos, self._qvel, self._half_step, self._joints.start, q, v)

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
            "_batch", "_qpos", "_qvel", "_ctrl", "_unstarted", "_moving_command", "_gain", "_bias",
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
    qpos: FloatArray, qvel: FloatArray, half_step: float, first: int, q: FloatArray, v: FloatArray
) -> None:
    """Angles and velocities of the joints from `first` on, at the end of the step.

    Semi-implicit integration leaves the angle half a step ahead of the velocity.
    """
    for n in range(q.shape[0]):
        for j in range(qpos.shape[1]):
            v[n, first + j] = qvel[n, j]
            q[n, first + j] = qpos[n, j] - half_step * qvel[n, j]
