"""What a simulated plant can do beyond any plant: draw trials, tell the truth, go back."""

from abc import abstractmethod
from typing import NamedTuple

from vergence.envs.plant import Plant, plant_type
from vergence.envs.plants.conditions import Conditions
from vergence.envs.reading import Reading, Truth
from vergence.envs.saved_state import Arrays
from vergence.envs.streams import IntArray, KeyArray
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray


class TrialStart(NamedTuple):
    """How the trials of some places of a batch begin, in a simulation."""

    ids: IntArray
    """(m,) the places."""
    seeds: KeyArray
    """(m,) the trials' seeds."""
    trials: KeyArray
    """(m,) the trials' numbers."""
    positions: FloatArray
    """(m, 7) joint angles, rad; the joints are at rest."""
    motions: FloatArray
    """(m, MOTION) the targets' motions, see `vergence.envs.targets.motion`."""


class Simulation(Plant):
    """A plant that is simulated: it draws trials from seeds, and knows all about them."""

    @property
    @abstractmethod
    def true_head(self) -> HeadModel:
        """The heads that really move: one, or a population of shape (num,)."""

    @property
    @abstractmethod
    def conditions(self) -> Conditions:
        """What the running trials run with, in arrays that the next trials change."""

    @abstractmethod
    def begin(self, start: TrialStart) -> Reading:
        """Begin trials at some places, see `Plant.reset`; the others go on as they were."""

    @abstractmethod
    def truth(self) -> Truth:
        """The present without delay and noise."""

    @abstractmethod
    def truth_at_rest(self) -> Truth:
        """The present, with the targets where they are from their last jump on."""

    @abstractmethod
    def onset_s(self) -> FloatArray:
        """(n,) when the targets jump for the last time, or their motion begins.

        In seconds since the trials' start.
        """

    @abstractmethod
    def first_sights(self) -> tuple[FloatArray, FloatArray]:
        """When trials at time zero read the first images in which either eye finds the target.

        Of a target that was there before, those after its onset count. The eyes are taken to rest
        until then.

        Returns:
            (n,) seconds since the trial's start, of the first image of the target, and of the
            first one after its last jump; inf for never.
        """

    @abstractmethod
    def state(self) -> Arrays:
        """All that the running trials go on from, in arrays of its own."""

    @abstractmethod
    def restore(self, state: Arrays) -> Reading:
        """Put the running trials back to where `state` was called, to the last bit.

        Raises:
            ConfigurationError: the state is that of another simulation.
        """


def is_simulated(name: str) -> bool:
    """Whether a plant is a simulation, as a robot is not.

    Args:
        name: see `vergence.envs.plant.plant_type`.

    Raises:
        VergenceError: there is no such plant.
    """
    return issubclass(plant_type(name), Simulation)


def simulation_of(plant: Plant) -> Simulation:
    """A plant as a simulation, for what cannot do without.

    Raises:
        ConfigurationError: it is none.
    """
    if not isinstance(plant, Simulation):
        raise ConfigurationError(f"plant: expected a simulated one, got {type(plant).__name__}")
    return plant
