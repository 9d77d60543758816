"""Controllers that take part, by name, by entry point, from a file, or as objects; their options.

Options are tuned for the head, tuned for another head, or given in a file:

```toml
[pid]                   # in every scenario
kp = 6.5

[pid.robust]            # in this scenario, over the former
kp = 6.8

["mine.py:Gentle"]      # passed to the class beside head= and layout=
softness = 0.5
```

An error in the code of a user-defined controller becomes a message of one line that names the place
in that code, instead of a traceback through this package.
"""

import hashlib
import inspect
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.controller import (
    CONTROLLERS,
    Controller,
    controller_class,
    make_controller,
)
from vergence.controllers.networks.learned import load_policy
from vergence.controllers.tuned import find_tuned_or_fallback, is_tuned_for, name_in_tuned_table
from vergence.entry_points import EntryPoint, shown_path, user_error_with_place
from vergence.envs.observation import ObservationLayout
from vergence.envs.task import Policy, rollout
from vergence.errors import (
    ConfigurationError,
    HardwareError,
    OtherHeadError,
    UnknownNameError,
    UserControllerError,
    VergenceError,
    did_you_mean,
)
from vergence.eval.trials.scenarios import SCENARIOS, Scenario
from vergence.eval.tuning.spaces import SEARCH_SPACES
from vergence.models.head import HeadModel

UNTUNED = "untuned for this head"
"""Mark for options that were tuned for another head, or never."""


@dataclass(frozen=True, kw_only=True)
class ResolvedOptions:
    """A controller's options and their source."""

    options: dict[str, Any]
    tuned: bool | None = None
    """True if they were tuned for this head; None if there is nothing to tune or they were
    given."""
    tuned_for: str | None = None
    """Name of the head for which they were tuned, if any."""
    given_names: tuple[str, ...] = ()
    """Names of the user-given options."""


def resolve_options(
    name: str, head: HeadModel, scenario: str, given: Mapping[str, Any]
) -> ResolvedOptions:
    """Resolve the options of a registry controller; given ones override tuned ones."""
    space = {} if name == "ibvs" else SEARCH_SPACES.get(name_in_tuned_table(name), {})
    entry = find_tuned_or_fallback(name, scenario, head)
    tuned = is_tuned_for(entry, head) if space else None
    # A given value replaces a tuned one, so options tuned for this head count as tuned no longer.
    # Remaining options that were tuned for another head stay marked as untuned.
    if space.keys() <= given.keys() or (tuned and space.keys() & given.keys()):
        entry, tuned = (None if space.keys() <= given.keys() else entry), None
    return ResolvedOptions(
        options={**({} if entry is None else entry.options), **given},
        tuned=tuned,
        tuned_for=None if entry is None or tuned is None else entry.head,
        given_names=tuple(given),
    )


class GivenOptions:
    """User-given options by controller, and by controller and scenario; `where` is their source."""

    def __init__(self, content: Mapping[str, Any] | None = None, where: str = "options") -> None:
        self.where = where
        self._content = dict(content or {})
        for name, options in self._content.items():
            if not isinstance(options, Mapping):
                raise ConfigurationError(
                    f"{where}: {name}: expected a table [controller], got {options!r:.60}"
                )

    @classmethod
    def read(cls, path: Path) -> "GivenOptions":
        """Read the options from a TOML file."""
        try:
            return cls(tomllib.loads(path.read_text(encoding="utf-8")), str(path))
        except OSError as error:
            raise ConfigurationError(
                f"options: expected a file that can be read, got {path}: {error.strerror}"
            ) from error
        except UnicodeDecodeError as error:
            raise ConfigurationError(f"{path}: expected a TOML file, got a binary one") from error
        except tomllib.TOMLDecodeError as error:
            raise ConfigurationError(f"{path}: expected a TOML file, got {error}") from error

    def check_names(self, known: Iterable[str]) -> list[str]:
        """Reject options of unknown controllers; a note for each one that does not take part."""
        taking_part = list(known)
        notes = []
        for name in self._content:
            if name in taking_part:
                continue
            if name not in CONTROLLERS:
                names = ", ".join(dict.fromkeys([*CONTROLLERS, *taking_part]))
                raise ConfigurationError(f"{self.where}: {name}: expected a controller of {names}")
            notes.append(f"options of {name} in {self.where} are not used: it does not take part")
        return notes

    def for_controller(self, names: Iterable[str], scenario: str) -> dict[str, Any]:
        """The options of one controller, by any of its names, in one scenario."""
        found: dict[str, Any] = {}
        special: dict[str, Any] = {}
        for name in dict.fromkeys(names):
            for key, value in self._content.get(name, {}).items():
                if not isinstance(value, Mapping):
                    found[key] = value
                elif key not in SCENARIOS:
                    raise ConfigurationError(
                        f"{self.where}: {name}.{key}: expected an option's value, or a scenario "
                        f"of {', '.join(SCENARIOS)}"
                    )
                elif key == scenario:
                    special.update(value)
        return {**found, **special}


