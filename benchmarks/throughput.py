"""Measure the simulation throughput, relative to MuJoCo's own loop in the same run.

Run ``python benchmarks/throughput.py``, with ``--json FILE`` to keep the table and ``--quick`` for
a short run. The speed of a machine may change from second to second, so the cases take turns for
many short rounds; a ratio is the median of the ratios of a round. The cases and the table are
explained in ``docs/performance.md``.
"""

import argparse
import ctypes
import gc
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import gymnasium
import mujoco
import numba
import numpy as np
from rich.console import Console
from rich.table import Table

import vergence
from vergence.envs import MAX_EPISODE_STEPS
from vergence.eval.trials.scenarios import load_scenario
from vergence.models.mujoco.model import SUBSTEPS, compile_model

HEADS = 1024
REACHERS = 16
POOLED = 256
ENCODER_STEP_RAD = 2 * np.pi / 4096
SPEED_STEP_RAD_S = 0.024
TARGET = {"kind": "static", "point": (0.0, -0.1, 1.0)}

Pass = Callable[[], int]
"""Function that runs some control steps and returns their number."""


@dataclass
class Case:
    """A case to measure."""

    name: str
    what: str
    do: Pass
    microseconds: Callable[[], float] | None = None
    """Function that returns the median time of a step, for cases measured by it."""
    rates: list[float] = field(default_factory=list)
    """Steps per second of each round."""

    def measure(self, seconds: float) -> None:
        """Measure one more round of at least so many seconds."""
        if self.microseconds is not None:
            self.rates.append(1e6 / self.microseconds())
            return
        steps, start = 0, time.perf_counter()
        while True:
            steps += self.do()
            elapsed = time.perf_counter() - start
            if elapsed >= seconds:
                break
        self.rates.append(steps / elapsed)


def sensing_head() -> vergence.HeadModel:
    """Simulated head with its delay and noise, and with 12-bit encoders."""
    return vergence.load_head("simulated").replace(
        sensor={
            "encoder_resolution_rad": ENCODER_STEP_RAD,
            "velocity_resolution_rad_s": SPEED_STEP_RAD_S,
        }
    )


def bare(head: vergence.HeadModel) -> Pass:
    """Case of MuJoCo's step in a compiled loop on one core, with new commands each period."""
    model = compile_model(head, visuals=False)
    data = mujoco.MjData(model)
    step = mujoco_step()
    episodes = 20
    limit = model.actuator_ctrlrange[:, 1]
    rng = np.random.default_rng(0)
    commands = rng.uniform(-limit, limit, (episodes, MAX_EPISODE_STEPS, model.nu))

    @numba.njit
    def episode(model_at: int, data_at: int, ctrl: Any, commands: Any) -> None:
        for k in range(commands.shape[0]):
            for i in range(ctrl.shape[0]):  # a slice would take seconds to compile
                ctrl[i] = commands[k, i]
            for _ in range(SUBSTEPS):
                step(model_at, data_at)

    def do() -> int:
        for one in commands:
            mujoco.mj_resetData(model, data)
            episode(model._address, data._address, data.ctrl, one)
        return episodes * MAX_EPISODE_STEPS

    return do


def mujoco_step() -> Any:
    """C function ``mj_step``, to be called from compiled code."""
    folder = Path(mujoco.__file__).parent
    names = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")
    library = next(path for name in names for path in sorted(folder.glob(name)))
    step = ctypes.CDLL(str(library)).mj_step
    step.argtypes, step.restype = [ctypes.c_void_p, ctypes.c_void_p], None
    return step


def single(env: gymnasium.Env, passes: int = MAX_EPISODE_STEPS) -> Pass:
    """Case of one environment with all wrappers and resets, under random actions."""
    env.reset(seed=0)
    space: Any = env.action_space
    actions = np.random.default_rng(0).uniform(space.low, space.high, (passes, *space.shape))
    actions = actions.astype(space.dtype)

    def do() -> int:
        for action in actions:
            _observation, _reward, terminated, truncated, _info = env.step(action)
            if terminated or truncated:
                env.reset()
        return passes

    return do


