"""Jobs give the same results in the same order, whoever runs them."""

import gc
import signal
import sys
import warnings
from functools import partial
from types import SimpleNamespace

import pytest

from vergence.envs.plants import bounds
from vergence.errors import ConfigurationError, VergenceError
from vergence.reporting import jobs
from vergence.reporting.jobs import (
    ProcessMapper,
    RayMapper,
    SerialMapper,
    _run_single_threaded,
    open_mapper,
)

JOBS = [partial(pow, number, 2) for number in range(7)]
MAPPERS = [SerialMapper, pytest.param(partial(ProcessMapper, 2), marks=pytest.mark.slow)]


def withheld() -> bool:
    """True where Ctrl-C does not reach this process, or there are no masks of signals."""
    if not hasattr(signal, "pthread_sigmask"):
        return True
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])


@pytest.fixture(autouse=True)
def unlimited(monkeypatch):
    """A job that runs in this process leaves it no limit of threads."""
    monkeypatch.setattr("vergence.envs.plants._most_threads", 0)


def test_no_jobs_give_no_results():
    assert SerialMapper()([]) == []


@pytest.mark.slow
@pytest.mark.parametrize("make", MAPPERS)
def test_results_come_in_the_order_of_the_jobs_and_progress_counts_to_their_number(make):
    told = []
    mapper = make(progress=lambda done, of: told.append((done, of)))
    *results, own = mapper([*JOBS, withheld])
    assert results == [0, 1, 4, 9, 16, 25, 36]
    assert told == [(done, 8) for done in range(1, 9)]
    # Ctrl-C reaches this process alone, which ends its workers
    assert own or make is SerialMapper


@pytest.mark.parametrize("make", MAPPERS)
def test_a_jobs_error_is_raised_as_it_is(make):
    with pytest.raises(ValueError, match=r"^invalid literal for int"):
        make()([*JOBS, partial(int, "no number"), *JOBS])


def test_there_is_at_least_one_worker():
    with pytest.raises(ConfigurationError, match="workers: expected at least 1, got 0"):
        ProcessMapper(0)


def test_a_cluster_without_ray_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ConfigurationError, match=r"pip install 'vergence\[cluster\]'"):
        RayMapper("127.0.0.1:6379")


def test_one_worker_is_this_process():
    for workers, kind in ((1, SerialMapper), (3, ProcessMapper)):
        with open_mapper(workers) as mapper:
            assert type(mapper) is kind
            assert mapper.workers == workers


def test_a_job_runs_single_threaded_and_prints_beside_the_results(capfd):
    assert _run_single_threaded(partial(bounds, 4096, 1)) == (0, 4096)
    _run_single_threaded(partial(print, "imported"))
    assert capfd.readouterr() == ("", "imported\n")


class NoRay:
    """Stands for Ray and its cluster: runs tasks here, the last one first, when asked."""

    class exceptions:  # noqa: N801  as Ray has it
        class RayError(Exception):
            pass

        class RayTaskError(RayError):
            def __init__(self, cause):
                super().__init__(str(cause))
                self.cause = cause

    def __init__(self, lost=False):
        self.ran, self.joined, self._lost = [], True, lost

    def cluster_resources(self):
        return {"CPU": 2.0}

    def is_initialized(self):
        return self.joined

    def remote(self, **options):
        assert options["max_retries"] > 0
        return lambda task: SimpleNamespace(remote=lambda *words: partial(task, *words))

    def wait(self, pending, num_returns):
        assert num_returns == 1
        return pending[-1:], pending[:-1]

    def get(self, reference):
        self.ran.append(reference)
        if self._lost:
            raise self.exceptions.RayError("node lost")
        try:
            return reference()
        except Exception as error:
            raise self.exceptions.RayTaskError(error) from error

    def shutdown(self):
        self.joined = False


@pytest.fixture
def cluster(monkeypatch):
    def opened(**words):
        ray = NoRay(**words)
        monkeypatch.setattr(jobs, "_join", lambda _address: setattr(ray, "joined", True) or ray)
        return RayMapper("127.0.0.1:1"), ray

    return opened


def test_a_cluster_runs_every_job_once_and_gives_the_results_in_their_order(cluster):
    mapper, ray = cluster()
    assert mapper.workers == 2
    assert mapper(JOBS) == [0, 1, 4, 9, 16, 25, 36]
    assert len(ray.ran) == len(set(ray.ran)) == 7


def test_a_cluster_is_left_after_a_jobs_own_error_and_joined_again(cluster):
    mapper, ray = cluster()
    with pytest.raises(ValueError, match=r"^invalid literal for int"):
        mapper([partial(int, "no number")])
    assert not ray.joined
    assert mapper([partial(pow, 2, 3)]) == [8]


def test_a_job_whose_nodes_are_all_lost_is_an_error_of_the_cluster(cluster):
    with pytest.raises(VergenceError, match="expected every job to finish on some node, got node"):
        cluster(lost=True)[0](JOBS)


def test_a_node_with_other_versions_is_refused(monkeypatch):
    monkeypatch.setattr(jobs, "package_versions", lambda: {"numpy": "0.1", "scipy": "1"})
    with pytest.raises(ConfigurationError, match=r"same versions on every node .* of numpy$"):
        jobs._remote(partial(pow, 2, 2), {"numpy": "0.2", "scipy": "1"})


def test_the_address_of_a_cluster_is_a_host_and_a_port():
    for address in ("", "auto", "127.0.0.1", "host:port", "host:99999"):
        with pytest.raises(ConfigurationError, match="expected HOST:PORT"):
            RayMapper(address)


def test_a_mapper_is_closed_also_after_a_failure(monkeypatch):
    closed = []
    monkeypatch.setattr(SerialMapper, "close", lambda mapper: closed.append(mapper))

    def fail() -> None:
        with open_mapper(1) as mapper:
            mapper([partial(int, "no number")])

    with pytest.raises(ValueError, match="no number"):
        fail()
    assert len(closed) == 1


@pytest.mark.nightly
def test_calling_off_what_is_left_warns_of_nothing(capfd):
    def refuse(done: int, of: int) -> None:
        raise ConfigurationError("no more")

    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        with pytest.raises(ConfigurationError, match="no more"):
            ProcessMapper(2, progress=refuse)([partial(pow, 2, number) for number in range(40)])
        gc.collect()
    assert [str(warning.message) for warning in warned] == []
    assert capfd.readouterr().err == ""
