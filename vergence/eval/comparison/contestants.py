"""Who is evaluated: controllers by name, by entry point, from a file, or as they are."""

import hashlib
from collections.abc import Collection
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from vergence.controllers.controller import CONTROLLERS, Controller, make_controller
from vergence.controllers.networks.learned import load_policy
from vergence.controllers.tuned import tuned_options
from vergence.envs.layout import ObservationLayout
from vergence.errors import ConfigurationError, UnknownNameError, VergenceError
from vergence.models.head import HeadModel

BASELINE: Final = "ibvs-tuned"
"""What every other controller is compared with."""
BOUND: Final = "bound"
"""The name of the time-optimal bound's row."""
LADDER: Final = (
    "ibvs", "ibvs-tuned", "adaptive", "pid", "fuzzy", "delay-compensated", "saccade", "pursuit",
    "learned-gain", "learned-policy",
)  # fmt: skip
"""The order in which tables have the controllers of the registry; others come after them."""
POLICY_FILES: Final = (".vgp", ".onnx")


@dataclass(frozen=True, kw_only=True)
class Contestant:
    """A controller to be made for each scenario's head; picklable if what it holds is."""

    label: str
    """What the tables call it."""
    source: str | Controller
    """A name of the registry, a policy file's path, `module:class`, or the controller itself."""

    def make(
        self, head: HeadModel, layout: ObservationLayout, scenario: str
    ) -> tuple[Controller, dict[str, Any]]:
        """The controller for a head, with the options found for a scenario.

        Args:
            head: the model that it knows.
            layout: of observations and actions.
            scenario: whose tuned options it takes, if it is one of the registry.

        Returns:
            The controller and its options; of a policy file its SHA-256.

        Raises:
            VergenceError: it cannot be made.
        """
        if not isinstance(self.source, str):
            return self.source, {}
        if self.source in CONTROLLERS:
            options = tuned_options(self.source, scenario, head)
            return make_controller(self.source, head, layout, **options), options
        if Path(self.source).suffix in POLICY_FILES:
            policy = load_policy(Path(self.source), head=head, layout=layout)
            # a file may be another one tomorrow: the result says which one ran
            return policy, {"sha256": hashlib.sha256(Path(self.source).read_bytes()).hexdigest()}
        module, _, attribute = self.source.partition(":")
        make = getattr(import_module(module), attribute)
        try:
            controller: Controller = make(head=head, layout=layout)
        except TypeError as error:
            raise ConfigurationError(
                f"controller {self.source}: expected to be made with head= and layout=, got {error}"
            ) from error
        if not callable(getattr(controller, "predict", None)):
            raise ConfigurationError(
                f"controller {self.source}: expected an object with predict, got {controller!r:.60}"
            )
        return controller, {}


def contestants(words: tuple[str, ...]) -> list[Contestant]:
    """Those that some words name, each once; the baseline is always among them.

    Args:
        words: names of controllers, paths of policies (.vgp or .onnx), or `module:class`, made
            with `head=` and `layout=`. None for all controllers of the registry.

    Returns:
        The contestants, in the order of the words.

    Raises:
        UnknownNameError: a word names nothing.
        ConfigurationError: a file or an attribute is not there.
    """
    names = list(dict.fromkeys(words or ladder()))
    found = [Contestant(label=_label(name, names), source=name) for name in names]
    for one in found:
        _check(str(one.source))
    if BASELINE not in names and BASELINE in CONTROLLERS:
        found.append(Contestant(label=BASELINE, source=BASELINE))
    return found


def that_can_be_made(
    found: list[Contestant], head: HeadModel, scenario: str, named: Collection[str]
) -> tuple[list[Contestant], list[str]]:
    """Leave out those that cannot be made here, such as for want of an optional package.

    Args:
        found: contestants.
        head: the head to make them for.
        scenario: the scenario to make them for.
        named: names and paths that were asked for: these are not left out.

    Returns:
        Those that can be made, and a note for each other.

    Raises:
        VergenceError: one that was asked for cannot be made.
    """
    able, notes = [], []
    for one in found:
        try:
            one.make(head, ObservationLayout.of(head), scenario)
        except VergenceError as error:
            if one.label in named or one.source in named:
                raise
            notes.append(f"{one.label} is left out of {scenario}: {error}")
        else:
            able.append(one)
    return able, notes


def ladder() -> list[str]:
    """The controllers of the registry in the order in which tables have them."""
    return sorted(CONTROLLERS, key=lambda name: (*LADDER, name).index(name))


def _label(word: str, words: list[str]) -> str:
    """A file by its name, or by its path where two have the same name."""
    path = Path(word)
    if path.suffix not in POLICY_FILES:
        return word
    return path.name if [Path(other).name for other in words].count(path.name) == 1 else word


def _check(word: str) -> None:
    if word in CONTROLLERS:
        return
    if Path(word).suffix in POLICY_FILES:
        if not Path(word).is_file():
            raise ConfigurationError(f"controller: expected a file that exists, got {word}")
        return
    module, colon, attribute = word.partition(":")
    if not colon:
        known = [*ladder(), "a .vgp or .onnx file", "module:class"]
        raise UnknownNameError("controller", word, known)
    try:
        there = find_spec(module) is not None and hasattr(import_module(module), attribute)
    except (ImportError, ValueError):
        there = False
    if not there:
        raise ConfigurationError(f"controller: expected module:class that exists, got {word!r}")