def vector(env: Any, num: int, passes: int = MAX_EPISODE_STEPS) -> Pass:
    """Case of a vector environment with its autoreset, under random actions."""
    env.reset(seed=0)
    space = env.single_action_space
    shape = (passes, num, *space.shape)
    actions = np.random.default_rng(0).uniform(space.low, space.high, shape).astype(space.dtype)

    def do() -> int:
        for action in actions:
            env.step(action)
        return len(actions) * num

    return do


def single_reacher() -> Pass:
    """Case of Gymnasium's Reacher."""
    return single(gymnasium.make("Reacher-v5"))


def reachers() -> Pass:
    """Case of Gymnasium's Reachers, stepped one after the other."""
    env = gymnasium.make_vec("Reacher-v5", num_envs=REACHERS, vectorization_mode="sync")
    return vector(env, REACHERS)


def pooled_reachers() -> Pass:
    """Case of EnvPool's Reachers, on its threads."""
    import envpool

    env = envpool.make("Reacher-v5", env_type="gymnasium", num_envs=POOLED)
    env.reset()
    space = env.action_space
    shape = (MAX_EPISODE_STEPS, POOLED, *space.shape)
    actions = np.random.default_rng(0).uniform(space.low, space.high, shape)

    def do() -> int:
        for action in actions:
            env.step(action)
        return len(actions) * POOLED

    return do


def rendered() -> Pass:
    """Case of one head in closed loop on drawn images: episodes with reset and controller."""
    env = gymnasium.make("vergence/Gaze-v0", plant="rendered", target=TARGET)
    layout: Any = env.unwrapped
    controller = vergence.make_controller("ibvs", head=layout.task.head, layout=layout.layout)

    def do() -> int:
        observation, _info = env.reset(seed=0)
        steps, done = 0, False
        while not done:
            action, _state = controller.predict(observation)
            observation, _reward, terminated, truncated, _info = env.step(action)
            steps, done = steps + 1, terminated or truncated
        return steps

    return do


def control_step(calls: int) -> tuple[Pass, Callable[[], float]]:
    """Case of the computations of a deployed loop on one reading of the physical head."""
    head = vergence.load_head("physical")
    controller: Any = vergence.make_controller("ibvs", head=head)
    rng = np.random.default_rng(0)
    q = head.fixate(rng.uniform((-0.2, -0.2, 0.5), (0.2, 0.2, 2.0), (calls, 3)))
    pixels = head.cameras.principal + rng.uniform(-80.0, 80.0, (calls, 2, 2))
    principal = head.cameras.principal

    def step(i: int) -> None:
        error = head.undistort(pixels[i]) - principal
        controller.command(q[i], error)
        vergence.triangulate_gaze(head, q[i])
        vergence.triangulate_views(head, q[i], pixels[i])

    def do() -> int:
        for i in range(calls):
            step(i)
        return calls

    def median_us() -> float:
        times = np.empty(calls)
        for i in range(calls):
            start = time.perf_counter_ns()
            step(i)
            times[i] = time.perf_counter_ns() - start
        return float(np.median(times)) / 1e3

    return do, median_us


