"""What moves heads and reports what their sensors saw, and the registry of such plants."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from importlib import import_module
from typing import Any, ClassVar, Final

from vergence.entry_points import EntryPoint, accepted_arguments, is_entry_point
from vergence.envs.reading import Image, Reading, Truth
from vergence.envs.streams import IntArray
from vergence.envs.targets.board import POINT, Board
from vergence.errors import ConfigurationError, UnknownNameError, refuse_unknown
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray


class Plant(ABC):
    """A batch of heads that move, simulated or real; it paces itself.

    Tasks and controllers use its `Reading` and nothing else. A class that derives from this one
    looks at the world, without images and without truth, unless it says otherwise.
    """

    head: HeadModel
    """The model that a controller knows."""
    num: int
    """How many heads move side by side."""
    workspace_options: ClassVar[Mapping[str, Any]] = {}
    """Options that fit targets which are drawn anywhere in a workspace; a user's go over them."""
    most: ClassVar[int | None] = None
    """How many heads can move side by side at most; None for any number."""
    places_targets: bool = False
    """Whether `show` places targets, as before an emulated head; a real one looks at the world."""

    @property
    def board(self) -> Board:
        """What a target looks like to the eyes, which have to see all of it."""
        return POINT

    @property
    def fault(self) -> str:
        """Reason in words for which the heads have been stopped; empty while they have not."""
        return ""

    def release(self) -> None:
        """Let heads that a fault has stopped be opened anew by the next `reset`."""
        return None

    def rest(self, reason: str) -> None:
        """Stop for a reason that lies outside, such as a command that is none; see `fault`."""
        return None

    def prepare(self) -> None:
        """Compile and check all that a trial calls, before motors have torque."""
        return None

    def show(self, ids: IntArray, motions: FloatArray) -> None:
        """Place the targets of the next trials of some heads, where `places_targets`.

        Args:
            ids: (m,) the places.
            motions: (m, MOTION or more) how the targets move from `reset` on, see
                `vergence.envs.targets.motion`.
        """
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

    def truth(self) -> Truth | None:
        """What is known about the present without delay or noise; None for a real head."""
        return None

    def diagnostics(self) -> dict[str, int]:
        """Counts of what went wrong in the loop since `prepare`, by name; a robot's has some."""
        return {}

    @abstractmethod
    def close(self) -> None:
        """Bring the heads to rest and release what the plant holds; a second call does nothing."""


PLANTS: Final[dict[str, str]] = {
    "hardware": "vergence.hardware.plant:HardwarePlant",
    "kinematic": "vergence.envs.plants.kinematic:KinematicPlant",
    "mujoco": "vergence.envs.plants.mujoco:MujocoPlant",
    "rendered": "vergence.envs.plants.rendered:RenderedPlant",
}
"""Entry points of the plants by name, `module:class`; add to it to bring another."""


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
    missing = sorted(getattr(found, "__abstractmethods__", ()))
    if missing or not issubclass(found, Plant):
        got = f"one without {', '.join(missing)}" if missing else found.__name__
        raise ConfigurationError(
            f"plant {name!r}: expected a class that derives from vergence.envs.plant.Plant and has "
            f"all of its methods, got {got}"
        )
    return found


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
