"""A reader of a pipe that leaves early, such as `head`, loses nothing that was to be written."""

import subprocess
import sys

import pytest

PAIR = """
image_width: 640
image_height: 480
cameraMatrix1: [[600, 0, 320], [0, 600, 240], [0, 0, 1]]
cameraMatrix2: [[600, 0, 320], [0, 600, 240], [0, 0, 1]]
distCoeffs1: [0, 0, 0, 0, 0]
distCoeffs2: [0, 0, 0, 0, 0]
R: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
T: [-0.12, 0, 0]
"""


@pytest.mark.parametrize(
    ("words", "written"),
    [
        (["import", "stereo", "pair.yml", "--out", "desk.toml"], ["desk.toml", "desk.png"]),
        (["info", "--head", "icub", "--figure", "icub.png"], ["icub.png"]),
    ],
)
def test_files_are_written_before_anybody_stops_to_listen(tmp_path, words, written):
    (tmp_path / "pair.yml").write_text(PAIR, encoding="utf-8")
    run = subprocess.Popen(
        [sys.executable, "-m", "vergence", *words], cwd=tmp_path, stdout=subprocess.PIPE
    )
    assert run.stdout is not None
    run.stdout.close()
    run.wait(timeout=300)
    assert [name for name in written if not (tmp_path / name).is_file()] == []
