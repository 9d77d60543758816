"""Independent jobs, run one after the other, on this machine's processors, or on a cluster.

A job is a picklable call without arguments whose result depends on nothing but itself, so results
are the same, and in the same order, wherever they were computed.
"""

import os
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from vergence.errors import ConfigurationError

Job = Callable[[], Any]
Progress = Callable[[int, int], None]
"""Called with the number of jobs done and their number."""


class Mapper(Protocol):
    """Runs jobs and returns their results in order."""

    def __call__(self, jobs: Sequence[Job]) -> list[Any]:
        """Run all jobs."""


class SerialMapper:
    """Runs jobs one after the other in this process.

    Args:
        progress: told after every job.
    """

    def __init__(self, progress: Progress | None = None) -> None:
        self.progress = progress

    def __call__(self, jobs: Sequence[Job]) -> list[Any]:
        """Run all jobs."""
        results = []
        for job in jobs:
            results.append(job())
            if self.progress is not None:
                self.progress(len(results), len(jobs))
        return results


class ProcessMapper:
    """Runs jobs on this machine's processors, in processes that stay for the next jobs.

    Args:
        workers: how many processes.
        progress: told after every job.
    """

    def __init__(self, workers: int, progress: Progress | None = None) -> None:
        if workers < 1:
            raise ConfigurationError(f"workers: expected at least 1, got {workers}")
        self._workers = workers
        self.progress = progress

    def __call__(self, jobs: Sequence[Job]) -> list[Any]:
        """Run all jobs."""
        from joblib import Parallel, delayed

        parallel = Parallel(n_jobs=self._workers, return_as="generator", pre_dispatch="2*n_jobs")
        results = []
        for result in parallel(delayed(_alone)(job) for job in jobs):
            results.append(result)
            if self.progress is not None:
                self.progress(len(results), len(jobs))
        return results


def _alone(job: Job) -> Any:
    """Run a job on one thread: its siblings have the other processors."""
    import cv2

    cv2.setNumThreads(1)
    return job()


class RayMapper:
    """Runs jobs as tasks of a Ray cluster; a task whose node is lost runs again elsewhere.

    Args:
        address: of the cluster, such as `127.0.0.1:6379`.
        progress: told after every job.

    Raises:
        ConfigurationError: Ray is not installed or no cluster answers at the address.
    """

    def __init__(self, address: str, progress: Progress | None = None) -> None:
        try:
            import ray
        except ImportError as error:
            raise ConfigurationError(
                f"cluster: expected Ray for {address}, got none; pip install 'vergence[cluster]'"
            ) from error
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        try:
            ray.init(address=address, log_to_driver=False, logging_level="ERROR")
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise ConfigurationError(
                f"cluster: expected a Ray cluster at {address}, got {error}"
            ) from error
        self._ray: Any = ray
        self.progress = progress

    def __call__(self, jobs: Sequence[Job]) -> list[Any]:
        """Run all jobs."""
        ray = self._ray
        task = ray.remote(max_retries=10, num_cpus=1)(_alone)
        pending = {task.remote(job): index for index, job in enumerate(jobs)}
        results: list[Any] = [None] * len(jobs)
        done = 0
        while pending:
            ready, _ = ray.wait(list(pending), num_returns=1)
            for reference in ready:
                results[pending.pop(reference)] = ray.get(reference)
                done += 1
                if self.progress is not None:
                    self.progress(done, len(jobs))
        return results

    def close(self) -> None:
        """Leave the cluster."""
        self._ray.shutdown()
