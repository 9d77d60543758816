"""A reader of a pipe that leaves early, such as `head`, loses nothing that was to be written."""

import os
import sys

import pytest

from tests.models.files.pairs import opencv_pair, write_opencv
from vergence.cli import main


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "written"),
    [
        (["import", "stereo", "pair.yml", "--out", "desk.toml"], ["desk.toml", "desk.png"]),
        (["info", "--head", "icub", "--figure", "icub.png"], ["icub.png"]),
    ],
)
def test_files_are_written_before_anybody_stops_to_listen(tmp_path, monkeypatch, words, written):
    monkeypatch.chdir(tmp_path)
    write_opencv(tmp_path / "pair.yml", opencv_pair())
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w", buffering=1) as stdout:
        monkeypatch.setattr(sys, "stdout", stdout)
        with pytest.raises(SystemExit):
            main(words)
    assert [name for name in written if not (tmp_path / name).is_file()] == []
