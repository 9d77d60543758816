"""A reader of a pipe that leaves early, such as `head`, loses nothing that was to be written."""

import os
import sys

import pytest

from tests.models.files.pairs import opencv_pair, write_opencv
from vergence.cli import main


@pytest.mark.slow
def test_files_are_written_before_anybody_stops_to_listen(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_opencv(tmp_path / "pair.yml", opencv_pair())
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w", buffering=1) as stdout:
        monkeypatch.setattr(sys, "stdout", stdout)
        with pytest.raises(SystemExit):
            main(["import", "stereo", "pair.yml", "--out", "desk.toml"])
    assert {path.name for path in tmp_path.iterdir()} == {"pair.yml", "desk.toml", "desk.png"}
