"""One imperfection of one controller in one scenario: what a worker does at a time."""

from contextlib import nullcontext
from dataclasses import dataclass

from vergence.envs.layout import ObservationLayout
from vergence.errors import ControllerError
from vergence.eval.comparison.contestants import Contestant
from vergence.eval.comparison.evaluation import Failure
from vergence.eval.comparison.options import Fitted
from vergence.eval.comparison.own_code import Watched
from vergence.eval.margins.margins import Margin
from vergence.eval.margins.measure import Measure
from vergence.eval.margins.ranges import range_of
from vergence.eval.margins.search import last_value
from vergence.eval.trials.run import Trials, run_trials
from vergence.eval.trials.scenarios import Scenario
from vergence.models.head import HeadModel


@dataclass(frozen=True, kw_only=True)
class MarginJob:
    """The margin of one imperfection; picklable."""

    contestant: Contestant
    fitted: Fitted
    """Found here: a worker on another machine may have another table of tuned options."""
    scenario: Scenario
    plant: str
    head: HeadModel | None
    """In place of the scenario's own."""
    imperfection: str
    trials: int
    seed: int
    keep_going: bool
    """Whether to return what goes wrong in somebody's own code, in place of raising it."""

    def __call__(self) -> Margin | Failure:
        """Find it."""
        try:
            return self._find()
        except ControllerError as error:
            if not self.keep_going:
                raise
            return Failure(
                scenario=self.scenario.name,
                plant=self.plant,
                controller=self.contestant.label,
                message=str(error),
            )

    def _find(self) -> Margin:
        head = self.scenario.model() if self.head is None else self.head
        layout = ObservationLayout.of(head)
        controller, options = self.contestant.make(head, layout, self.fitted.options)

        def run(scenario: Scenario) -> Trials:
            return run_trials(
                controller,
                scenario,
                episodes=self.trials,
                plant=self.plant,
                seed=self.seed,
                head=self.head,
            )

        span = range_of(self.imperfection, self.scenario, head)
        with controller.blamed() if isinstance(controller, Watched) else nullcontext():
            measure = Measure(run, self.scenario, self.imperfection)
            settles = [
                last_value(lambda value: measure(value).settles, span.expected, end)
                for end in (span.low, span.high)
            ]
            doubles = [
                last_value(lambda value: measure(value).keeps_pace, span.expected, end)
                for end in (span.low, span.high)
            ]
        return Margin(
            controller=self.contestant.label,
            scenario=self.scenario.name,
            imperfection=self.imperfection,
            range=span,
            settles_low=settles[0],
            settles_high=settles[1],
            doubles_low=doubles[0],
            doubles_high=doubles[1],
            points=measure.points,
            head=head,
            options=options,
            tuned=self.fitted.tuned,
        )
