"""The controller that a specification names, made for a robot with its tuned options."""

import hashlib
import inspect
import json
from collections.abc import Mapping
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any, Final

from vergence.controllers.controller import Controller
from vergence.entry_points import EntryPoint
from vergence.envs.observation import ObservationLayout
from vergence.eval.comparison.contestants import (
    Contestant,
    GivenOptions,
    errors_attributed_to,
    make_contestants,
)
from vergence.models.head import HeadModel

TUNED_OPTIONS_SCENARIO: Final = "desk"
"""Scenario whose tuned options are used on a robot: two turrets and two webcams."""


class RobotController:
    """A controller made for a robot.

    Args:
        contestant: the entry of the comparison that names the controller.
        head: the model that the controller uses.
        options: its options.

    Attributes:
        name: its name.
        policy: the controller.
        options: its options.
        sha256: SHA-256 of its file, if it is user code or a policy file; else empty.

    Raises:
        VergenceError: it cannot be made.
    """

    policy: Controller
    options: dict[str, Any]

    def __init__(self, contestant: Contestant, head: HeadModel, options: Mapping[str, Any]) -> None:
        self.name = contestant.names[0]
        self.policy, self.options = contestant.make(head, ObservationLayout.of(head), options)
        self.sha256 = self.options.pop("sha256", "")
        if isinstance(contestant.source, EntryPoint):
            with suppress(OSError, TypeError):
                file = inspect.getfile(contestant.source.load())
                self.sha256 = hashlib.sha256(Path(file).read_bytes()).hexdigest()

    @classmethod
    def of(
        cls,
        spec: str,
        head: HeadModel,
        options_file: Path | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> "RobotController":
        """Make the controller that a specification names.

        Args:
            spec: a name, a policy file's path, or an entry point.
            head: the model that the controller uses.
            options_file: TOML file of options that override tuned ones; None for none.
            options: options in place of the tuned ones, for controllers of the registry.

        Raises:
            VergenceError: there is no such controller, it cannot be made, or the file does not
                hold its options.
        """
        over = GivenOptions() if options_file is None else GivenOptions.read(options_file)
        found = make_contestants((spec,), given=over)[0]
        over.check_names(found.names)
        if options is None:
            options = found.resolve_options(head, TUNED_OPTIONS_SCENARIO).options
        return cls(found, head, options)

    @property
    def stated_options(self) -> str:
        """The options as JSON, as a log states them."""
        return json.dumps(self.options, default=str)

    def attributing_errors(self) -> AbstractContextManager[None]:
        """Context that attributes errors, except the robot's, to a controller of user code."""
        return errors_attributed_to(self.policy)
