"""Run independent jobs one after the other, on this machine's processors, or on a cluster.

A job is a picklable callable without arguments, whose result depends only on the job itself. The
results, and their order, are therefore the same wherever the jobs run.
"""

import logging
import os
import signal
import socket
import sys
import threading
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, redirect_stdout
from multiprocessing import resource_tracker
from types import ModuleType
from typing import Any, Final, TypeVar

from vergence.envs.plants import limit_threads, processors
from vergence.errors import ConfigurationError, VergenceError, how_to_install
from vergence.kernels.cache import report_compiling_if_uncached
from vergence.reporting.runs import package_versions

T = TypeVar("T")
Job = Callable[[], Any]
_LOKY_MANAGER_THREAD: Final = "_ExecutorManagerThread"
"""Class name of loky's thread that distributes jobs."""
_THREAD_JOIN_TIMEOUT_S: Final = 10.0
"""Longest wait for that thread after jobs are cancelled, s (chosen)."""
Progress = Callable[[int, int], None]
"""Callback with the number of finished jobs and the total number."""


class Mapper(ABC):
    """Runner of jobs, which returns their results in order.

    Args:
        progress: callback after every job.

    Attributes:
        progress: callback after every job; it may be replaced between calls.
        workers: number of jobs that run at a time.
    """

    workers: int = 1

    def __init__(self, progress: Progress | None = None) -> None:
        self.progress = progress

    def __call__(self, jobs: Sequence[Callable[[], T]]) -> list[T]:
        """Run all jobs.

        Raises:
            Exception: the exception of a job, unchanged.
        """
        results: dict[int, T] = {}
        with closing(self._results(jobs)) as found:
            for number, result in found:
                results[number] = result
                if self.progress is not None:
                    self.progress(len(results), len(jobs))
        return [results[number] for number in range(len(jobs))]

    @abstractmethod
    def _results(self, jobs: Sequence[Callable[[], T]]) -> Generator[tuple[int, T]]:
        """Yield the jobs' numbers and results, each as soon as it is available."""

    def close(self) -> None:
        """Release the mapper's resources."""


class SerialMapper(Mapper):
    """Runner of jobs one after the other in this process."""

    def _results(self, jobs: Sequence[Callable[[], T]]) -> Generator[tuple[int, T]]:
        return ((number, job()) for number, job in enumerate(jobs))


class ProcessMapper(Mapper):
    """Runner of jobs in worker processes of this machine, which stay alive for further jobs.

    Args:
        workers: number of processes.
        progress: callback after every job.

    Raises:
        ConfigurationError: there is not at least one worker.
    """

    def __init__(self, workers: int, progress: Progress | None = None) -> None:
        super().__init__(progress)
        if workers < 1:
            raise ConfigurationError(f"workers: expected at least 1, got {workers}")
        self.workers = workers

    def _results(self, jobs: Sequence[Callable[[], T]]) -> Generator[tuple[int, T]]:
        from joblib import Parallel, delayed

        report_compiling_if_uncached()
        # loky replaces a process whose memory has grown while it compiled kernels, without losing
        # jobs. If warnings are errors, its warning would end the thread that distributes jobs, and
        # the call would hang.
        warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
        workers = max(1, min(self.workers, len(jobs)))
        parallel = Parallel(n_jobs=workers, return_as="generator", pre_dispatch="2*n_jobs")
        finished = False
        with _silent_manager():
            with _interrupts_withheld():
                results = parallel(delayed(_run_single_threaded)(job) for job in jobs)
            try:
                yield from enumerate(results)
                finished = True
            finally:
                if not finished:
                    _call_off(results)


def _call_off(results: Generator[Any]) -> None:
    """Cancel the remaining jobs and end joblib's processes, without messages."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about the number of cancelled jobs
        results.close()
    for thread in threading.enumerate():
        if type(thread).__name__ == _LOKY_MANAGER_THREAD:
            thread.join(_THREAD_JOIN_TIMEOUT_S)


@contextmanager
def _silent_manager() -> Iterator[None]:
    """Ignore the KeyError of loky's manager thread if its jobs are cancelled while it submits one.

    The error is harmless: the executor is discarded then.
    """
    hook = threading.excepthook

    def tell(failed: threading.ExceptHookArgs) -> None:
        if failed.exc_type is not KeyError or type(failed.thread).__name__ != _LOKY_MANAGER_THREAD:
            hook(failed)

    threading.excepthook = tell
    try:
        yield
    finally:
        threading.excepthook = hook


@contextmanager
def _interrupts_withheld() -> Iterator[None]:
    """Block SIGINT while worker processes start; they inherit the blocked signal.

    A terminal sends Ctrl-C to all of them. Only this process shall react to it and end the others,
    which would each print a traceback otherwise.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    # start the tracker of shared memory, which workers use, first: its start unblocks the signal
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _run_single_threaded(job: Callable[[], T]) -> T:
    """Run a job on one thread, as other jobs use the other processors."""
    import cv2

    cv2.setNumThreads(1)
    limit_threads(1)
    # output of user-defined code must not mix with results on standard output
    with redirect_stdout(sys.stderr):
        return job()


