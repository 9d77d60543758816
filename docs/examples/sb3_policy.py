"""A policy that plain Stable-Baselines3 has saved, as a controller: copy and change.

Run ``vergence deploy sb3_policy.py:Saved --config desk.toml --options sb3.toml`` with these lines
in sb3.toml::

    ["sb3_policy.py:Saved"]
    path = "gaze.zip"
"""

from stable_baselines3 import PPO


class Saved:
    """A zip of `PPO.save`, learned on the head that it runs on."""

    def __init__(self, head, layout, path="gaze.zip"):
        self.model = PPO.load(path, device="cpu")
        expected, got = layout.size, self.model.observation_space.shape
        if got != (expected,):
            raise ValueError(f"expected a policy of {expected} observations, got {got}")

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        """Choose actions, see `vergence.controllers.controller.Controller`."""
        return self.model.predict(observation, state, episode_start, deterministic)
