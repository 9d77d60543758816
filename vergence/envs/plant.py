"""What moves a head and reports what its sensors saw, and the registry of such plants."""

from importlib import import_module
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from vergence.envs.plants.conditions import Conditions
from vergence.envs.reading import Reading, Truth
from vergence.envs.streams import IntArray
from vergence.errors import UnknownNameError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray


class TrialStart(NamedTuple):
    """How the trials of some places of a batch begin."""

    ids: IntArray
    """(m,) the places."""
    seeds: NDArray[np.uint64]
    """(m,) the trials' seeds."""
    trials: NDArray[np.uint64]
    """(m,) the trials' numbers."""
    positions: FloatArray
    """(m, 7) joint angles, rad; the joints are at rest."""
    motions: FloatArray
    """(m, MOTION) the targets' motions, see `vergence.envs.targets.motion`."""


class Plant(Protocol):
    """A batch of heads that move: simulated or real.

    `Reading` is all that tasks and controllers may use; `truth` and `conditions` serve metrics
    alone, and a real head has neither.
    """

    head: HeadModel
    """The model that a controller knows."""
    num: int
    """How many heads move side by side."""

    def reset(self, start: TrialStart) -> Reading:
        """Begin trials at some places; the others go on as they were."""

    def step(self, joint_velocity: FloatArray) -> Reading:
        """Hold a command for one control period.

        Args:
            joint_velocity: (n, 7) rad/s; clipped to the joints' speeds.

        Returns:
            What the sensors report at the end of the period, in arrays that the plant reuses.

        Raises:
            ConfigurationError: a command is nan.
        """

    def truth(self) -> Truth | None:
        """What a simulation knows about the present; None on hardware."""

    @property
    def conditions(self) -> Conditions | None:
        """What the running trials run with, known to a simulation alone; None on hardware."""

    def close(self) -> None:
        """Release what the plant holds."""


PLANTS: Final[dict[str, str]] = {
    "kinematic": "vergence.envs.plants.kinematic:KinematicPlant",
    "mujoco": "vergence.envs.plants.mujoco:MujocoPlant",
    "rendered": "vergence.envs.plants.rendered:RenderedPlant",
}
"""Entry points of the plants by name, `module:class`; add to it to bring another."""


def make_plant(name: str, head: HeadModel, num: int = 1, **kwargs: Any) -> Plant:
    """Make a plant by name.

    Args:
        name: one of `PLANTS`.
        head: the model that a controller knows.
        num: how many heads move side by side.
        **kwargs: the plant's own options.

    Returns:
        The plant.

    Raises:
        UnknownNameError: there is no such plant.
    """
    if name not in PLANTS:
        raise UnknownNameError("plant", name, sorted(PLANTS))
    module, _, attribute = PLANTS[name].partition(":")
    plant: Plant = getattr(import_module(module), attribute)(head, num, **kwargs)
    return plant
