"""Jobs on a Ray cluster: the same table, also when a node is lost in the middle."""

import contextlib
import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import pytest

from vergence.errors import ConfigurationError
from vergence.eval.article.experiment import load_experiment, resolve_config
from vergence.eval.jobs import RayMapper, SerialMapper

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("ray") is None, reason="Ray is not installed"
)
_LIMIT_S = 150.0


class Nodes(NamedTuple):
    """A cluster that runs."""

    address: str
    second: str
    """The second node's id."""
    kill_second: Callable[[], None]


@pytest.fixture(scope="module")
def nodes() -> Iterator[Nodes]:
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

    def kill_second() -> None:
        stdin.write("kill\n")
        stdin.flush()
        assert stdout.readline() == "killed\n"

    watchdog = threading.Timer(_LIMIT_S, _end, (process, folder))
    watchdog.start()
    try:
        address, second = stdout.readline().split()
        yield Nodes(address, second, kill_second)
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
def mapper(nodes) -> Iterator[RayMapper]:
    mapper = RayMapper(nodes.address)
    yield mapper
    mapper.close()


def test_an_experiment_survives_the_loss_of_a_node_with_the_same_table(nodes, mapper, tmp_path):
    experiment = load_experiment("time-response")
    overrides = {"delays_frames": (0, 8), "trials": 3, "duration_s": 1.0}
    config = resolve_config(experiment, overrides, quick=True)
    expected = experiment.run(config, 3, SerialMapper())
    begun = tmp_path / "begun"

    def stuck_on_second(job: Callable[[], Any]) -> Any:
        # a job on the node that is to be lost never ends there
        import threading

        import ray

        if ray.get_runtime_context().get_node_id() == nodes_second:
            begun.touch()
            threading.Event().wait()
        return job()

    nodes_second = nodes.second
    killed = []

    def kill_when_begun() -> None:
        while not begun.exists():
            if over.wait(0.05):
                return
        nodes.kill_second()
        killed.append(nodes_second)

    over = threading.Event()
    killer = threading.Thread(target=kill_when_begun)
    killer.start()
    try:
        table = experiment.run(
            config, 3, lambda jobs: mapper([partial(stuck_on_second, job) for job in jobs])
        )
    finally:
        over.set()
        killer.join()
    assert killed
    pd.testing.assert_frame_equal(table, expected, check_exact=True)


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


def test_a_node_with_other_versions_is_refused(mapper, monkeypatch):
    monkeypatch.setattr("vergence.eval.jobs.versions", lambda: {"numpy": "0.1"})
    with pytest.raises(ConfigurationError, match=r"same versions on every node .* numpy"):
        mapper([partial(pow, 2, 2)])


def test_a_place_where_no_cluster_answers_is_refused():
    with pytest.raises(ConfigurationError, match=r"expected a Ray cluster at 127\.0\.0\.1:1, got"):
        RayMapper("127.0.0.1:1")


@pytest.mark.parametrize("address", ["", "auto", "127.0.0.1", "host:port", "host:99999"])
def test_an_address_is_a_host_and_a_port(address):
    with pytest.raises(ConfigurationError, match="expected HOST:PORT"):
        RayMapper(address)
