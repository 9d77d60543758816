"""Control rates from 50 to 250 Hz: the same motion, the same images, a loop that settles."""

import numpy as np
import pytest

from tests.controllers.loops import begin, true_errors
from tests.envs.everything import EVERYTHING
from tests.envs.plants.trajectory import motion_of, swing
from tests.envs.trials import start_of, steps
from vergence import make_controller
from vergence.envs.plant import make_plant
from vergence.envs.task import GazeTask
from vergence.models import HeadModel


def at(head: HeadModel, control_hz: float) -> HeadModel:
    """The head with another control rate and all else as it is: 60 frames a second, 67 ms late."""
    return head.replace(timing={"control_rate_hz": control_hz, "frame_rate_hz": 60.0})


@pytest.mark.parametrize(
    ("control_hz", "plant_name", "within_rad"),
    [(77.0, "kinematic", 1e-9), (50.0, "mujoco", 1e-4), (250.0, "mujoco", 1e-4)],
)
def test_joints_follow_as_their_equation_says(exact, control_hz, plant_name, within_rad) -> None:
    head, count = at(exact, control_hz), int(0.3 * control_hz)
    commands = swing(count, head.timing.period_s)
    own = {"neck": "welded"} if plant_name == "mujoco" else {}
    plant = make_plant(plant_name, head, 1, **own)
    _r, q, _v = steps(plant, start_of(), count, lambda k: commands[k])
    motion = motion_of(head, commands)
    expected = np.array([motion(k * head.timing.period_s)[0] for k in range(count + 1)])
    assert q[:, 0] == pytest.approx(expected, abs=within_rad)


@pytest.mark.parametrize(
    ("control_hz", "plant_name"), [(50.0, "kinematic"), (77.0, "mujoco"), (250.0, "kinematic")]
)
def test_the_articles_law_settles_at_every_rate(exact, control_hz, plant_name) -> None:
    head = at(exact, control_hz)
    task = GazeTask(6, head=head, plant=plant_name)
    errors = true_errors(task, make_controller("ibvs", head, task.layout, gain=3.0), 2.0)
    assert np.linalg.norm(errors[-1], axis=-1).max() < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("control_hz", "plant_name"), [(77.0, "kinematic"), (50.0, "mujoco"), (250.0, "mujoco")]
)
def test_everything_can_be_drawn_at_every_rate(simulated, control_hz, plant_name) -> None:
    head, num = at(simulated, control_hz), 8
    task = begin(GazeTask(num, head=head, plant=plant_name, variation=EVERYTHING))
    seen = np.zeros(num, dtype=int)
    for step in range(int(1.0 * control_hz)):
        task.step(np.tile(0.1 * np.sin(7.0 * step / control_hz + np.arange(4.0)), (num, 1)))
        assert np.isfinite(task.observation).all()
        seen += task.reading.visible.any(axis=1)
        late = task.reading.time_s - task.reading.received_s
        assert (late[np.isfinite(late)] >= -1e-9).all()
    conditions = task.plant.conditions
    # so many frames of a second come as the clock gives, less those that are dropped or on the way
    frames = conditions.frame_rate_hz / (1.0 + conditions.clock_drift)
    lost = 4 * np.sqrt(frames * 0.21) + 1 + 0.03 * frames
    expected = frames * (1.0 - conditions.dropped_frame_probability)
    assert (np.abs(task.reading.frame - expected) < lost).all()
    assert (seen > 0).all()
