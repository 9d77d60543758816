"""Metrics of a robot's gazes, here of simulated ones."""

from tests.heads import head_of
from vergence import make_controller
from vergence.envs.task import GazeTask, rollout
from vergence.eval.robot.gazes import RobotGazes
from vergence.recording import Recorder


def test_the_point_of_eyes_that_cannot_converge_is_that_of_their_images() -> None:
    head = head_of("common")
    target = {"kind": "static", "point": [0.05, 0.0, 0.8]}
    task = GazeTask(1, head=head, plant="kinematic", target=target)
    record = Recorder(task, 60)
    rollout(task, make_controller("ibvs", head), 60, record, seed=0)
    gazes = RobotGazes(steps=None)
    gazes.add(task, record)
    (row,) = gazes.rows()
    assert row["point_error_mm"] < 10.0  # some standard deviations of ITPC at this distance
