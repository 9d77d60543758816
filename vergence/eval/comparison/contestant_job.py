"""One controller in one scenario on one plant: how a worker makes it, and whom it blames."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

from vergence.controllers.controller import Controller
from vergence.envs.layout import ObservationLayout
from vergence.errors import ControllerError
from vergence.eval.comparison.contestants import Contestant
from vergence.eval.comparison.options import Fitted
from vergence.eval.comparison.own_code import blamed
from vergence.eval.trials.run import Trials, run_trials
from vergence.eval.trials.scenarios import Scenario
from vergence.models.head import HeadModel

Found = TypeVar("Found")


@dataclass(frozen=True, kw_only=True)
class Failure:
    """What went wrong in a controller of somebody's own."""

    scenario: str
    plant: str
    controller: str
    message: str

    @property
    def told(self) -> str:
        """The message, and what the controller is left out of for it."""
        return f"{self.message} (left out of {self.scenario} on {self.plant})"


class Made(NamedTuple):
    """A contestant's controller for the head that it is to turn."""

    controller: Controller
    options: dict[str, Any]
    """Those that it runs with; of a policy file its SHA-256."""
    head: HeadModel
    layout: ObservationLayout


@dataclass(frozen=True, kw_only=True)
class ContestantJob(ABC, Generic[Found]):
    """What a worker finds of one controller in one scenario on one plant; picklable."""

    contestant: Contestant
    fitted: Fitted
    """Found here: a worker on another machine may have another table of tuned options."""
    scenario: Scenario
    plant: str
    head: HeadModel | None
    """In place of the scenario's own."""
    episodes: int
    """Trials of each scenario that runs."""
    seed: int
    keep_going: bool
    """Whether to return what goes wrong in somebody's own code, in place of raising it."""

    def __call__(self) -> Found | Failure:
        """Make the controller and find it."""
        head = self.scenario.model() if self.head is None else self.head
        layout = ObservationLayout.of(head)
        try:
            controller, options = self.contestant.make(head, layout, self.fitted.options)
            return self._find(Made(controller, options, head, layout))
        except ControllerError as error:
            if not self.keep_going:
                raise
            return Failure(
                scenario=self.scenario.name,
                plant=self.plant,
                controller=self.contestant.label,
                message=str(error),
            )

    @abstractmethod
    def _find(self, made: Made) -> Found:
        """What is looked for of the controller."""

    def _trials(self, controller: Controller, scenario: Scenario, *, observed: int = 0) -> Trials:
        """Run the controller's trials, see `run_trials`; what it does wrong is told as its own."""
        with blamed(controller):
            return run_trials(
                controller,
                scenario,
                episodes=self.episodes,
                plant=self.plant,
                seed=self.seed,
                head=self.head,
                observed=observed,
            )
