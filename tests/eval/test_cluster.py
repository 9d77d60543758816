"""Jobs on a Ray cluster: the same bytes, also when a node is lost in the middle."""

import contextlib
import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.test_cli import call
from vergence.errors import ConfigurationError
from vergence.eval.comparison.evaluate import EvaluateConfig, Evaluation, evaluate
from vergence.eval.comparison.folder import write_evaluation
from vergence.reporting.jobs import RayMapper

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is not installed"),
]
_LIMIT_S = 400.0


class Nodes(NamedTuple):
    """A cluster that runs, of one node that stays and one that comes and goes."""

    address: str
    add_second: Callable[[], str]
    """Starts the second node and returns its id."""
    kill_second: Callable[[], None]


@pytest.fixture(scope="module")
def nodes() -> Iterator[Nodes]:
    import ray  # noqa: F401 - as TorchRL does: too late for a variable that Ray reads then

    # not pytest's folder: the path of a socket is limited to 107 characters
    folder = Path(tempfile.mkdtemp(prefix="vergence-"))
    (folder / "ray").mkdir()
    environment = {
        **os.environ,
        "RAY_TMPDIR": str(folder),
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    command = [sys.executable, str(Path(__file__).with_name("cluster_nodes.py"))]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        text=True, env=environment,
    )  # fmt: skip
    assert process.stdin is not None
    assert process.stdout is not None
    stdin, stdout = process.stdin, process.stdout

    def ask(word: str) -> str:
        stdin.write(f"{word}\n")
        stdin.flush()
        return stdout.readline().strip()

    watchdog = threading.Timer(_LIMIT_S, _end, (process, folder))
    watchdog.start()
    try:
        yield Nodes(stdout.readline().strip(), partial(ask, "add"), partial(ask, "kill"))
    finally:
        watchdog.cancel()
        with contextlib.suppress(BrokenPipeError):
            stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(20.0)
        _end(process, folder)
        process.wait()
        stdout.close()
        shutil.rmtree(folder, ignore_errors=True)


def _end(process: "subprocess.Popen[str]", folder: Path) -> None:
    """End what the cluster has left running: the processes that know its folder."""
    process.kill()
    for entry in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):
            if f"RAY_TMPDIR={folder}".encode() in entry.read_bytes().split(b"\0"):
                os.kill(int(entry.parent.name), signal.SIGKILL)


@pytest.fixture
def second(nodes) -> Iterator[str]:
    yield nodes.add_second()
    nodes.kill_second()


@pytest.fixture
def mapper(nodes) -> Iterator[RayMapper]:
    mapper = RayMapper(nodes.address)
    yield mapper
    mapper.close()


class LosesTheSecond(RayMapper):
    """Runs jobs on two nodes; the second is killed once the file `begun` tells that it has one."""

    def __init__(self, nodes: Nodes, second: str, begun: Path) -> None:
        super().__init__(nodes.address)
        self.killed = False
        self._nodes, self._second, self._begun = nodes, second, begun

    def __call__(self, jobs: Sequence[Callable[[], Any]]) -> list[Any]:
        killer = threading.Thread(target=self._kill_when_begun)
        self._over = threading.Event()
        killer.start()
        try:
            stuck = [partial(stuck_on, self._second, self._begun, job) for job in jobs]
            return super().__call__(stuck)
        finally:
            self._over.set()
            killer.join()

    def _kill_when_begun(self) -> None:
        while not self._begun.exists():
            if self._over.wait(0.05):
                return
        self._nodes.kill_second()
        self.killed = True


def stuck_on(node: str, begun: Path, job: Callable[[], Any]) -> Any:
    """Run a job, but never end on a node that is to be lost."""
    import ray

    if ray.get_runtime_context().get_node_id() == node:
        begun.touch()
        threading.Event().wait()
    return job()


@pytest.fixture
def losing(nodes, second, tmp_path) -> Iterator[LosesTheSecond]:
    mapper = LosesTheSecond(nodes, second, tmp_path / "begun")
    yield mapper
    mapper.close()
    assert mapper.killed


def files_of(evaluation: Evaluation, folder: Path) -> dict[str, bytes]:
    """Files of an evaluation on its trials that hold no clock times."""
    folder.mkdir()
    write_evaluation(folder, evaluation)
    return {name: (folder / name).read_bytes() for name in ("trials.csv", "curves.csv")}


def test_an_evaluation_survives_the_loss_of_a_node_with_the_same_bytes(losing, tmp_path):
    config = EvaluateConfig(controllers=("ibvs", "saccade"), episodes=3, seed=1)
    here = files_of(evaluate(config), tmp_path / "here")
    assert files_of(evaluate(config, mapper=losing), tmp_path / "there") == here


def test_a_cluster_tunes_to_the_same_bytes(nodes, second, tmp_path, capsys):
    for name, where in (("here", ("--workers", "1")), ("there", ("--cluster", nodes.address))):
        words = ["tune", "pid", "--trials", "4", "--episodes", "5", *where]
        assert call(*words, "--out", str(tmp_path / name)) == 0
    for name in ("history.csv", "tune.json", "tune.svg"):
        assert (tmp_path / "here" / name).read_bytes() == (tmp_path / "there" / name).read_bytes()


def test_a_jobs_own_error_is_raised_as_it_is_and_the_others_are_called_off(mapper):
    import ray

    def fail() -> None:
        raise ConfigurationError("gain: expected a number, got ?")

    def never_end() -> None:
        import threading

        threading.Event().wait()

    with pytest.raises(ConfigurationError, match=r"^gain: expected a number, got \?$"):
        mapper([fail, never_end])
    assert not ray.is_initialized()
    # the next jobs run all the same: a search passes over a point that cannot be
    assert mapper([partial(pow, 2, 3)]) == [8]


def test_a_place_where_no_cluster_answers_is_refused():
    with pytest.raises(ConfigurationError, match=r"expected a Ray cluster at 127\.0\.0\.1:1, got"):
        RayMapper("127.0.0.1:1")
