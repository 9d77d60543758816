"""Compiles what the tests call before they start: `python -m tests.kernels`, in two processes.

Each piece of work calls, in the smallest size, what some tests call. What is missing here is
compiled by the first test that needs it. With `--once` nothing is compiled where this was done
before, for whatever sources. With `--ship` the result is put into the package's folder of shipped
kernels, for all processors of this machine's kind, so that the next wheel carries it.
"""

import contextlib
import io
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Final

import numpy as np

from tests.heads import head_of
from tests.vision.poses import pose
from tests.vision.scenes import rig, scene
from vergence import HeadModel, cli, load_head, make_controller
from vergence.controllers.controller import CONTROLLERS
from vergence.envs.observation import ObservationLayout
from vergence.envs.task import GazeTask
from vergence.eval.gaze import run_gaze
from vergence.eval.gaze_config import GazeConfig
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import load_scenario
from vergence.kernels.cache import PORTABLE_PROCESSORS, SHIPPED, cache_folder, shipped_name
from vergence.vision import Checkerboard, make_detector

DONE: Final = "compiled-for-tests"
"""The file in the kernels' folder that names the sources for which all is there."""
PACKAGE: Final = SHIPPED.parents[1]
SCENARIOS: Final = ("workspace", "hardware", "fast", "double-step", "wander")
"""One of each kind of target and of loop."""


def head_named(name: str) -> HeadModel:
    """One with a motor for each joint of an eye, or one with eyes that are tied."""
    return head_of(name) if name == "tied" else load_head(name)


def laws(name: str) -> None:
    """Every law that fits a head looks at nothing."""
    head = head_named(name)
    for controller in CONTROLLERS:
        if name == "simulated" or "learned" not in controller:
            law = make_controller(controller, head=head)
            law.predict(np.zeros(ObservationLayout.of(head).size, np.float32))


def trials(name: str, scenario: str) -> None:
    """A trial is compared with the fastest that can be."""
    head = head_named(name)
    run_trials(make_controller("ibvs", head=head), load_scenario(scenario), episodes=1, head=head)


def steps(name: str, plant: str) -> None:
    """Two heads make a step on a plant."""
    task = GazeTask(2, plant=plant, head=head_named(name))
    task.begin(np.arange(2), np.zeros(2, np.uint64), np.arange(2, dtype=np.uint64))
    task.step(np.zeros((2, task.layout.count)))


def gaze(name: str) -> None:
    """The eyes of a head turn to a target that they see in images."""
    run_gaze(GazeConfig(head=name, duration_s=0.5))


def info(name: str) -> None:
    """A head is described with what its eyes see."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        cli.main(["info", "--head", name])


def board() -> None:
    """A board is found in an image, and its pose."""
    camera, rendering = rig("simulated")
    target = Checkerboard(columns=5, rows=4, square_m=0.03)
    image = scene(camera, target, pose(0, 0, 1), rendering).image
    found = make_detector(target, camera).detect(image)
    assert found is not None
    assert found.pose is not None


SHARES: Final[tuple[tuple[Callable[[], None], ...], ...]] = (
    (
        partial(laws, "simulated"),
        partial(gaze, "simulated"),
        partial(gaze, "physical"),
        partial(info, "icub"),
        partial(steps, "simulated", "rendered"),
        partial(steps, "simulated", "mujoco"),
        partial(laws, "tied"),
    ),
    (
        partial(steps, "tied", "mujoco"),
        *(partial(trials, head, name) for name in SCENARIOS for head in ("simulated", "tied")),
        partial(gaze, "icub"),
        board,
    ),
)
"""Work of each process; nothing large is compiled in both."""


def ship() -> int:
    """Fill the package's folder of shipped kernels."""
    processor, features = PORTABLE_PROCESSORS[platform.machine()]
    shutil.rmtree(SHIPPED, ignore_errors=True)
    with tempfile.TemporaryDirectory() as cache:
        portable = {"NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": features}
        command = [sys.executable, "-m", "tests.kernels"]
        code = subprocess.call(command, env=os.environ | portable | {"NUMBA_CACHE_DIR": cache})
        if code == 0:
            (compiled,) = Path(cache).iterdir()
            unwanted = shutil.ignore_patterns("*.lock", DONE)
            shutil.copytree(compiled, SHIPPED / shipped_name(), ignore=unwanted)
    return code


def main(words: list[str]) -> int:
    """Let a process do each share, or do the share of that number."""
    if words == ["--ship"]:
        return ship()
    if words and words != ["--once"]:
        for piece in SHARES[int(words[0])]:
            piece()
        return 0
    folder = cache_folder()
    sources = [path.read_bytes() for path in sorted(PACKAGE.rglob("*.py"))]
    version = sha256(b"".join(text for text in sources if b"vergence.kernels" in text)).hexdigest()
    done = None if folder is None else folder / DONE
    if done is None or (done.exists() and (words or done.read_text() == version)):
        return 0
    print("compiling the kernels, once")
    command = [sys.executable, "-m", "tests.kernels"]
    running = [subprocess.Popen([*command, str(share)]) for share in range(len(SHARES))]
    ended = [process.wait() for process in running]
    if any(ended):
        return 1
    done.write_text(version)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
