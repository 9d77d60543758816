"""A robot that looks at a board, on an emulated head that differs from its model."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from tests.hardware.emulated import REAL_TIME, emulated
from vergence import load_head
from vergence.eval.trials.twin_errors import TWIN_SPREADS
from vergence.hardware.config import load_hardware
from vergence.hardware.emulator.client import WorldClient
from vergence.hardware.emulator.server import parse_sized_board, tilted_board_pose
from vergence.hardware.robot import RobotLooker
from vergence.recording.events import Looker

pytestmark = [*REAL_TIME, pytest.mark.nightly]

BOARD = parse_sized_board("checkerboard:9x6:24")
HEAD = load_head("turrets")
SEED, SCALE = 4, 0.5
TRUE = HEAD.perturbed(np.random.default_rng(SEED), TWIN_SPREADS.scaled(SCALE))
CORNERS = np.column_stack([BOARD.corners_m, np.zeros(len(BOARD.corners_m)), np.ones(54)])
T_0_T = tilted_board_pose(HEAD, BOARD, 0.7)
TURNS = np.array([[0, 0, 0, 0], [0.1, 0.05, 0.1, -0.1], [0.104, 0.046, 0.1, -0.1],
                  [-0.2, 0.1, -0.1, 0.1], [0.1, -0.15, -0.2, -0.1]])  # fmt: skip
ASIDE = np.array([0, 0, 0, 1.2, 0, 0, 0])


def projected(q: np.ndarray) -> np.ndarray:
    """(2, n, 2) px, where the true head has the board's corners."""
    points = CORNERS @ T_0_T.T @ np.linalg.inv(TRUE.base_pose(q)).T
    return np.stack([TRUE.project(q, point[:3]) for point in points], axis=1)


def test_sights_are_those_of_the_true_head_at_its_angles(tmp_path: Path) -> None:
    options = ["--board", str(BOARD), "--errors", str(SCALE), "--seed", str(SEED)]
    with (
        emulated(tmp_path, *options) as (desk, _process),
        closing(WorldClient(load_hardware(desk).emulator_address)) as world,
        closing(RobotLooker(desk, BOARD)) as looker,
    ):
        _known: Looker = looker
        for turn in TURNS:
            q = HEAD.rest() + np.array([0, 0, 0, *turn])
            sight = looker.look(q)
            true_q = np.array(world.ask({"state": None})["positions"])
            assert np.abs(true_q - q).max() < 0.005
            assert np.abs(sight.positions - true_q).max() < HEAD.sensor.encoder_resolution_rad
            beside_px = sight.corners_px - projected(true_q)
            assert np.sqrt(np.mean(beside_px**2)) < 0.07
            assert np.abs(beside_px).max() < 0.3
        aside = looker.look(HEAD.rest() + ASIDE)
        assert aside.corners_px[0] is None
        assert aside.corners_px[1] is not None
