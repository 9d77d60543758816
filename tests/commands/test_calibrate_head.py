"""`vergence calibrate head`: a head file out of recordings, or a line on why not."""

import json

import numpy as np
import pytest

import vergence
from tests.calibration.head.recordings import log_frames
from tests.commands.called import call, refused
from tests.naming import named
from vergence.calibration.head.simulated import simulate_recording
from vergence.eval.trials.twin_errors import TWIN_SPREADS

pytest.importorskip("mcap")
OPTIONS = {
    "poses": 12, "frames_per_pose": 2, "target": "checkerboard:6x5:40", "distances_m": (0.6, 1.1),
}  # fmt: skip
POINT = np.array([0.1, -0.1, 1.5])


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """A true head, its recording, and one of too few poses."""
    folder = tmp_path_factory.mktemp("recordings")
    head, rng = vergence.load_head("physical"), np.random.default_rng(4)
    true = head.perturbed(rng, TWIN_SPREADS)
    frames = simulate_recording(head, true, rng, **OPTIONS).frames
    for place, name in enumerate(("first", "second")):
        shown = np.flatnonzero(frames.placement == place)
        path = folder / "good" / f"{name}.mcap"
        log_frames(path, head, frames, order=shown, placement=str(place))
    log_frames(folder / "short" / "only.mcap", head, frames, order=range(4))
    return true, folder


def calibrate(*words: object) -> tuple[object, ...]:
    return ("calibrate", "head", *words, "--head", "physical")


def depth_error(head, true):
    q = true.fixate(POINT)
    return (vergence.triangulate_views(head, q, true.project(q, POINT)).point - POINT)[2]


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_recording_becomes_a_head_that_tells_depth(recordings, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    true, folder = recordings
    assert call(*calibrate(folder / "good", "--out", "mine.toml", "--report", "run")) == 0
    said = capsys.readouterr().out
    assert "48 of 48 views in 12 poses, 2 placements of the board" in said
    assert "none needed" in said
    head = vergence.load_head("mine.toml")
    before = abs(depth_error(vergence.load_head("physical"), true))
    assert abs(depth_error(head, true)) < 0.1 * before
    assert head.name == "mine"
    assert head.calibration.views == 48
    assert set(head.calibration.sigma) <= set(head.parameters().names)
    assert {path.name for path in (tmp_path / "run").iterdir()} == {
        "calibration.html", "mine.toml", "result.json", "views.csv",
    }  # fmt: skip
    assert call("info", "--head", "mine.toml") == 0
    assert "checkerboard:6x5:40, 48 views" in capsys.readouterr().out


@pytest.mark.nightly
@pytest.mark.usefixtures("undrawn")
def test_several_recordings_are_heads_by_themselves(recordings, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, folder = recordings
    words = (folder / "good", folder / "short", "--out", "heads", "--report", "run", "--json")
    assert call(*calibrate(*words, "--workers", "1")) == 2
    first, second = json.loads(capsys.readouterr().out)
    assert first["views"] == 48
    assert "at least 6 poses" in second["refused"]
    assert [path.name for path in (tmp_path / "heads").iterdir()] == ["good.toml"]
    assert (tmp_path / "run" / "good" / "calibration.html").exists()
    assert (tmp_path / "run" / "short" / "refused.txt").exists()


@pytest.mark.slow
def test_what_gives_no_head_is_said_in_a_line(recordings, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.toml").write_text("mine")
    good, short, gone = (recordings[1] / name for name in ("good", "short", "gone"))
    for words, message in (
        ((good, "--out", "x.yaml"), "ends in .toml, got x.yaml"),
        ((good, "--out", "there.toml"), "no file of that name"),
        ((short, "--out", "x.toml"), "at least 6 poses"),
        ((good, short, "--out", "x.toml"), "a folder for the head files"),
        ((good, "--out", "x.toml", "--target", "checkerboard:9x6:24"), "checkerboard:6x5:40"),
        ((gone, "--out", "x.toml"), "no such file or folder"),
        ((), "expected a recording, got none"),
        ((good, "--out", "there.toml/x.toml"), "a folder that can be written"),
    ):
        with named(message):
            assert message in refused(capsys, *calibrate(*words))
            assert {path.name for path in tmp_path.iterdir()} == {"there.toml"}
            assert (tmp_path / "there.toml").read_text() == "mine"