_PREDICT_SIGNATURE: Final = (
    "predict(observation, state=None, episode_start=None, deterministic=True)"
)


def make_user_controller(
    entry: EntryPoint, head: HeadModel, layout: ObservationLayout, options: Mapping[str, Any]
) -> "GuardedController":
    """Make a user-defined controller and wrap it in `GuardedController`."""
    make = entry.load()
    with suppress(ValueError):  # classes written in C may have no signature
        try:
            inspect.signature(make).bind(head=head, layout=layout, **options)
        except TypeError as error:
            raise ConfigurationError(
                f"controller {entry.spec}: expected to be made with head= and layout=, "
                f"got {entry.attribute}{inspect.signature(make)}: {error}"
            ) from error
    try:
        controller = make(head=head, layout=layout, **options)
    except (Exception, SystemExit) as error:
        raise UserControllerError(
            f"controller {entry.spec}: cannot be made: {user_error_with_place(error)}"
        ) from error
    return GuardedController(controller, entry.spec)


def option_names(controller_factory: Any) -> set[str] | None:
    """Names of the options that a class takes besides `head` and `layout`; None for any name."""
    parameters = inspect.signature(controller_factory).parameters.values()
    if any(one.kind is inspect.Parameter.VAR_KEYWORD for one in parameters):
        return None
    return {one.name for one in parameters} - {"head", "layout"}


def errors_attributed_to(controller: Policy) -> AbstractContextManager[None]:
    """Context that attributes errors to a user-defined controller; no effect for other ones."""
    return (
        controller.attributing_errors()
        if isinstance(controller, GuardedController)
        else nullcontext()
    )


class GuardedController:
    """Wrapper of a controller that reports errors of its `predict` in one line, with a place."""

    def __init__(self, controller: Any, label: str) -> None:
        predict = getattr(controller, "predict", None)
        if not callable(predict):
            raise ConfigurationError(
                f"controller {label}: expected an object with predict, got {controller!r:.60}"
            )
        with suppress(ValueError):
            try:
                inspect.signature(predict).bind(
                    None, state=None, episode_start=None, deterministic=True
                )
            except TypeError as error:
                raise ConfigurationError(
                    f"controller {label}: expected {_PREDICT_SIGNATURE}, got "
                    f"predict{inspect.signature(predict)}{_file_of(controller)}: {error}"
                ) from error
        self._controller = controller
        self._label = label
        self._calls = 0

    def predict(
        self,
        observation: NDArray[Any],
        state: Any = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], Any]:
        """See `Controller.predict`; a `UserControllerError` if it raises or returns no actions."""
        self._calls += 1
        try:
            answer = self._controller.predict(
                observation, state=state, episode_start=episode_start, deterministic=deterministic
            )
        except (Exception, SystemExit) as error:
            raise self._wrong(user_error_with_place(error)) from error
        try:
            action, state = answer
            action = np.asarray(action)
        except (TypeError, ValueError) as error:
            raise self._wrong(
                f"expected (actions, state), got {answer!r:.60}{_file_of(self._controller)}"
            ) from error
        if action.dtype.kind not in "fiu":
            raise self._wrong(
                f"expected actions as real numbers, got {action.dtype}{_file_of(self._controller)}"
            )
        return action, state

    @contextmanager
    def attributing_errors(self) -> Iterator[None]:
        """Attribute errors raised within the context, such as for nan actions, to this controller.

        Errors of a robot, such as a disconnected cable, stay as they are.
        """
        try:
            yield
        except (UserControllerError, HardwareError):
            raise
        except VergenceError as error:
            if self._calls == 0:
                raise
            raise self._wrong(f"{error}{_file_of(self._controller)}") from error

    def _wrong(self, what: str) -> UserControllerError:
        return UserControllerError(f"controller {self._label}: predict, call {self._calls}: {what}")


def _file_of(controller: Controller) -> str:
    with suppress(TypeError, OSError):
        return f" ({shown_path(inspect.getfile(type(controller)))})"
    return ""


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
        """Resolve its options for a head that it knows, in a scenario by name."""
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
        """Make it for a head; return it and its options, for a policy file its SHA-256."""
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
        """Resolve the options and make it once; user-defined controllers also act once."""
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
    """Leave out contestants that cannot be made here, with a note for each.

    Requested names and paths are left out only if they were trained for another head and others
    remain; else their error is raised.
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
