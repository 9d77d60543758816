"""The report of a calibration: whole in itself, of one camera and of two."""

from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from tests.calibration.rigs import as_calibrated, look, make_poses, make_rig
from vergence.calibration.advice import advise_next_photographs
from vergence.calibration.report import write_run
from vergence.reporting.runs import run_folder_command


class Page(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.text, self.figures, self.links = "", [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if tag == "svg":
            self.figures.append(values["aria-label"])
        self.links += [values[name] for name in ("src", "href", "xlink:href") if name in values]

    def handle_data(self, data):
        self.text += f"{' '.join(data.split())} "


@pytest.fixture(scope="module")
def pair():
    """Two cameras and 24 pairs, of which one was left out and one has a right image only."""
    rng = np.random.default_rng(0)
    rig, poses = make_rig(), make_poses(rng, 24)
    seen = look(rig, poses, rng)
    pixels = seen.pixels.copy()
    pixels[0, np.flatnonzero(seen.usable.all(axis=0))[-1]] = np.nan
    found = as_calibrated(rig, poses, replace(seen, pixels=pixels), dropped=[0])
    return replace(found, lens_errors={"brown-conrady": 1.0, "fisheye": 1.4})


@pytest.mark.nightly
def test_the_report_of_a_pair_is_one_file_with_all_figures(pair, tmp_path):
    write_run(tmp_path, pair, "", "pair.toml")
    page = Page((tmp_path / "calibration.html").read_text(encoding="utf-8"))
    each = ("residuals", "radius", "coverage", "directions")
    eyes = {f"{kind}-{eye}" for kind in each for eye in ("left", "right")}
    both = {"tilts", "distances", "views", "depth", "depth-relative"}
    assert set(page.figures) == eyes | both
    assert [link for link in page.links if not link.startswith(("#", "data:"))] == []
    assert run_folder_command(tmp_path) == "calibrate"


@pytest.mark.slow
def test_it_says_the_baseline_what_was_left_out_and_what_to_do(pair, tmp_path, undrawn):
    write_run(tmp_path, pair, "", "pair.toml")
    text = Page((tmp_path / "calibration.html").read_text(encoding="utf-8")).text
    baseline, sigma = pair.baseline_mm
    assert f"The baseline is {baseline:.2f} ± {sigma:.2f} mm" in text
    assert f"the baseline is {1.01 * baseline:.2f} mm" in text
    assert all(one.view in text and one.why in text for one in pair.dropped)
    assert "the board was not found; the right image went in" in text
    assert all(line in text for line in advise_next_photographs(pair))


@pytest.mark.slow
def test_one_camera_has_a_report_without_a_baseline(tmp_path, undrawn):
    rng = np.random.default_rng(0)
    rig, poses = make_rig(), make_poses(rng, 12)
    seen = look(rig, poses, rng).select_camera(0)
    write_run(tmp_path, as_calibrated(rig.alone(0), poses, seen), "", "camera.yaml")
    page = Page((tmp_path / "calibration.html").read_text(encoding="utf-8"))
    assert "The focal length is" in page.text
    assert "baseline" not in page.text
    assert "views-camera" not in page.figures
    assert "directions-camera" in page.figures
