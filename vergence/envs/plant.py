"""Interfaces of plants, which move heads and report readings, and of simulated ones; registry."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from importlib import import_module
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np

from vergence.entry_points import EntryPoint, accepted_arguments, is_entry_point
from vergence.envs.plants.conditions import Conditions
from vergence.envs.reading import Image, Reading, Truth
from vergence.envs.reward import JUDGE, LIMIT, TaskArrays, advance_task
from vergence.envs.streams import Arrays, IntArray, KeyArray
from vergence.envs.targets.motion import POINT, Board
from vergence.errors import ConfigurationError, UnknownNameError, refuse_unknown
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray


class Plant(ABC):
    """A batch of moving heads, simulated or real; it keeps the pace of the control periods itself.

    Tasks and controllers use only its `Reading`. By default a plant places no targets and has
    neither images nor ground truth; subclasses override this.
    """

    head: HeadModel
    """Head model that a controller knows."""
    num: int
    """Number of heads in the batch."""
    workspace_options: ClassVar[Mapping[str, Any]] = {}
    """Default options for targets drawn anywhere in a workspace; a user's options override them."""
    max_num: ClassVar[int | None] = None
    """Largest number of heads in a batch; None for no limit."""
    places_targets: bool = False
    """True if `show` places targets, as for an emulated head; a real head looks at the world."""

    @property
    def board(self) -> Board:
        """Shape of the targets; the eyes must see all of it."""
        return POINT

    @property
    def fault(self) -> str:
        """Reason why the heads have been stopped, in words; empty if they have not."""
        return ""

    @property
    def remark(self) -> str:
        """Why an eye has not seen the target, in words; empty if that is not known."""
        return ""

    def release(self) -> None:
        """Allow the next `reset` to reopen heads that a fault has stopped."""
        return None

    def rest(self, reason: str) -> None:
        """Stop the heads for an external reason, such as an invalid command; see `fault`."""
        return None

    def prepare(self) -> None:
        """Compile and check everything that a trial calls, before motors have torque."""
        return None

    def show(self, ids: IntArray, motions: FloatArray) -> None:
        """Place the targets of the next trials of some heads, if `places_targets`.

        Args:
            ids: (m,) environment indices.
            motions: (m, MOTION or more) motions of the targets from `reset` on, see
                `vergence.envs.targets.motion`.
        """
        return None

    @abstractmethod
    def reset(self, ids: IntArray, positions: FloatArray) -> Reading:
        """Bring some heads to rest and restart their time; the others continue.

        Args:
            ids: (m,) environment indices.
            positions: (m, 7) initial joint angles, rad.

        Returns:
            The sensor readings at time zero, in arrays that the plant reuses.
        """

    @abstractmethod
    def step(self, command: FloatArray) -> Reading:
        """Hold a command for one control period.

        Args:
            command: (n, 7) velocities of the neck's three joints and of the eye actuators, 0 in
                unused slots, rad/s; clipped to their limits. If each eye joint has its own motor,
                this is the order of the joints.

        Returns:
            The sensor readings at the end of the period, in arrays that the plant reuses.

        Raises:
            ConfigurationError: a command is nan.
        """

    def join(self, task: TaskArrays) -> None:
        """Serve a task from now on: `act` takes its actions, and `judge` writes its results."""
        self._joined_task, self._joined_reading = task, Reading.empty(self.num)

    def act(self) -> Reading | None:
        """Hold the requested actions for a period, and judge it; None, and no change, for a nan."""
        task, ids = self._joined_task, np.arange(self.num)
        if not advance_task(ids, task, self._joined_reading, LIMIT):
            return None
        return self.judge(ids, self.step(task.command))

    def judge(self, ids: IntArray, reading: Reading) -> Reading:
        """Compute observations, rewards and ends of some environments from the heads' reading.

        Returns:
            The reading itself, or a copy with arrays that kernels can read.

        Raises:
            ConfigurationError: it is no reading of this many heads.
        """
        if reading is not self._joined_reading:  # most plants return the same one each time
            self._joined_reading = Reading.of(reading, self.num)
        advance_task(ids, self._joined_task, self._joined_reading, JUDGE)
        return self._joined_reading

    def frames(self, place: int = 0) -> tuple[Image, Image] | None:
        """The newest images of both eyes of a head, in arrays that the plant reuses.

        Args:
            place: environment index.

        Returns:
            Left and right image, (height, width) grey levels or (height, width, 3) blue, green and
            red; None for a plant without images.
        """
        return None

    def truth(self) -> Truth | None:
        """Ground truth of the present, without delay or noise; None for a real head."""
        return None

    def diagnostics(self) -> dict[str, int]:
        """Counts of faults in the control loop since `prepare`, by name; only robots have some."""
        return {}

    @abstractmethod
    def close(self) -> None:
        """Bring the heads to rest and release what the plant holds; a second call does nothing."""


PLANTS: Final[dict[str, str]] = {
    "hardware": "vergence.hardware.emulated:RobotPlant",
    "kinematic": "vergence.envs.plants.kinematic:KinematicPlant",
    "mujoco": "vergence.envs.plants.mujoco:MujocoPlant",
    "rendered": "vergence.envs.plants.rendered:RenderedPlant",
}
"""Entry points of the plants by name, `module:class`; add entries to register other plants."""


def plant_type(name: str) -> type[Plant]:
    """The class of a plant."""
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
    """Make a plant by name, see `plant_type`, with its own options."""
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
    """True if a plant is a simulation, not a robot."""
    return issubclass(plant_type(name), Simulation)


def simulation_of(plant: Plant) -> Simulation:
    """Check that a plant is a simulation, and return it."""
    if not isinstance(plant, Simulation):
        raise ConfigurationError(f"plant: expected a simulated one, got {type(plant).__name__}")
    return plant
