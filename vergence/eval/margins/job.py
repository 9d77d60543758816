"""The job that measures the margin of one imperfection of one controller in one scenario."""

from dataclasses import dataclass
from functools import partial

from vergence.eval.comparison.contestant_job import ContestantJob, MadeController
from vergence.eval.margins.margins import Margin
from vergence.eval.margins.measure import MarginMeasurement
from vergence.eval.margins.ranges import search_interval
from vergence.eval.margins.search import last_holding_value


@dataclass(frozen=True, kw_only=True)
class MarginJob(ContestantJob[Margin]):
    """Measure the margin of one imperfection."""

    imperfection: str

    def _evaluate(self, made: MadeController) -> Margin:
        span = search_interval(self.imperfection, self.scenario, made.head)
        measure = MarginMeasurement(
            partial(self._trials, made.controller), self.scenario, self.imperfection
        )
        settles = [
            last_holding_value(lambda value: measure(value).settles, span.expected, end)
            for end in (span.low, span.high)
        ]
        doubles = [
            last_holding_value(lambda value: measure(value).median_not_doubled, span.expected, end)
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
            head=made.head,
            options=made.options,
            tuned=self.resolved.tuned,
        )
