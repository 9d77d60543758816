"""Jobs give the same results in the same order, whoever runs them."""

import gc
import signal
import sys
import warnings
from functools import partial

import pytest

from vergence.envs.plants.threads import bounds
from vergence.errors import ConfigurationError
from vergence.eval.jobs import ProcessMapper, RayMapper, SerialMapper, open_mapper

JOBS = [partial(pow, number, 2) for number in range(7)]
MAPPERS = [SerialMapper, pytest.param(partial(ProcessMapper, 2), marks=pytest.mark.slow)]


@pytest.mark.parametrize("make", MAPPERS)
def test_no_jobs_give_no_results(make):
    assert make()([]) == []


@pytest.mark.parametrize("make", MAPPERS)
def test_results_come_in_the_order_of_the_jobs_and_progress_counts_to_their_number(make):
    told = []
    mapper = make(progress=lambda done, of: told.append((done, of)))
    assert mapper(JOBS) == [0, 1, 4, 9, 16, 25, 36]
    assert told == [(done, 7) for done in range(1, 8)]


@pytest.mark.parametrize("make", MAPPERS)
def test_a_jobs_error_is_raised_as_it_is(make):
    with pytest.raises(ValueError, match=r"^invalid literal for int"):
        make()([*JOBS, partial(int, "no number"), *JOBS])


@pytest.mark.slow
def test_a_worker_steps_its_batches_in_one_thread():
    assert ProcessMapper(2)([partial(bounds, 4096, 1)] * 2) == [(0, 4096)] * 2


def test_there_is_at_least_one_worker():
    with pytest.raises(ConfigurationError, match="workers: expected at least 1, got 0"):
        ProcessMapper(0)


def test_a_cluster_without_ray_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ConfigurationError, match=r"pip install 'vergence\[cluster\]'"):
        RayMapper("127.0.0.1:6379")


@pytest.mark.parametrize(("workers", "kind"), [(1, SerialMapper), (3, ProcessMapper)])
def test_one_worker_is_this_process(workers, kind):
    with open_mapper(workers) as mapper:
        assert type(mapper) is kind
        assert mapper.workers == workers


def test_a_mapper_is_closed_also_after_a_failure(monkeypatch):
    closed = []
    monkeypatch.setattr(SerialMapper, "close", lambda mapper: closed.append(mapper))

    def fail() -> None:
        with open_mapper(1) as mapper:
            mapper([partial(int, "no number")])

    with pytest.raises(ValueError, match="no number"):
        fail()
    assert len(closed) == 1


def withheld() -> bool:
    """True if Ctrl-C is blocked in this process."""
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="no masks of signals")
def test_ctrl_c_reaches_this_process_alone_which_ends_its_workers():
    assert ProcessMapper(2)([withheld] * 4) == [True] * 4
    assert not withheld()


@pytest.mark.slow
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