@contextmanager
def open_mapper(
    workers: int | None = None, cluster: str | None = None, progress: Progress | None = None
) -> Iterator[Mapper]:
    """Open a mapper for this machine or a cluster; it is closed at the end of the context.

    Args:
        workers: number of processes on this machine; one per processor by default.
        cluster: address of a Ray cluster to use instead, `HOST:PORT`.
        progress: callback after every job.

    Yields:
        The mapper; for one worker, it runs the jobs in this process.

    Raises:
        ConfigurationError: there is not at least one worker, or no such cluster.
    """
    workers = processors() if workers is None else workers
    mapper: Mapper = ProcessMapper(workers, progress)
    if cluster is not None:
        mapper = RayMapper(cluster, progress)
    elif mapper.workers == 1:
        mapper = SerialMapper(progress)
    try:
        yield mapper
    finally:
        mapper.close()


class RayMapper(Mapper):
    """Runner of jobs as tasks of a Ray cluster; a task whose node is lost runs again elsewhere.

    The cluster's nodes need the same versions of Python and packages as this machine. After a
    failure the mapper leaves the cluster, which cancels the remaining tasks; the next jobs join it
    again.

    Args:
        address: address of the cluster, such as `127.0.0.1:6379`.
        progress: callback after every job.

    Raises:
        ConfigurationError: Ray is not installed or no cluster answers at the address.
    """

    def __init__(self, address: str, progress: Progress | None = None) -> None:
        super().__init__(progress)
        self._address = address
        self._ray = _join(address)
        self.workers = max(1, int(self._ray.cluster_resources().get("CPU", 1)))

    def _results(self, jobs: Sequence[Callable[[], T]]) -> Generator[tuple[int, T]]:
        """See `Mapper`."""
        if not self._ray.is_initialized():
            self._ray = _join(self._address)
        try:
            yield from self._run(jobs)
        except BaseException:
            self.close()
            raise

    def _run(self, jobs: Sequence[Callable[[], T]]) -> Generator[tuple[int, T]]:
        ray = self._ray
        task = ray.remote(num_cpus=1, max_retries=_TASK_RETRIES, scheduling_strategy="SPREAD")(
            _remote
        )
        pending = {task.remote(job, package_versions()): number for number, job in enumerate(jobs)}
        while pending:
            (reference,), _ = ray.wait(list(pending), num_returns=1)
            try:
                yield pending.pop(reference), ray.get(reference)
            except ray.exceptions.RayTaskError as error:
                # the job's own exception, as without a cluster
                raise (error.cause if isinstance(error.cause, Exception) else error) from error
            except ray.exceptions.RayError as error:
                raise VergenceError(
                    f"cluster: expected every job to finish on some node, got {error}"
                ) from error

    def close(self) -> None:
        """Leave the cluster."""
        self._ray.shutdown()


_TASK_RETRIES: Final = 5
"""Most lost nodes per task (chosen)."""
_CLUSTER_TIMEOUT_S: Final = 5
"""Time limit for a cluster to answer, s (chosen)."""


def _join(address: str) -> ModuleType:
    """Connect Ray to a cluster, and return its module."""
    host, _, port = address.rpartition(":")
    if not (host and port.isdecimal() and int(port) < 65536):
        raise ConfigurationError(f"cluster: expected HOST:PORT, got {address!r}")
    settings = {
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_NUM_REDIS_GET_RETRIES": "2",
        "RAY_py_gcs_connect_timeout_s": str(_CLUSTER_TIMEOUT_S),
    }
    try:
        for name, value in settings.items():
            os.environ.setdefault(name, value)  # read when Ray is imported
        import ray
        from ray._private import ray_constants

        if socket.gethostbyname(host).startswith("127."):
            # on Linux, Ray would replace a loopback address by this machine's external one, where a
            # cluster that listens only on loopback is not found; its variable would come too late
            # where another package, such as TorchRL, has imported Ray
            ray_constants.ENABLE_RAY_CLUSTER = False
        # if nothing listens at the address, Ray itself would retry for minutes
        socket.create_connection((host, int(port)), timeout=_CLUSTER_TIMEOUT_S).close()
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except ImportError as error:
        raise ConfigurationError(
            f"cluster: expected Ray for {address}, got none: {how_to_install('cluster')}"
        ) from error
    except (OSError, ValueError, RuntimeError) as error:
        raise ConfigurationError(
            f"cluster: expected a Ray cluster at {address}, got {error}"
        ) from error
    found: ModuleType = ray
    return found


def _remote(job: Callable[[], T], expected: dict[str, str]) -> T:
    """Run a job on a node of a cluster, if the node has the same versions of packages."""
    found = package_versions()
    if found != expected:
        different = sorted(set(found.items()) ^ set(expected.items()))
        names = ", ".join(dict.fromkeys(name for name, _ in different))
        raise ConfigurationError(
            f"cluster: expected the same versions on every node as here, got others of {names}"
        )
    return _run_single_threaded(job)
