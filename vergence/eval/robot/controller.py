"""The controller that a word names, as it runs on a robot: tuned options, and watched."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from vergence.controllers.controller import Controller
from vergence.envs.layout import ObservationLayout
from vergence.eval.comparison.contestants import Contestant, contestants
from vergence.eval.comparison.options import GivenOptions
from vergence.eval.comparison.own_code import Watched
from vergence.models.head import HeadModel

LOOP: Final = "desk"
"""The scenario whose tuned options run on a robot: two turrets and two webcams."""


@dataclass(frozen=True, kw_only=True)
class RobotController:
    """A controller that a word names."""

    contestant: Contestant

    @classmethod
    def of(cls, word: str, options: Path | None = None) -> "RobotController":
        """The one that a word names.

        Args:
            word: a name, a policy file's path, or an entry point.
            options: TOML file of options to put over tuned ones.

        Raises:
            VergenceError: there is none, or the file is none of options.
        """
        given = GivenOptions() if options is None else GivenOptions.read(options)
        found = contestants((word,), given=given)[0]
        given.check_names(found.names)
        return cls(contestant=found)

    @property
    def label(self) -> str:
        """What tables call it."""
        return self.contestant.label

    @contextmanager
    def ready(
        self, head: HeadModel, options: Mapping[str, Any] | None = None
    ) -> Iterator[tuple[Controller, dict[str, Any]]]:
        """Make it, and blame it for what is refused meanwhile, if it is somebody's own.

        Args:
            head: the model that it knows.
            options: those that it runs with; None for the tuned and the given ones.

        Yields:
            The controller and its options; of a policy file its SHA-256.

        Raises:
            VergenceError: it cannot be made, or raises, or answers what cannot be.
        """
        if options is None or not self._takes_options:
            options = self.contestant.fitted(head, LOOP).options
        controller, facts = self.contestant.make(head, ObservationLayout.of(head), options)
        if isinstance(controller, Watched):
            with controller.blamed():
                yield controller, facts
        else:
            yield controller, facts

    @property
    def _takes_options(self) -> bool:
        """Whether it is no policy file, which runs as it is."""
        return Path(self.label).suffix not in (".vgp", ".onnx")
