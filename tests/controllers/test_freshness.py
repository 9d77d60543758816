"""Detection of new images: each is used once, whatever its exposure and arrival times."""

from math import ceil

import numpy as np

from tests.controllers.loops import begin
from tests.grids import some_of
from tests.naming import named
from vergence import load_head, make_controller
from vergence.controllers.freshness import is_fresh
from vergence.controllers.outlier_gate import GATE_STATE, OutlierGate
from vergence.controllers.prediction.predictor_state import PREDICTOR_STATE, PREDICTOR_STATE_SIZE
from vergence.envs.observation import AGE_S
from vergence.envs.task import GazeTask

HEAD = load_head("simulated")
PERIOD_S = HEAD.timing.period_s
LATENCY = 8


def predicted_unseen(row: np.ndarray) -> np.ndarray:
    """For how many periods the left eye has not been seen by a predictor, whose row comes first."""
    states = np.ascontiguousarray(row[..., :PREDICTOR_STATE_SIZE]).view(PREDICTOR_STATE)
    return states["unseen_periods"][..., 0, 0]


def accepted_since_s(row: np.ndarray) -> np.ndarray:
    """For how long the left eye's gate has held an accepted detection."""
    gates = np.ascontiguousarray(row[..., : OutlierGate.size]).view(GATE_STATE)
    return gates["eyes"]["accepted_since_s"][..., 0, 0]


USED = {
    "pid": lambda row: accepted_since_s(row) == 0.0,
    "delay-compensated": lambda row: predicted_unseen(row) == 0.0,
    "pursuit": lambda row: predicted_unseen(row) == 0.0,
}


def ages(images: list[tuple[float, int]], steps: int) -> np.ndarray:
    """(steps,) image ages as observations have them, s, of exposures and arrivals in periods."""
    found = np.full(steps, AGE_S)
    for exposed, came in images:
        found[came:] = (np.arange(came, steps) - exposed) * PERIOD_S
    channel = np.minimum(found / AGE_S, 1.0).astype(np.float32)
    return channel.astype(np.float64) * AGE_S


def new(age_s: np.ndarray) -> list[int]:
    """The periods in which there is a new image."""
    before = np.append(AGE_S, age_s[:-1])
    pairs = enumerate(zip(age_s, before, strict=True))
    return [k for k, (age, last) in pairs if is_fresh.py_func(age, last, PERIOD_S)]


def used(name: str, age_s: np.ndarray, starts: np.ndarray | None = None) -> np.ndarray:
    """(steps, n) whether a controller takes in an image, for (steps, n) ages and starts."""
    controller = make_controller(name, head=HEAD)
    fields = controller.layout.fields
    observation = np.zeros((age_s.shape[1], controller.layout.size), dtype=np.float32)
    observation[:, fields["visible"]] = 1.0
    state, taken = None, []
    for k, age in enumerate(age_s):
        observation[:, fields["image_age"]] = age[:, None] / AGE_S
        start = None if starts is None else starts[k]
        _action, state = controller.predict(observation, state, start)
        taken.append(USED[name](state[0]))
    return np.array(taken)


def test_each_image_is_new_once_however_it_is_dated() -> None:
    for offset, interval in some_of([0.0, 0.3, 0.5, 0.9, 1.7], [1, 2, 4]):
        with named(offset, interval):
            came = list(range(LATENCY, 60, interval))
            assert new(ages([(k - LATENCY - offset, k) for k in came], 60)) == came


def test_every_controller_uses_each_image_once_however_it_is_dated() -> None:
    for name in USED:
        with named(name):
            came = list(range(LATENCY, 40, 2))
            offsets = (0.0, 0.3, 0.5, 0.9, 1.7)
            columns = [ages([(k - LATENCY - one, k) for k in came], 40) for one in offsets]
            expected = np.isin(np.arange(40), came)
            assert (used(name, np.stack(columns, axis=1)) == expected[:, None]).all()


def test_a_frame_that_is_dropped_is_not_made_up_for() -> None:
    came = [k for k in range(LATENCY, 80, 4) if k % 3]
    assert new(ages([(k - LATENCY - 0.3, k) for k in came], 80)) == came


def test_an_image_that_stays_is_never_new_again() -> None:
    # beyond 0.5 s the observation no longer tells its age
    assert new(ages([(0.3, LATENCY)], 200)) == [LATENCY]


def test_an_image_that_is_there_when_a_trial_begins_is_new_and_before_the_first_is_none() -> None:
    assert new(np.full(50, AGE_S)) == []
    assert new(ages([(-12.4, 0)], 10)) == [0]


def test_images_that_come_at_irregular_times_are_used_once() -> None:
    for seed in range(2):
        for interval in [2.0, 4.0]:
            with named(seed, interval):
                rng = np.random.default_rng(seed)
                exposed = 0.37 + interval * np.arange(40)
                came = [ceil(time) for time in exposed + 6.0 + rng.uniform(0.0, 1.9, 40)]
                # of two that come within a period the newer one is seen
                found = new(ages(list(zip(exposed, came, strict=True)), 120))
                assert found == sorted(k for k in set(came) if k < 120)


def test_a_head_whose_trial_begins_anew_forgets_the_last_image() -> None:
    for name in USED:
        with named(name):
            running = ages([(k - LATENCY - 0.3, k) for k in range(0, 40, 4)], 40)
            # the second head's new trial begins in period 18, just before a picture is repeated
            ended = np.concatenate([running[:18], running[2:24]])
            starts = np.zeros((40, 2), dtype=np.bool_)
            starts[0] = starts[18, 1] = True
            taken = used(name, np.stack([running, ended], axis=1), starts)
            assert np.flatnonzero(taken[:, 0]).tolist() == list(range(0, 40, 4))
            assert np.flatnonzero(taken[:, 1]).tolist() == [0, 4, 8, 12, 16, 18, 20, 24, 28, 32, 36]


def test_on_a_grid_of_time_each_image_of_a_late_head_is_new_once() -> None:
    task = begin(GazeTask(1, head=HEAD, plant="tests.envs.robot:Late"))
    age_s, frames = [], []
    for _ in range(2000):
        task.step(np.zeros((1, 4)))
        channel = task.observation[0, task.layout.fields["image_age"]]
        age_s.append(float(channel.item()) * AGE_S)
        frames.append(int(task.reading.frame[0]))
    came = np.flatnonzero(np.diff(frames, prepend=0) > 0)
    assert len(came) > 800
    assert new(np.array(age_s)) == came.tolist()
