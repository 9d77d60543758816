"""The film of a gaze: its frames, its length, its formats."""

import cv2
import numpy as np
import pytest
from PIL import Image

from tests.commands.called import call, refused
from vergence.errors import ConfigurationError
from vergence.eval.gaze import run_gaze
from vergence.eval.gaze_config import GazeConfig
from vergence.viewer.film import GazeFilm
from vergence.viewer.film_files import check_film, write_film

LAST_S = 2.0
"""Time for which a film's last frame is shown, s."""


def filmed(path, **options):
    """Film a gaze."""
    config = GazeConfig(plant="kinematic", **options)
    film = GazeFilm(config.duration_s)
    film.write(path, run_gaze(config, watch=film.watch))


def length_and_ends(path):
    """Length of an animation, s, and its first and last frames, RGB."""
    lengths, frames = [], []
    with Image.open(path) as film:
        for k in range(film.n_frames):
            film.seek(k)
            film.load()
            lengths.append(film.info["duration"])
            frames.append(np.asarray(film.convert("RGB")).astype(int))
    return 1e-3 * sum(lengths), frames[0], frames[-1]


@pytest.mark.slow
def test_a_short_gaze_is_shown_slowly_and_its_end_stands_still(tmp_path):
    path = tmp_path / "gaze.webp"
    filmed(path, duration_s=0.05)
    length_s, first, last = length_and_ends(path)
    # 6 control periods of 1/120 s at 20 frames a second
    assert length_s == pytest.approx(6 / 20 + LAST_S)
    assert first.shape == last.shape
    assert first.shape[1] == 800
    assert np.abs(first - last).max() > 100


def test_a_film_lasts_as_long_as_its_frames(tmp_path):
    def frame_at(k):
        return np.full((64, 64, 3), 100 * k, np.uint8)

    for suffix in (".gif", ".webp"):
        write_film(tmp_path / f"film{suffix}", frame_at, [50, 50, 1000])
        length_s, first, last = length_and_ends(tmp_path / f"film{suffix}")
        assert length_s == pytest.approx(1.1)
        assert np.abs(last - first - 200).max() < 5
    write_film(tmp_path / "film.mp4", frame_at, [50, 50, 1000])
    capture, frames = cv2.VideoCapture(str(tmp_path / "film.mp4")), 0
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(20.0)
    while capture.read()[0]:
        frames += 1
    assert frames == 1.1 * 20


@pytest.mark.slow
def test_a_long_gaze_is_shown_in_real_time(tmp_path, monkeypatch):
    written = []
    monkeypatch.setattr("vergence.viewer.film.write_film", lambda *args: written.append(args[2]))
    monkeypatch.setattr("vergence.viewer.film._MOST_FRAMES", 20)
    filmed(tmp_path / "gaze.webp", duration_s=1.5)
    assert 1e-3 * sum(written[0]) == pytest.approx(1.5 + LAST_S)


def test_a_film_that_cannot_be_written_is_refused_before_the_gaze(tmp_path, monkeypatch, capsys):
    (tmp_path / "folder.gif").mkdir()
    monkeypatch.setattr("vergence.eval.gaze.run_gaze", None)
    for name in ("gaze.avi", "gaze", "missing/gaze.gif", "folder.gif"):
        words = ("gaze", "--record", tmp_path / name, "--out", tmp_path / "run")
        assert "record: expected" in refused(capsys, *words)
        assert [one.name for one in tmp_path.iterdir()] == ["folder.gif"]


@pytest.mark.nightly
@pytest.mark.usefixtures("undrawn")
def test_the_command_writes_the_film_and_says_where(tmp_path, capsys):
    path, run = tmp_path / "gaze.gif", tmp_path / "run"
    options = ("--plant", "kinematic", "--duration", 0.1, "--record", path, "--out", run)
    assert call("gaze", *options) == 1  # the eyes do not settle in so short a time
    assert f"film written to {path}" in capsys.readouterr().out
    with Image.open(path) as film:
        assert film.n_frames >= 12
    assert (run / "result.json").exists()


def test_an_interrupted_film_leaves_nothing_behind(tmp_path):
    def frame_at(k):
        if k == 3:
            raise KeyboardInterrupt
        return np.full((64, 64, 3), 10 * k, np.uint8)

    for suffix in (".gif", ".mp4", ".webp"):
        path = tmp_path / f"film{suffix}"
        path.write_bytes(b"the former film")
        with pytest.raises(KeyboardInterrupt):
            write_film(path, frame_at, [50] * 6)
        assert path.read_bytes() == b"the former film"
        path.unlink()
        assert list(tmp_path.iterdir()) == []


def test_a_gif_keeps_saturated_colours(tmp_path):
    frame = np.full((64, 64, 3), 245, np.uint8)
    frame[:8, :8] = colour = (170, 40, 150)
    write_film(tmp_path / "film.gif", lambda _k: frame, [50, 50])
    _length, first, _last = length_and_ends(tmp_path / "film.gif")
    assert np.abs(first[4, 4] - colour).max() < 12
    assert np.abs(first[40, 40] - 245).max() < 3


def test_the_suffix_may_be_in_capitals(tmp_path):
    check_film(tmp_path / "film.GIF")
    with pytest.raises(ConfigurationError, match=r"expected FILE\.gif, \.mp4 or \.webp, got .*png"):
        check_film(tmp_path / "film.png")
