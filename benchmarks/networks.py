"""Compare the shipped networks with onnxruntime: their actions, and their time in the same run.

Run ``python benchmarks/networks.py`` (needs ``vergence[learned]``). Each network and its ONNX file,
as ``vergence export onnx`` writes it, get the inputs of 10,000 observations, from trials with the
conditions of ``hardware`` in which the law of ``saccade`` turns the eyes. Times are the best of
several rounds in turns, for one head and for 1,024.
"""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from vergence.controllers import make_controller
from vergence.controllers.networks.bundle import POLICY, Bundle, pretrained_bundles, read_bundle
from vergence.controllers.networks.inputs import Inputs
from vergence.controllers.networks.onnx import bundle_as_onnx
from vergence.envs.task import GazeTask, rollout
from vergence.eval.trials.scenarios import load_scenario
from vergence.models.head_file import load_head

HEADS, PERIODS, BATCH = 100, 100, 1024


def inputs_of(bundle: Bundle) -> NDArray[np.float32]:
    """(HEADS * PERIODS, size) inputs of a network on its own head."""
    head = load_head(str(bundle.manifest.head["name"]))
    variation = load_scenario("hardware").variation
    task = GazeTask(HEADS, head=head, plant="kinematic", variation=variation)
    inputs = Inputs(str(bundle.manifest.inputs["kind"]), task.head, task.layout)
    memory = np.tile(inputs.initial(), (HEADS, 1))
    rows: list[NDArray[np.float32]] = []
    law = make_controller("saccade", task.head, task.layout)
    rollout(
        task,
        law,
        PERIODS - 1,
        lambda _step: rows.append(inputs.update(task.layout.decode(task.encoded), memory)[0]),
    )
    return np.concatenate(rows)


def least_us(first: Callable[[], Any], second: Callable[[], Any], calls: int) -> list[float]:
    """Least times of two functions in turns, microseconds."""
    least = [np.inf, np.inf]
    for _ in range(20):
        for place, function in enumerate((first, second)):
            begun = time.perf_counter_ns()
            for _ in range(calls):
                function()
            spent = (time.perf_counter_ns() - begun) / calls / 1e3
            least[place] = min(least[place], spent)
    return least


def main() -> None:
    """Measure and print."""
    columns = ("network", "differ by", "one head (us)", "onnxruntime", "1,024 (us)", "onnxruntime")
    table = Table(*columns, title="networks here and in onnxruntime, on one thread")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    for name, path in pretrained_bundles().items():
        bundle = read_bundle(path)
        network, seen = bundle.network, inputs_of(bundle)
        session = onnxruntime.InferenceSession(bundle_as_onnx(bundle), options)
        y = network(seen)
        ours = y**3 if bundle.manifest.kind == POLICY else ((1 + y) / 2) ** 2
        (theirs,) = session.run(None, {"inputs": seen})
        row = [name, f"{np.abs(ours - theirs).max():.1e}"]
        for rows, calls in ((seen[:1], 500), (seen[:BATCH], 10)):
            both = partial(network, rows), partial(session.run, None, {"inputs": rows})
            row += [f"{one:.1f}" for one in least_us(*both, calls)]
        table.add_row(*row)
    Console().print(table)


if __name__ == "__main__":
    main()
