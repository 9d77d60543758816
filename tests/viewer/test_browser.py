"""Dragging, choosing and scrubbing in the browser; the page complains of nothing."""

import threading
from contextlib import contextmanager

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.eval.reporting.browser import CHROMIUM
from tests.recording.logged import log_trials
from vergence.models.files.head_file import load_head

pytest.importorskip("viser")

from tests.viewer.chromium import Chromium
from tests.viewer.served import served  # noqa: F401
from vergence.viewer.browser import address_of
from vergence.viewer.playback import Playback
from vergence.viewer.playground import Playground
from vergence.viewer.recorded import load_recorded
from vergence.viewer.simulated import Setup

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not CHROMIUM, reason="no Chromium to open the page in"),
]
VISERS_OWN = "THREE.Clock: This module has been deprecated"
"""Warning of the page's 3D library about itself."""


@contextmanager
def running(shown):
    """Something shown, in a thread of its own."""
    ended = threading.Event()
    thread = threading.Thread(target=shown.run, args=(ended.is_set,))
    thread.start()
    try:
        yield shown
    finally:
        ended.set()
        thread.join()


@contextmanager
def page_of(server, folder):
    """The page in a browser, which must complain of nothing and ask for nothing outside."""
    with Chromium(folder) as browser:
        browser.open(address_of(server))
        browser.wait(lambda: "mm" in browser.text() and server.get_clients())
        yield browser
        assert [said for said in browser.console if VISERS_OWN not in said] == []
        own = (address_of(server), "data:", f"blob:{address_of(server)}")
        assert [url for url in browser.requests if not url.startswith(own)] == []


def place_on_page(server, browser, point):
    """Pixel of the page at which a point of the scene is shown."""
    (client,) = server.get_clients().values()
    camera = client.camera
    seen = Rotation.from_quat(camera.wxyz, scalar_first=True).inv().apply(point - camera.position)
    left, top, width, height = browser.evaluate(
        "[...document.querySelectorAll('canvas')].map(c => c.getBoundingClientRect())"
        ".sort((a, b) => b.width * b.height - a.width * a.height)"
        ".map(b => [b.x, b.y, b.width, b.height])[0]"
    )
    focal = 0.5 * height / np.tan(0.5 * camera.fov)
    middle = np.array([left + 0.5 * width, top + 0.5 * height])
    return middle + focal * seen[:2] / seen[2]


def resting_place_on_page(server, browser, point):
    """Such a pixel once the page has come to rest: panels slide in, the camera takes its place."""
    places = []

    def rests():
        browser.draw()
        places.append(place_on_page(server, browser, point))
        return len(places) > 10 and np.ptp(places[-10:], axis=0).max() < 0.5

    browser.wait(rests)
    return places[-1]


def test_the_target_is_dragged_and_the_law_chosen(served, tmp_path):  # noqa: F811
    setup = Setup(head=load_head("turrets"), plant="kinematic")
    playground = Playground(served, setup, mode="by hand")
    with running(playground), page_of(served, tmp_path) as browser:
        handles = playground.view.scene.target
        tip = np.array(handles.position) + [0.0, 0.0, 0.6 * handles.scale]
        x, y = resting_place_on_page(served, browser, tip)
        before = playground.simulated.target
        browser.mouse("mouseMoved", x, y)
        browser.mouse("mousePressed", x, y)
        for step in range(1, 9):
            browser.mouse("mouseMoved", x, y - 8 * step)
        browser.mouse("mouseReleased", x, y - 64)
        browser.wait(lambda: np.linalg.norm(playground.simulated.target - before) > 0.02)
        browser.wait(lambda: playground.simulated.settled_s is not None)
        moved = playground.simulated.target - before
        assert moved[1] < -0.02  # up: y of N points down
        assert abs(moved[1]) > 3.0 * np.abs(moved[[0, 2]]).max()

        browser.click(*browser.place_of("input", "saccade"))
        browser.wait(lambda: "delay-compensated" in browser.text())
        browser.click(*browser.place_of("[role=option]", "ibvs"))
        browser.wait(lambda: playground.simulated.setup.controller == "ibvs")

        browser.click(*browser.place_of("input", "turrets"))
        browser.wait(lambda: "physical" in browser.text())
        browser.click(*browser.place_of("[role=option]", "icub"))
        browser.wait(lambda: "eyes_tilt" in browser.text())


def test_a_log_is_scrubbed(served, tmp_path):  # noqa: F811
    pytest.importorskip("mcap")
    log_trials(tmp_path / "run.mcap")
    playback = Playback(served, load_recorded(tmp_path / "run.mcap"))
    with running(playback), page_of(served, tmp_path) as browser:
        browser.wait(lambda: "of 2" in browser.text())

        def stopped():  # again if a line of text came while the mouse moved
            browser.click(*browser.place_of("button", "gaze on"))
            return not playback.playing

        browser.wait(stopped)
        browser.wait(lambda: "gaze 2 of 2" in browser.text())
        shown = browser.text()
        browser.click(*browser.place_of("button", "back"))
        browser.wait(lambda: browser.text() != shown)
        assert "gaze 1 of 2" in browser.text()
