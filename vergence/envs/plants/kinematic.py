"""The kinematic plant: motors follow their commands by the exact lag, without masses."""

from vergence.envs.plants.motors import drive
from vergence.envs.plants.simulated import SimulatedPlant
from vergence.envs.streams import IntArray
from vergence.models.joint_response import follow


class KinematicPlant(SimulatedPlant):
    """Heads without masses: each motor is the preset's lag with its acceleration limit.

    Options: those of `SimulatedPlant`.
    """

    def _place(self, ids: IntArray) -> None:
        """Nothing to do: the scene's joint angles are the state."""

    def _move(self) -> None:
        if self._turned is not None:
            scene, command, lag_s = self._state[0], self.reading.command, self.conditions.lag_s
            drive(self._turned, scene, command, lag_s, self.head.timing.period_s)
            return
        limits = self.head.limits
        follow(
            self._scene.positions,
            self._scene.velocities,
            self.reading.command,
            self.conditions.lag_s,
            limits.acceleration,
            limits.lower,
            limits.upper,
            self.head.timing.period_s,
        )
