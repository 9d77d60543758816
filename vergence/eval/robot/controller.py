"""The controller that a word names, as it runs on a robot: tuned options, and watched."""

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, Final

from vergence.controllers.controller import Controller
from vergence.envs.layout import ObservationLayout
from vergence.eval.comparison.contestants import POLICY_FILES, contestants
from vergence.eval.comparison.options import GivenOptions
from vergence.eval.comparison.own_code import Watched
from vergence.models.head import HeadModel

LOOP: Final = "desk"
"""The scenario whose tuned options run on a robot: two turrets and two webcams."""


class RobotController:
    """A controller made for a robot.

    Args:
        word: a name, a policy file's path, or an entry point.
        head: the model that it knows.
        given: TOML file of options to put over tuned ones; None for none.
        options: what it runs with in place of these, unless it is a policy file, which has its own.

    Attributes:
        label: what tables call it.
        policy: the controller.
        options: what it runs with; of a policy file its SHA-256.

    Raises:
        VergenceError: there is none, it cannot be made, or the file is none of options.
    """

    policy: Controller
    options: dict[str, Any]

    def __init__(
        self,
        word: str,
        head: HeadModel,
        given: Path | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        over = GivenOptions() if given is None else GivenOptions.read(given)
        found = contestants((word,), given=over)[0]
        over.check_names(found.names)
        if options is None or Path(word).suffix in POLICY_FILES:
            options = found.fitted(head, LOOP).options
        self.label = found.label
        self.policy, self.options = found.make(head, ObservationLayout.of(head), options)

    def blamed(self) -> AbstractContextManager[None]:
        """What is refused meanwhile is the fault of a controller of somebody's own."""
        return self.policy.blamed() if isinstance(self.policy, Watched) else nullcontext()
