"""The task and the simulated heads, as Gymnasium environments."""

from vergence.entry_points import MAX_EPISODE_STEPS

__all__ = ["MAX_EPISODE_STEPS"]
