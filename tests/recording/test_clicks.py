"""Clicks beside a running robot's log."""

import numpy as np

from vergence.recording.clicks import Click, ClickReader, write_click


def test_each_click_is_read_once_and_the_file_goes_with_the_reader(tmp_path):
    log = tmp_path / "one.mcap"
    write_click(log, Click(1, np.array([1.0, 2.0]), 3.0))
    reader = ClickReader(log)
    assert reader.poll() is None  # of an earlier run
    for pixel in ([10.5, 20.0], [30.0, 40.25]):
        write_click(log, Click(1, np.array(pixel), 5.0))
        click = reader.poll()
        assert click is not None
        assert (click.eye, click.pixel.tolist(), click.exposed_s) == (1, pixel, 5.0)
        assert reader.poll() is None
    reader.close()
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_no_viewer_wrote_is_no_click(tmp_path):
    reader = ClickReader(tmp_path / "one.mcap")
    for text in ("", "[1, 2]", "null", '["left", 1, 2, 3]'):
        (tmp_path / "one.click").write_text(text)
        assert reader.poll() is None
