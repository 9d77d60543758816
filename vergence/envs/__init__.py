"""The task and the simulated heads, as Gymnasium environments."""

from typing import Final

from gymnasium.envs.registration import register, registry

__all__ = ["MAX_EPISODE_STEPS", "register_environments"]

MAX_EPISODE_STEPS: Final = 240
"""Steps of an episode of the registered environments: 2 s at 120 Hz (chosen: time to settle
against time of a simulation)."""


def register_environments() -> None:
    """Register the package's environments with Gymnasium, once."""
    if "vergence/Gaze-v0" not in registry:
        register(
            id="vergence/Gaze-v0",
            entry_point="vergence.envs.gaze:GazeEnv",
            vector_entry_point="vergence.envs.gaze_vector:GazeVectorEnv",
            max_episode_steps=MAX_EPISODE_STEPS,
        )
    if "vergence/GainSchedule-v0" not in registry:
        register(
            id="vergence/GainSchedule-v0",
            entry_point="vergence.controllers.networks.environments:GainScheduleEnv",
            vector_entry_point="vergence.controllers.networks.environments:GainScheduleVectorEnv",
            max_episode_steps=MAX_EPISODE_STEPS,
        )
    if "vergence/GazeHardware-v0" not in registry:
        # its episodes last for seconds, whatever the control rate
        register(
            id="vergence/GazeHardware-v0", entry_point="vergence.hardware.gaze:GazeHardwareEnv"
        )