def cases(quick: bool) -> Iterator[Case]:
    """All cases; the first is the reference of the ratios."""
    head, passes = sensing_head(), 20 if quick else MAX_EPISODE_STEPS
    gaze = "vergence/Gaze-v0"
    yield Case("bare", "MuJoCo's loop in C, one core", bare(head))
    env = gymnasium.make(gaze, plant="mujoco", head=head)
    yield Case("single_mujoco", "one environment, mujoco", single(env))
    for plant in ("mujoco", "kinematic"):
        many = gymnasium.make_vec(gaze, num_envs=HEADS, plant=plant, head=head)
        name = f"vector_{plant}_{HEADS}"
        yield Case(name, f"{HEADS:,} environments, {plant}", vector(many, HEADS, passes))
    many = gymnasium.make_vec(gaze, num_envs=HEADS, **load_scenario("hardware").env_options())
    what = f"{HEADS:,} environments, kinematic, the loop of hardware"
    yield Case(f"vector_hardware_{HEADS}", what, vector(many, HEADS, passes))
    yield Case("rendered_stereo", "images, detection and IBVS, one head", rendered())
    for name, what, make in (
        ("reacher_single", "Gymnasium's Reacher-v5", single_reacher),
        (f"reacher_sync_{REACHERS}", f"SyncVectorEnv of {REACHERS} Reacher-v5", reachers),
        (f"envpool_reacher_{POOLED}", f"EnvPool's Reacher-v5, {POOLED} at once", pooled_reachers),
    ):
        try:
            do = make()
        except ImportError as error:
            print(f"{name}: left out, {error}", file=sys.stderr)
            continue
        yield Case(name, what, do)
    do, median_us = control_step(200 if quick else 5000)
    yield Case("control_step_us", "undistort, IBVS, both triangulations", do, median_us)


def measure(
    rounds: int, seconds: float, quick: bool, names: Collection[str] = ()
) -> list[dict[str, Any]]:
    """Measure cases in turn, round by round: those named and ``bare``, or all.

    Returns:
        A row per case: name, what, steps_per_s, ratio_to_bare, and median_us where it counts.
    """
    todo = [case for case in cases(quick) if not names or case.name in ("bare", *names)]
    for case in todo:
        case.do()  # triggers compilation
    for _ in range(rounds):
        for case in todo:
            gc.collect()
            case.measure(seconds)
    rows: list[dict[str, Any]] = []
    for case in todo:
        row = {
            "name": case.name,
            "what": case.what,
            "steps_per_s": median(case.rates),
            "ratio_to_bare": median(np.divide(case.rates, todo[0].rates)),
        }
        if case.microseconds is not None:
            row["median_us"] = 1e6 / median(case.rates)
        rows.append(row)
    return rows


def show(rows: list[dict[str, Any]]) -> None:
    """Print the table."""
    table = Table()
    for title in ("name", "what"):
        table.add_column(title)
    for title in ("steps/s", "to bare"):
        table.add_column(title, justify="right")
    for row in rows:
        what = row["what"]
        if "median_us" in row:
            what += f": {row['median_us']:.1f} us"
        table.add_row(
            row["name"], what, f"{row['steps_per_s']:,.0f}", f"{row['ratio_to_bare']:.3f}"
        )
    Console(width=None if sys.stdout.isatty() else 120).print(table)


def write(rows: list[dict[str, Any]], path: Path) -> None:
    """Write the rows atomically."""
    kept = [{key: value for key, value in row.items() if key != "what"} for row in rows]
    with tempfile.NamedTemporaryFile(
        "w", dir=path.absolute().parent, prefix=f".{path.name}.", delete=False
    ) as file:
        file.write(json.dumps(kept, indent=1) + "\n")
    os.chmod(file.name, 0o644)
    os.replace(file.name, path)


def main(arguments: list[str] | None = None) -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, metavar="FILE", help="file to write the table to")
    parser.add_argument("--rounds", type=int, default=40, help="number of rounds")
    parser.add_argument("--seconds", type=float, default=0.2, help="least time of a case a round")
    parser.add_argument("--quick", action="store_true", help="one short round: not for comparing")
    parser.add_argument("names", nargs="*", help="cases to measure beside bare; default: all")
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)  # the images are too small for several threads
    rounds, seconds = (1, 0.0) if options.quick else (options.rounds, options.seconds)
    rows = measure(max(rounds, 1), seconds, options.quick, options.names)
    show(rows)
    if options.json is not None:
        write(rows, options.json)


if __name__ == "__main__":
    main()
