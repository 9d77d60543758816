"""Controllers that take part: by name, by entry point, from a file, or as objects."""

import hashlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from vergence.controllers.controller import (
    CONTROLLERS,
    Controller,
    controller_class,
    make_controller,
)
from vergence.controllers.networks.learned import load_policy
from vergence.entry_points import EntryPoint
from vergence.envs.layout import ObservationLayout
from vergence.envs.rollout import rollout
from vergence.errors import (
    ConfigurationError,
    OtherHeadError,
    UnknownNameError,
    UserControllerError,
    VergenceError,
    did_you_mean,
)
from vergence.eval.comparison.options import GivenOptions, ResolvedOptions, resolve_options
from vergence.eval.comparison.user_code import GuardedController, make_user_controller, option_names
from vergence.eval.trials.scenarios import Scenario
from vergence.models.head import HeadModel

BASELINE: Final = "ibvs-tuned"
"""The controller with which all others are compared."""
BOUND: Final = "bound"
"""The name of the time-optimal bound's row."""
TABLE_ORDER: Final = (
    "ibvs", "ibvs-tuned", "adaptive", "pid", "fuzzy", "delay-compensated", "state-feedback",
    "saccade", "pursuit", "learned-gain", "learned-policy",
)  # fmt: skip
"""Order of the registry's controllers in tables; others follow."""
POLICY_FILES: Final = (".vgp", ".onnx")
_CHECKED_HEADS: Final = 3
"""Heads in the batch on which a user-defined controller acts once before the evaluation
(numerical)."""


@dataclass(frozen=True, kw_only=True)
class Contestant:
    """A controller to be made for each scenario's head; picklable if its source is."""

    label: str
    """Name in tables."""
    source: str | EntryPoint | Controller
    """A name of the registry, a policy file's path, an entry point, or the controller itself."""
    given_options: GivenOptions = field(default_factory=GivenOptions)
    """User-given options of all controllers."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names under which options and errors may refer to it."""
        word = self.source.spec if isinstance(self.source, EntryPoint) else self.source
        return (word, self.label) if isinstance(word, str) else (self.label,)

    def resolve_options(self, head: HeadModel, scenario: str) -> ResolvedOptions:
        """Resolve the controller's options.

        Args:
            head: the model that the controller knows.
            scenario: name of the scenario whose tuned options apply to a registry controller.

        Raises:
            ConfigurationError: the controller has no option of a given name, or the user's table
                of tuned options cannot be read.
        """
        given = self.given_options.for_controller(self.names, scenario)
        if given:
            known = self._option_names()
            for name, value in given.items():
                if known is not None and name not in known:
                    raise ConfigurationError(
                        f"{self.given_options.where}: {self.label}.{name}: expected one of its "
                        "options, "
                        f"{', '.join(sorted(known)) or 'of which it has none'}, got {value!r}"
                        f"{did_you_mean(name, known)}"
                    )
        if isinstance(self.source, str) and self.source in CONTROLLERS:
            return resolve_options(self.source, head, scenario, given)
        return ResolvedOptions(options=given, given_names=tuple(given))

    def _option_names(self) -> set[str] | None:
        if isinstance(self.source, EntryPoint):
            return option_names(self.source.load())
        if isinstance(self.source, str) and self.source in CONTROLLERS:
            return option_names(controller_class(self.source))
        return set()

    def make(
        self, head: HeadModel, layout: ObservationLayout, options: Mapping[str, Any]
    ) -> tuple[Controller, dict[str, Any]]:
        """Make the controller for a head.

        Args:
            head: the model that the controller knows.
            layout: layout of observations and actions.
            options: the controller's options, see `resolve_options`.

        Returns:
            The controller and its options; for a policy file its SHA-256.

        Raises:
            VergenceError: it cannot be made.
        """
        if isinstance(self.source, EntryPoint):
            return make_user_controller(self.source, head, layout, options), dict(options)
        if not isinstance(self.source, str):
            return GuardedController(self.source, self.label), {}
        if self.source in CONTROLLERS:
            return make_controller(self.source, head, layout, **options), dict(options)
        policy = load_policy(Path(self.source), head=head, layout=layout)
        # the file may change later: the digest identifies the one that ran
        return policy, {"sha256": hashlib.sha256(Path(self.source).read_bytes()).hexdigest()}

    def check(self, head: HeadModel, scenario: Scenario) -> ResolvedOptions:
        """Make the controller once before the evaluation; user-defined ones also act once.

        Args:
            head: the model that the controller knows.
            scenario: the scenario in which it will run.

        Returns:
            The controller's options.

        Raises:
            VergenceError: it cannot run.
        """
        found = self.resolve_options(head, scenario.name)
        layout = ObservationLayout.of(head)
        try:
            controller, _ = self.make(head, layout, found.options)
        except (VergenceError, TypeError, ValueError) as error:
            if isinstance(error, UserControllerError) or not found.given_names:
                raise
            name = self._failing_option(head, layout, found)
            raise ConfigurationError(
                f"{self.given_options.where}: {self.label}.{name}: {_without_stack(error)}"
            ) from error
        if isinstance(self.source, EntryPoint) and isinstance(controller, GuardedController):
            task = scenario.task(_CHECKED_HEADS, plant="kinematic", head=head)
            with controller.attributing_errors():
                rollout(task, controller, 1, lambda _step: None)
        return found

    def _failing_option(
        self, head: HeadModel, layout: ObservationLayout, found: ResolvedOptions
    ) -> str:
        """Name of the given option that alone prevents making it; all names if none does alone."""
        rest = {key: value for key, value in found.options.items() if key not in found.given_names}
        for name in found.given_names:
            try:
                self.make(head, layout, {**rest, name: found.options[name]})
            except (VergenceError, TypeError, ValueError):
                return name
        return ", ".join(found.given_names)


