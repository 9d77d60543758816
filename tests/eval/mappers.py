"""A mapper as hostile as a cluster may be."""

import pickle
from collections.abc import Callable, Generator, Sequence
from typing import Any

from vergence.reporting.jobs import Mapper


class Backwards(Mapper):
    """Runs a copy of each job, as another process would, and the last one first."""

    workers = 3

    def _results(self, jobs: Sequence[Callable[[], Any]]) -> Generator[tuple[int, Any]]:
        copies = [pickle.loads(pickle.dumps(job)) for job in jobs]
        for number in reversed(range(len(copies))):
            yield number, copies[number]()
