"""Jobs of one controller in one scenario on one plant: making the controller, and its failures."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

from vergence.controllers.controller import Controller
from vergence.envs.layout import ObservationLayout
from vergence.errors import UserControllerError
from vergence.eval.comparison.contestants import Contestant
from vergence.eval.comparison.options import ResolvedOptions
from vergence.eval.comparison.user_code import errors_attributed_to
from vergence.eval.trials.run import Trials, run_trials
from vergence.eval.trials.scenarios import Scenario
from vergence.models.head import HeadModel

JobResult = TypeVar("JobResult")


@dataclass(frozen=True, kw_only=True)
class ControllerFailure:
    """Error that a user-defined controller raised in one scenario on one plant."""

    scenario: str
    plant: str
    controller: str
    message: str

    @property
    def text(self) -> str:
        """The message, and the scenario and plant from which the controller is left out."""
        return f"{self.message} (left out of {self.scenario} on {self.plant})"


class MadeController(NamedTuple):
    """A contestant's controller, made for a head."""

    controller: Controller
    options: dict[str, Any]
    """The controller's options; for a policy file its SHA-256."""
    head: HeadModel
    layout: ObservationLayout


@dataclass(frozen=True, kw_only=True)
class ContestantJob(ABC, Generic[JobResult]):
    """Picklable job of a worker for one controller in one scenario on one plant."""

    contestant: Contestant
    resolved: ResolvedOptions
    """Options, resolved before the job is sent: another machine may have another table of tuned
    options."""
    scenario: Scenario
    plant: str
    head: HeadModel | None
    """Head that replaces the scenario's; None for the scenario's."""
    episodes: int
    """Number of trials of each scenario that runs."""
    seed: int
    keep_going: bool
    """True to return a `ControllerFailure` in place of raising the error of a user-defined
    controller."""

    def __call__(self) -> JobResult | ControllerFailure:
        """Make the controller and return its results, or its failure."""
        head = self.scenario.model() if self.head is None else self.head
        layout = ObservationLayout.of(head)
        try:
            controller, options = self.contestant.make(head, layout, self.resolved.options)
            return self._evaluate(MadeController(controller, options, head, layout))
        except UserControllerError as error:
            if not self.keep_going:
                raise
            return ControllerFailure(
                scenario=self.scenario.name,
                plant=self.plant,
                controller=self.contestant.label,
                message=str(error),
            )

    @abstractmethod
    def _evaluate(self, made: MadeController) -> JobResult:
        """Compute the job's result for the controller."""

    def _trials(
        self, controller: Controller, scenario: Scenario, *, observed_trials: int = 0
    ) -> Trials:
        """Run the controller's trials, see `run_trials`; errors are attributed to it."""
        with errors_attributed_to(controller):
            return run_trials(
                controller,
                scenario,
                episodes=self.episodes,
                plant=self.plant,
                seed=self.seed,
                head=self.head,
                observed_trials=observed_trials,
            )
