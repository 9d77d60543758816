"""`vergence collect`: what it prints, what it writes, and how it refuses."""

import sys
from types import ModuleType

import numpy as np
import pytest

import vergence
from tests.commands.called import call, refused
from tests.naming import named
from vergence.calibration.head.recording import read_recording
from vergence.calibration.head.simulated import SimulatedLooker, board_ahead

pytest.importorskip("mcap")
BOARD = ("--target", "checkerboard:9x6:24")
SHORT = (*BOARD, "--head", "physical", "--poses", "3", "--frames", "2")


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_it_records_says_what_is_there_and_how_to_go_on(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "recording"
    (tmp_path / "calibrated.toml").touch()
    assert call("collect", folder, *SHORT) == 0
    out, err = capsys.readouterr()
    assert out.splitlines()[0] == "6 frames of 3 poses, 1 placement of the board"
    assert "next:" not in out  # too few poses for a calibration
    assert "run this again with --moved" in err
    assert call("collect", folder, *SHORT, "--moved", "--distance", "1.5") == 0
    out = capsys.readouterr().out
    assert out.startswith("12 frames of 6 poses, 2 placements of the board")
    assert len(read_recording(folder, vergence.load_head("physical")).files) == 2
    proposed = out.splitlines()[-1].removeprefix("next: vergence ")
    assert proposed == f"calibrate head {folder} --head physical --out calibrated-2.toml"
    assert call(*proposed.split()) == 0


@pytest.mark.slow
def test_it_says_from_ten_poses_on_how_surely_depth_would_be_known(tmp_path, capsys):
    words = ("--poses", "12", "--until", "9", "--errors", "1")
    assert call("collect", tmp_path / "r", *SHORT, *words) == 0
    out, err = capsys.readouterr()
    assert "depth will be known to 0." in out
    assert "% at 2.5 m" in out
    assert "10 poses: depth known to" in err
    assert "of 10 poses" in out  # enough by then


def test_frames_of_another_head_are_not_mixed_with_those_that_are_there(tmp_path, capsys):
    folder = tmp_path / "r"
    assert call("collect", folder, *SHORT, "--errors", "1") == 0
    assert call("collect", folder, *SHORT, "--errors", "1", "--seed", "1", "--moved") == 2
    assert "expected the head that it holds frames of" in capsys.readouterr().err


@pytest.mark.slow
def test_a_detector_finds_the_board_in_drawn_images(tmp_path, capsys):
    words = ("--head", "turrets", "--poses", "2", "--frames", "2", "--plant", "rendered")
    assert call("collect", tmp_path / "r", *BOARD, *words) == 0
    frames = read_recording(tmp_path / "r", vergence.load_head("turrets")).frames
    assert frames.seen.all()
    # a detector states a deviation of its own for each corner
    assert len(np.unique(frames.sigma)) > 10


@pytest.mark.slow
def test_the_same_seed_makes_the_same_recording(tmp_path):
    words = (*BOARD, "--head", "physical", "--poses", "1", "--frames", "1", "--errors", "1")
    digests = set()
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        assert call("collect", tmp_path / name, *words, "--seed", seed) == 0
        digests.add(read_recording(tmp_path / name, vergence.load_head("physical")).sha256)
    assert len(digests) == 2


def test_a_robot_is_made_of_its_configuration_and_closed_in_the_end(tmp_path, capsys, monkeypatch):
    config = tmp_path / "desk.toml"
    config.write_text('head = "physical"')
    made = []

    class RobotLooker(SimulatedLooker):
        def __init__(self, path, target):
            head = vergence.load_head("physical")
            super().__init__(head, target, board_ahead(head, target, 0.7), np.random.default_rng(0))
            made.append((self, path, str(target)))
            self.closed = False

        def close(self):
            self.closed = True

    module = ModuleType("vergence.hardware.robot")
    module.RobotLooker = RobotLooker
    monkeypatch.setitem(sys.modules, module.__name__, module)
    words = (*SHORT[:2], *SHORT[4:], "--poses", "6", "--plant", "hardware", "--config", config)
    assert call("collect", tmp_path / "r", *words) == 0
    assert "--head physical" in capsys.readouterr().out
    line = refused(capsys, "collect", tmp_path / "r", *words, "--head", "turrets")
    assert "expected that of" in line
    assert [(path, target) for _, path, target in made] == [(config, BOARD[1])] * 2
    assert all(looker.closed for looker, _, _ in made)


def test_ctrl_c_says_that_the_frames_are_kept(tmp_path, capsys, monkeypatch):
    looks = []
    look = SimulatedLooker.look

    def interrupted(self, q):
        looks.append(q)
        if len(looks) == 5:
            raise KeyboardInterrupt
        return look(self, q)

    monkeypatch.setattr(SimulatedLooker, "look", interrupted)
    assert call("collect", tmp_path / "r", *SHORT) == 130
    assert "keeps the frames that it has; the same command goes on" in capsys.readouterr().err
    frames = read_recording(tmp_path / "r", vergence.load_head("physical")).frames
    assert len(frames.time_s) == 3


def test_wrong_input_ends_in_one_line_and_exit_code_2(tmp_path, capsys):
    folder = tmp_path / "r"
    for words, said in (
        (("--target", "tag:36h11"), "expected one tag, with its number"),
        ((*BOARD, "--distance", "nan"), "distance: expected 0.05 to 50 metres, got nan"),
        ((*BOARD, "--config", "desk.toml"), "config: expected --plant hardware"),
        ((*BOARD, "--plant", "hardware"), "config: expected the file that describes the robot"),
        ((*BOARD, "--plant", "hardware", "--errors", "1"), "errors: expected a simulated head"),
        ((*BOARD, "--distance", "0.06"), "found it in no direction"),
    ):
        with named(words, said):
            assert said in refused(capsys, "collect", folder, *words)
            assert list(tmp_path.iterdir()) == []
