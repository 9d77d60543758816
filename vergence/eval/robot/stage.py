"""Stages: sources of the targets before a robot, and of their positions.

For an emulated head, targets are placed anywhere. A real head looks at tags at measured places,
`[[places]]` of its configuration, another one in each trial; or at a target that a person moves; or
at one that stands still, from rest each time.
"""

import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from vergence.envs.plant import Plant
from vergence.envs.targets.motion import fixation_angles
from vergence.errors import ConfigurationError
from vergence.eval.trials.scenarios import BaseScenario
from vergence.hardware.config import HardwareConfig, MeasuredTarget
from vergence.hardware.plant import HardwarePlant
from vergence.models.parts import FloatArray

STAGES: Final = ("emulator", "places", "hand", "still")
"""Names of the stages; by default the first available one is used."""
_JUMPING_TARGET_KINDS: Final = ("double-step", "occluded")
"""Kinds of targets that disappear or jump after they have appeared."""
REST_TARGET: Final = {"kind": "static", "point": (0.0, 0.0, 1.0)}
"""The task's target for a robot; it only makes trials begin at rest."""


class TargetStage(ABC):
    """Way in which the target of each trial is presented to a robot."""

    name: str
    """One of `STAGES`."""
    description: str
    """Description for a report."""
    emulated: bool = False
    """True if errors are the true ones, as an emulated head knows them."""
    repeatable: bool = True
    """True if the target of a trial can be placed there again, to run missing controllers."""

    def target(self, scenario: BaseScenario) -> Mapping[str, Any]:
        """Target from which the task draws its trials.

        Raises:
            ConfigurationError: the stage cannot move a target like that.
        """
        kind = str(scenario.target.get("kind"))
        if scenario.target_moves or kind in _JUMPING_TARGET_KINDS:
            raise ConfigurationError(
                f"scenario: expected one whose target stands still before a robot, got "
                f"{scenario.name}, whose target is {kind!r}; an emulated head has any"
            )
        return REST_TARGET

    def check(self) -> None:
        """Check, before anything moves, that targets can be placed.

        Raises:
            ConfigurationError: no person is there to place them.
        """

    @abstractmethod
    def place(self, plant: Plant, trial: int) -> FloatArray:
        """Place the target of the next trial.

        Args:
            plant: the robot.
            trial: the trial's number.

        Returns:
            (3,) target position, in N, m; nan if unknown.
        """


class EmulatorStage(TargetStage):
    """Stage of an emulated head, in whose world the task's own targets appear."""

    name = "emulator"
    description = "an emulated head, whose targets and errors are the true ones"
    emulated = True

    def target(self, scenario: BaseScenario) -> Mapping[str, Any]:
        """See `TargetStage.target`."""
        kind = str(scenario.target.get("kind"))
        if kind in _JUMPING_TARGET_KINDS:
            raise ConfigurationError(
                f"scenario: expected one whose target is there from its start on, got "
                f"{scenario.name}, whose target is {kind!r}"
            )
        return scenario.target

    def place(self, plant: Plant, trial: int) -> FloatArray:
        """See `TargetStage.place`; the plant does it as the trial begins."""
        return np.full(3, np.nan)


class MeasuredTagsStage(TargetStage):
    """Stage with several fixed tags at measured positions; each trial looks at another one of them.

    Args:
        places: the tags.
        seed: seed of their order.
    """

    name = "places"
    description = (
        "tags at measured places; errors are the measured ones, and intervals hold for these tags"
    )

    def __init__(self, places: tuple[MeasuredTarget, ...], seed: int = 0) -> None:
        self._places = places
        self._order = np.random.default_rng(seed).permutation(len(places))

    def place(self, plant: Plant, trial: int) -> FloatArray:
        """See `TargetStage.place`."""
        assert isinstance(plant, HardwarePlant)
        place = self._places[self._order[trial % len(self._order)]]
        plant.look_for(place.target)
        point: FloatArray = place.point
        return point


class HandPlacedStage(TargetStage):
    """A target that a person moves.

    Args:
        ask: shows a line and waits for an answer.
    """

    name = "hand"
    description = "a target that a person moves; errors are the measured ones"
    repeatable = False

    def __init__(self, ask: Callable[[str], object]) -> None:
        self._ask = ask

    def check(self) -> None:
        """See `TargetStage.check`."""
        if not _watched():
            raise ConfigurationError("stage: expected a terminal for --stage hand, got none")

    def place(self, plant: Plant, trial: int) -> FloatArray:
        """See `TargetStage.place`."""
        plant.prepare()
        self._ask(f"trial {trial + 1}: move the target, then press Enter ")
        return np.full(3, np.nan)


class FixedTargetStage(TargetStage):
    """A target that stands still."""

    name = "still"
    description = (
        "a target that stands still; errors are the measured ones, and intervals hold for it alone"
    )

    def place(self, plant: Plant, trial: int) -> FloatArray:
        """See `TargetStage.place`."""
        return np.full(3, np.nan)


def make_stage(name: str | None, hardware: HardwareConfig, seed: int = 0) -> TargetStage:
    """Make the stage before a robot.

    Args:
        name: one of `STAGES`; None for the first available one, except `still`.
        hardware: the robot.
        seed: seed of the order of places.

    Raises:
        ConfigurationError: the name is unknown, the stage's requirement is missing, or the eyes
            cannot look at a place.
    """
    fits = {
        "emulator": (hardware.places_targets, "an emulated head without --board"),
        "places": (bool(hardware.measured_targets), f"tables [[places]] in {hardware.path}"),
        "hand": (_watched() or name == "hand", "a terminal"),
        "still": (True, ""),
    }
    if name is None:
        # `still` is no default: the robot would look at one and the same place in all trials
        name = next((one for one in STAGES[:-1] if fits[one][0]), None)
        if name is None:
            raise ConfigurationError(
                f"stage: expected tables [[places]] in {hardware.path}, a terminal for a person "
                "who moves the target, or --stage still for a target that stays, got none"
            )
    if name not in fits:
        raise ConfigurationError(f"stage: expected one of {', '.join(STAGES)}, got {name!r}")
    there, needed = fits[name]
    if not there:
        raise ConfigurationError(f"stage: expected {needed} for --stage {name}, got none")
    if name == "emulator":
        return EmulatorStage()
    if name == "places":
        _refuse_out_of_reach(hardware)
        return MeasuredTagsStage(hardware.measured_targets, seed)
    return HandPlacedStage(_ask) if name == "hand" else FixedTargetStage()


def _watched() -> bool:
    return sys.stdin is not None and sys.stdin.isatty()


def _refuse_out_of_reach(hardware: HardwareConfig) -> None:
    """Refuse places that the eyes cannot look at, such as ones in metres or behind the head."""
    head = hardware.head
    for k, place in enumerate(hardware.measured_targets):
        what = f"places[{k}].point_mm in {hardware.path}"
        motors = head.actuation.actuators_of(fixation_angles(head, what, place.point[np.newaxis]))[
            0
        ]
        for servo in hardware.servos:
            if not servo.lower_rad <= motors[servo.slot] <= servo.upper_rad:
                raise ConfigurationError(
                    f"{what}: expected a point that the eyes can look at, {servo.name} from "
                    f"{servo.lower_rad:g} to {servo.upper_rad:g} rad, got "
                    f"{(1e3 * place.point).tolist()}, which needs {motors[servo.slot]:.3f} rad"
                )


def _ask(text: str) -> None:
    print(text, end="", file=sys.stderr, flush=True)
    sys.stdin.readline()
