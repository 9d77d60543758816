"""All imperfections at once: both plants agree, and a saved state goes on bit by bit."""

import numpy as np
import pytest

from tests.controllers.loops import begin
from tests.envs.everything import EVERYTHING
from vergence.envs.plants.conditions import IMPERFECTIONS, RANGES
from vergence.envs.task import GazeTask

NUM, STEPS = 24, 150


def test_all_that_there_is_to_draw_is_drawn() -> None:
    assert set(EVERYTHING) == {*IMPERFECTIONS, "model_errors"} == {*RANGES, "model_errors"}


@pytest.mark.slow
@pytest.mark.parametrize("target", ["step", "circle"])
def test_both_plants_agree_with_everything_drawn(target) -> None:
    tasks = []
    for plant, own in (("kinematic", {}), ("mujoco", {"neck": "welded"})):
        options = {"variation": EVERYTHING, "plant_options": own, "target": target}
        tasks.append(begin(GazeTask(NUM, plant=plant, **options), 4))
    off, moved, pixels = [], [], []
    # to and fro by some ten degrees
    for action in 0.3 * np.sign(np.sin(0.11 * np.arange(STEPS)[:, None] + [0.0, 1.0, 2.0, 3.0])):
        for task in tasks:
            task.step(np.tile(action, (NUM, 1)))
        ours, theirs = (task.truth() for task in tasks)
        off.append(np.abs(ours.positions - theirs.positions)[:, 3:])
        moved.append(ours.positions[:, 3:])
        one, other = (task.reading for task in tasks)
        # times, faults and noise are functions of the trial alone
        for name in ("frame", "exposure_s", "received_s", "joints_s", "command"):
            a, b = getattr(one, name), getattr(other, name)
            assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
        # but an eye at the smear that blinds it may see or not
        assert (one.visible == other.visible).mean() > 0.9
        both = one.visible & other.visible
        pixels.append(np.abs(one.pixels - other.pixels)[both])
    assert np.ptp(moved, axis=0).max() > 0.2
    # torque that falls with speed and play are looked at four times a period: a quarter of a degree
    assert np.max(off) < 5e-3
    assert np.median(off) < 5e-4
    assert np.median(np.concatenate(pixels)) < 0.5
