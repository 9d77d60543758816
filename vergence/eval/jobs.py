"""Independent jobs, run one after the other, on this machine's processors, or on a cluster.

A job is a picklable call without arguments whose result depends on nothing but itself, so results
are the same, and in the same order, wherever they were computed.
"""

import logging
import os
import socket
from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol

from vergence.errors import ConfigurationError, VergenceError
from vergence.eval.reporting.runs import versions

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


def local_mapper(workers: int, progress: Progress | None) -> Mapper:
    """What runs jobs on this machine: this process alone for one worker.

    Args:
        workers: how many processes.
        progress: told after every job.
    """
    return SerialMapper(progress) if workers == 1 else ProcessMapper(workers, progress)


def _alone(job: Job) -> Any:
    """Run a job on one thread: its siblings have the other processors."""
    import cv2

    cv2.setNumThreads(1)
    return job()


class RayMapper:
    """Runs jobs as tasks of a Ray cluster; a task whose node is lost runs again elsewhere.

    The cluster's nodes need the same versions of Python and packages as this machine. After a
    failure the mapper has left the cluster, and what was still to run there is called off.

    Args:
        address: of the cluster, such as `127.0.0.1:6379`.
        progress: told after every job.

    Raises:
        ConfigurationError: Ray is not installed or no cluster answers at the address.
    """

    def __init__(self, address: str, progress: Progress | None = None) -> None:
        self.progress = progress
        self._ray = _join(address)

    def __call__(self, jobs: Sequence[Job]) -> list[Any]:
        """Run all jobs.

        Raises:
            ConfigurationError: a node has other versions.
            VergenceError: one job's node was lost too often.
            Exception: a job's own, as it is.
        """
        try:
            return self._run(jobs)
        except BaseException:
            self.close()  # also calls off the tasks that are under way
            raise

    def _run(self, jobs: Sequence[Job]) -> list[Any]:
        ray = self._ray
        task = ray.remote(num_cpus=1, max_retries=_RETRIES, scheduling_strategy="SPREAD")(_remote)
        pending = {task.remote(job, versions()): index for index, job in enumerate(jobs)}
        results: list[Any] = [None] * len(jobs)
        while pending:
            (reference,), _ = ray.wait(list(pending), num_returns=1)
            try:
                results[pending.pop(reference)] = ray.get(reference)
            except ray.exceptions.RayTaskError as error:
                # the job's own exception, as without a cluster
                raise (error.cause if isinstance(error.cause, Exception) else error) from error
            except ray.exceptions.RayError as error:
                raise VergenceError(
                    f"cluster: expected every job to finish on some node, got {error}"
                ) from error
            if self.progress is not None:
                self.progress(len(jobs) - len(pending), len(jobs))
        return results

    def close(self) -> None:
        """Leave the cluster."""
        self._ray.shutdown()


_RETRIES: Final = 5
"""How many nodes may be lost under one task."""
_ANSWER_S: Final = 5
"""How long a cluster may take to answer."""


def _join(address: str) -> Any:
    """Ray, connected to a cluster."""
    host, _, port = address.rpartition(":")
    if not (host and port.isdecimal() and int(port) < 65536):
        raise ConfigurationError(f"cluster: expected HOST:PORT, got {address!r}")
    settings = {
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_NUM_REDIS_GET_RETRIES": "2",
        "RAY_py_gcs_connect_timeout_s": str(_ANSWER_S),
    }
    try:
        if socket.gethostbyname(host).startswith("127."):
            # on Linux Ray would put this machine's outer address in its place, where a cluster
            # that listens on loopback alone is not found
            settings["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"
        for name, value in settings.items():
            os.environ.setdefault(name, value)  # read when Ray is imported
        import ray

        # where nothing listens, Ray itself would try for minutes
        socket.create_connection((host, int(port)), timeout=_ANSWER_S).close()
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except ImportError as error:
        raise ConfigurationError(
            f"cluster: expected Ray for {address}, got none; pip install 'vergence[cluster]'"
        ) from error
    except (OSError, ValueError, RuntimeError) as error:
        raise ConfigurationError(
            f"cluster: expected a Ray cluster at {address}, got {error}"
        ) from error
    return ray


def _remote(job: Job, expected: dict[str, str]) -> Any:
    """Run a job on a node of a cluster, if the node would give the same result."""
    found = versions()
    if found != expected:
        different = sorted(set(found.items()) ^ set(expected.items()))
        names = ", ".join(dict.fromkeys(name for name, _ in different))
        raise ConfigurationError(
            f"cluster: expected the same versions on every node as here, got others of {names}"
        )
    return _alone(job)
