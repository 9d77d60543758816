"""Interface of simulated plants: trials drawn from seeds, ground truth, saved states."""

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
    """Starts of the trials of some environments of a batch, in a simulation."""

    ids: IntArray
    """(m,) environment indices."""
    seeds: KeyArray
    """(m,) the trials' seeds."""
    trials: KeyArray
    """(m,) the trials' numbers."""
    positions: FloatArray
    """(m, 7) initial joint angles, rad; the joints are at rest."""
    motions: FloatArray
    """(m, MOTION) the targets' motions, see `vergence.envs.targets.motion`."""


class Simulation(Plant):
    """A simulated plant: it draws trials from seeds, and knows their ground truth."""

    @property
    @abstractmethod
    def true_head(self) -> HeadModel:
        """The true heads: one, or a population of shape (num,)."""

    @property
    @abstractmethod
    def conditions(self) -> Conditions:
        """Conditions of the running trials, in arrays that the next trials change."""

    @abstractmethod
    def begin(self, start: TrialStart) -> Reading:
        """Begin trials in some environments, see `Plant.reset`; the others continue."""

    @abstractmethod
    def move_targets(self, ids: IntArray, motions: FloatArray) -> None:
        """Replace the motions of running trials' targets: exposures from now on see the new ones.

        Args:
            ids: (m,) environment indices.
            motions: (m, MOTION or more) motions, see `vergence.envs.targets.motion`; their time
                counts from the trial's start, plus its onset.
        """

    @abstractmethod
    def truth(self) -> Truth:
        """Ground truth of the present, without delay or noise."""

    @abstractmethod
    def truth_at_rest(self) -> Truth:
        """Ground truth of the present, with the targets where they are after their last jump."""

    @abstractmethod
    def onset_s(self) -> FloatArray:
        """(n,) times of the targets' last jump, or of the beginning of their motion.

        In seconds since the trials' start.
        """

    @abstractmethod
    def first_detection_times(self) -> tuple[FloatArray, FloatArray]:
        """Reading times of the first images in which an eye finds the target.

        Call it while the trials are at time zero. For a target that was there before, only images
        after its onset count. The eyes are assumed to rest until then.

        Returns:
            (n,) seconds since the trial's start, of the first image of the target, and of the
            first one after its last jump; inf for never.
        """

    @abstractmethod
    def state(self) -> Arrays:
        """Copy the complete state of the running trials."""

    @abstractmethod
    def restore(self, state: Arrays) -> Reading:
        """Restore the running trials from a result of `state`, bit by bit.

        Raises:
            ConfigurationError: the state belongs to another simulation.
        """


def is_simulated(name: str) -> bool:
    """True if a plant is a simulation, not a robot.

    Args:
        name: see `vergence.envs.plant.plant_type`.

    Raises:
        VergenceError: there is no such plant.
    """
    return issubclass(plant_type(name), Simulation)


def simulation_of(plant: Plant) -> Simulation:
    """Check that a plant is a simulation, and return it.

    Raises:
        ConfigurationError: the plant is not a simulation.
    """
    if not isinstance(plant, Simulation):
        raise ConfigurationError(f"plant: expected a simulated one, got {type(plant).__name__}")
    return plant
