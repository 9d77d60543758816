"""What moves heads and reports what their sensors saw, and the registry of such plants."""

from abc import abstractmethod
from collections.abc import Mapping
from importlib import import_module
from typing import Any, ClassVar, Final, NamedTuple, Protocol

from vergence.entry_points import EntryPoint, accepted_arguments, is_entry_point
from vergence.envs.plants.conditions import Conditions
from vergence.envs.reading import Image, Reading, Truth
from vergence.envs.saved_state import Arrays
from vergence.envs.streams import IntArray, KeyArray
from vergence.envs.targets.board import Board
from vergence.errors import ConfigurationError, UnknownNameError, refuse_unknown
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


class Simulation(Protocol):
    """What a simulated plant can do and no real head: draw trials, and tell the truth."""

    @property
    def true_head(self) -> HeadModel:
        """The heads that really move: one, or a population of shape (num,)."""

    @property
    def conditions(self) -> Conditions:
        """What the running trials run with, in arrays that the next trials change."""

    def begin(self, start: TrialStart) -> Reading:
        """Begin trials at some places, see `Plant.reset`; the others go on as they were."""

    @property
    def board(self) -> Board:
        """What a target looks like to the eyes, which have to see all of it."""

    def truth(self) -> Truth:
        """The present without delay and noise."""

    def truth_at_rest(self) -> Truth:
        """The present, with the targets where they are from their last jump on."""

    def onset_s(self) -> FloatArray:
        """(n,) when the targets jump for the last time, or their motion begins.

        In seconds since the trials' start.
        """

    def first_sights(self) -> tuple[FloatArray, FloatArray]:
        """When trials at time zero read the first images in which either eye finds the target.

        Of a target that was there before, those after its onset count. The eyes are taken to rest
        until then.

        Returns:
            (n,) seconds since the trial's start, of the first image of the target, and of the
            first one after its last jump; inf for never.
        """

    def state(self) -> Arrays:
        """All that the running trials go on from, in arrays of its own."""

    def restore(self, state: Arrays) -> Reading:
        """Put the running trials back to where `state` was called, to the last bit.

        Raises:
            ConfigurationError: the state is that of another simulation.
        """


class Plant(Protocol):
    """A batch of heads that move, simulated or real; it paces itself.

    Tasks and controllers use its `Reading` and nothing else. A class that derives from this one
    has no simulation and no images unless it says otherwise, as a head without them.
    """

    head: HeadModel
    """The model that a controller knows."""
    num: int
    """How many heads move side by side."""
    workspace_options: ClassVar[Mapping[str, Any]] = {}
    """Options that fit targets which are drawn anywhere in a workspace; a user's go over them."""

    @property
    def simulation(self) -> Simulation | None:
        """What draws trials and knows the truth; None for a real head."""
        return None

    @abstractmethod
    def reset(self, ids: IntArray, positions: FloatArray) -> Reading:
        """Bring some heads to rest and begin their time anew; the others go on as they were.

        Args:
            ids: (m,) the places.
            positions: (m, 7) joint angles to begin at, rad.

        Returns:
            What the sensors report at time zero, in arrays that the plant reuses.
        """

    @abstractmethod
    def step(self, command: FloatArray) -> Reading:
        """Hold a command for one control period.

        Args:
            command: (n, 7) velocities of the neck's three joints and of the actuators of the eyes,
                zeros beyond those that there are, rad/s; clipped to their speeds. Where each eye
                joint has its own motor, this is the order of the joints.

        Returns:
            What the sensors report at the end of the period, in arrays that the plant reuses.

        Raises:
            ConfigurationError: a command is nan.
        """

    def frames(self, place: int = 0) -> tuple[Image, Image] | None:
        """The newest images of both eyes of a head, in arrays that the plant reuses.

        Args:
            place: which head of the batch.

        Returns:
            Left and right image, (height, width) grey levels; None where there are none.
        """
        return None

    @abstractmethod
    def close(self) -> None:
        """Bring the heads to rest and release what the plant holds; a second call does nothing."""


PLANTS: Final[dict[str, str]] = {
    "kinematic": "vergence.envs.plants.kinematic:KinematicPlant",
    "mujoco": "vergence.envs.plants.mujoco:MujocoPlant",
    "rendered": "vergence.envs.plants.rendered:RenderedPlant",
}
"""Entry points of the plants by name, `module:class`; add to it to bring another."""
_MEMBERS: Final = ("simulation", "reset", "step", "frames", "close")


def plant_type(name: str) -> type[Plant]:
    """The class of a plant.

    Args:
        name: one of `PLANTS`, or `module:class` of a plant of one's own.

    Raises:
        UnknownNameError: there is no such plant.
        ConfigurationError: the module cannot be imported, or what it has is no plant.
    """
    if name in list(PLANTS):  # a list takes what has no hash, too
        module, _, attribute = PLANTS[name].partition(":")
        shipped: type[Plant] = getattr(import_module(module), attribute)
        return shipped
    if not is_entry_point(name):
        raise UnknownNameError("plant", name, [*sorted(PLANTS), "module:class"])
    found = EntryPoint.of(name, "plant").load()
    if not isinstance(found, type):
        raise ConfigurationError(f"plant {name!r}: expected a class, got {found!r:.80}")
    abstract = getattr(found, "__abstractmethods__", ())
    missing = [one for one in _MEMBERS if one in abstract or not hasattr(found, one)]
    if missing:
        raise ConfigurationError(
            f"plant {name!r}: expected a class with all that vergence.envs.plant.Plant has (derive "
            f"from it), got one without {', '.join(missing)}"
        )
    own: type[Plant] = found
    return own


def is_simulated(name: str) -> bool:
    """Whether a plant says that it has a simulation, as a robot does not.

    Raises:
        VergenceError: there is no such plant.
    """
    return getattr(plant_type(name), "simulation", None) is not Plant.simulation


def make_plant(name: str, head: HeadModel, num: int = 1, **kwargs: Any) -> Plant:
    """Make a plant by name.

    Args:
        name: one of `PLANTS`, or `module:class` of a plant of one's own.
        head: the model that a controller knows.
        num: how many heads move side by side.
        **kwargs: the plant's own options.

    Returns:
        The plant.

    Raises:
        UnknownNameError: there is no such plant.
        ConfigurationError: it has no such option, or it is a user's own and no plant.
    """
    make = plant_type(name)
    known = accepted_arguments(make)
    if known is not None:
        needed = [one for one in ("head", "num") if one not in known]
        if needed:
            raise ConfigurationError(
                f"plant {name!r}: expected one that is made with (head, num, **options), got one "
                f"that takes no {' and no '.join(needed)}"
            )
        refuse_unknown("plant_options", kwargs, sorted(known - {"head", "num"}) or ["(none)"])
    plant = make(head, num, **kwargs)  # type: ignore[call-arg]
    for attribute in ("head", "num"):
        if not hasattr(plant, attribute):
            raise ConfigurationError(
                f"plant {name!r}: expected the attributes head and num, got none called {attribute}"
            )
    return plant


def simulation_of(plant: Plant) -> Simulation:
    """The simulation behind a plant, for what cannot do without.

    Raises:
        ConfigurationError: there is none.
    """
    if plant.simulation is None:
        raise ConfigurationError(f"plant: expected a simulated one, got {type(plant).__name__}")
    return plant.simulation