def make_contestants(
    specs: tuple[str, ...],
    extra_controllers: Mapping[str, Controller] | None = None,
    given: GivenOptions | None = None,
) -> list[Contestant]:
    """Make contestants from specifications, each once; the baseline always takes part.

    Args:
        specs: names of controllers, paths of policies (.vgp or .onnx), or `module:class` or
            `path/to/file.py:class`, made with `head=` and `layout=`. Empty for all controllers of
            the registry.
        extra_controllers: more controllers by their labels.
        given: user-given options of the controllers.

    Returns:
        The contestants, in the order of the specifications.

    Raises:
        UnknownNameError: a specification names no controller.
        ConfigurationError: a file or an attribute does not exist, or two rows of the tables would
            have one label.
        UserControllerError: a module cannot be imported.
    """
    given = given or GivenOptions()
    names = list(dict.fromkeys(specs or controllers_in_table_order()))
    found = [
        Contestant(label=_label(name, names), source=_source(name), given_options=given)
        for name in names
    ]
    if BASELINE not in names and BASELINE in CONTROLLERS:
        found.append(Contestant(label=BASELINE, source=BASELINE, given_options=given))
    taken = {BOUND, *(one.label for one in found)}
    for label, controller in (extra_controllers or {}).items():
        if label in taken:
            raise ConfigurationError(
                f"controller: expected a label of its own for each row of the tables, got {label} "
                f"for a controller passed as an object and for {_holder(label)}; give the object "
                f"another name, such as my-{label}"
            )
        found.append(Contestant(label=label, source=controller, given_options=given))
    return found


def available_contestants(
    contestants: list[Contestant], head: HeadModel, scenario: Scenario, requested: Collection[str]
) -> tuple[list[tuple[Contestant, ResolvedOptions]], list[str]]:
    """Leave out contestants that cannot be made here, for example if a package is missing.

    Args:
        contestants: the contestants.
        head: the head for which to make them.
        scenario: the scenario for which to make them.
        requested: requested names and paths, which are left out only if they were trained for
            another head and others remain.

    Returns:
        The contestants that can be made, with their options; and a note for each other one.

    Raises:
        VergenceError: a requested contestant cannot be made.
    """
    available, notes = [], []
    unfit: list[OtherHeadError] = []
    fit = 0
    for one in contestants:
        is_requested = not set(requested).isdisjoint(one.names)
        try:
            available.append((one, one.check(head, scenario)))
            fit += is_requested and one.label != BASELINE
        except VergenceError as error:
            if isinstance(error, OtherHeadError) and is_requested:
                unfit.append(error)
            elif is_requested or one.given_options.for_controller(one.names, scenario.name):
                raise
            notes.append(f"{one.label} is left out of {scenario.name}: {error}")
    if unfit and not fit:
        raise unfit[0]
    return available, notes


def controllers_in_table_order() -> list[str]:
    """The registry's controllers in the order of tables."""
    return sorted(CONTROLLERS, key=lambda name: (*TABLE_ORDER, name).index(name))


def _label(word: str, words: list[str]) -> str:
    """Label of a word: a file's name, or its path if two files have the same name."""
    path = Path(word)
    if path.suffix not in POLICY_FILES and not path.suffix.startswith(".py:"):
        return word
    return path.name if [Path(other).name for other in words].count(path.name) == 1 else word


def _holder(label: str) -> str:
    """Owner of a label that an object may not have, for messages."""
    if label == BOUND:
        return "the time-optimal bound"
    return "the baseline, which always takes part" if label == BASELINE else "one taken by name"


def _source(word: str) -> str | EntryPoint:
    if word in CONTROLLERS:
        return word
    if Path(word).suffix in POLICY_FILES:
        if not Path(word).is_file():
            raise ConfigurationError(f"controller: expected a file that exists, got {word}")
        return word
    if word.endswith(".py"):
        classes = EntryPoint.of(f"{word}:Class", "controller").class_names_with_method("predict")
        found = ", ".join(f"{word}:{name}" for name in classes)
        raise ConfigurationError(
            f"controller: expected {word}:Class with a class of the file that has predict "
            f"({found or 'it has none'}), got {word}"
        )
    if ":" not in word:
        known = [
            *controllers_in_table_order(),
            "a .vgp or .onnx file",
            "module:class",
            "path/to/file.py:class",
        ]
        raise UnknownNameError("controller", word, known)
    entry = EntryPoint.of(word, "controller")
    entry.load()
    return entry


def _without_stack(error: Exception) -> str:
    if isinstance(error, VergenceError):
        return str(error)
    return f"expected a value that it can have: {type(error).__name__}: {error}"
