"""The plants and environments that run without a robot."""

import gymnasium

import vergence  # noqa: F401  # registers its environments
from vergence.envs.plant import PLANTS, is_simulated

SIMULATED_PLANTS = sorted(name for name in PLANTS if is_simulated(name))
SIMULATED_IDS = sorted(
    id for id in gymnasium.registry if id.startswith("vergence/") and "Hardware" not in id
)
