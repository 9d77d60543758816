"""An eye's thread: which images it believes, how it dates them, and when it gives up."""

import numpy as np
import pytest
from numba import typeof

from tests.hardware.fakes import (
    HEAD,
    TAG,
    FakeClock,
    ScriptedCapture,
    blank,
    camera_config,
    with_tag,
)
from tests.hardware.virtual import VirtualRobot
from tests.naming import refused
from vergence.controllers.controller import make_controller
from vergence.envs import plant
from vergence.envs import task as gaze_task
from vergence.errors import HardwareError
from vergence.hardware import cameras
from vergence.hardware.cameras import EyeThread, compile_loop_kernels
from vergence.hardware.drive import JointHistory
from vergence.vision.objects.search import HeadSearch
from vergence.vision.tracking import Tracker

FRAME_S = HEAD.timing.frame_s
BLANK = blank(HEAD)
PACE = [100.0 + FRAME_S * i for i in range(1, 11)]


@pytest.fixture
def eye_of(monkeypatch):
    """An eye that a capture shows images to while the head turns, which runs to their end."""

    def make(capture, clock, search=None, turns=False, **values):
        monkeypatch.setattr(cameras, "open_capture", lambda *_words, **_options: capture)
        history = JointHistory()
        for time_s in (0.0, *PACE):
            history.add(time_s, HEAD.rest() + turns * time_s, np.zeros(7))
        search = search or HeadSearch(TAG, HEAD).eyes[0]
        return EyeThread(camera_config(**values), HEAD, search, history, clock)

    return make


@pytest.fixture
def seen(eye_of):
    def of(times, image=BLANK, script=None, **values):
        clock = FakeClock()
        eye = eye_of(ScriptedCapture(clock, times, image, **(script or {})), clock, **values)
        eye.run()  # in this thread: the script is finite
        return eye

    return of


def test_the_first_burst_is_not_believed(seen):
    burst = [100.0 + 0.001 * i for i in range(1, 30)]
    eye = seen(burst)
    assert not eye.ready
    assert eye.take_searched_images() == []
    pace = [burst[-1] + FRAME_S * i for i in range(1, 9)]
    eye = seen(burst + pace)
    assert eye.ready
    exposed_s = [sight.exposed_s for sight in eye.take_searched_images()]
    assert exposed_s == pytest.approx(np.array(pace[4:]) - 0.1)


def test_an_image_in_a_burst_begins_the_count_anew(seen):
    times = [*PACE[:4], PACE[3] + 0.001]
    for count, ready in ((4, False), (5, True)):
        more = [times[-1] + FRAME_S * i for i in range(1, count + 1)]
        assert seen([*times, *more]).ready == ready


def test_sights_are_dated_by_their_receipt_less_the_latency_and_taken_once(seen):
    eye = seen(PACE, latency_s=0.04)
    sights = eye.take_searched_images()
    assert [sight.ready_s for sight in sights] == PACE[4:]
    assert [one.exposed_s for one in sights] == pytest.approx(np.array(PACE[4:]) - 0.04)
    assert (eye.images, eye.found) == (6, 0)
    assert np.isnan(sights[0].pixel).all()
    assert eye.take_searched_images() == []


class BufferedCapture(ScriptedCapture):
    """Images that wait until they are taken."""

    def grab(self):
        self._clock.now, there = max(self._clock.now, (self._times or [0.0])[0]), bool(self._times)
        del self._times[:1]
        return there


@pytest.mark.slow
def test_images_that_have_waited_while_one_was_searched_are_passed_over(eye_of, monkeypatch):
    clock, times = FakeClock(), [100.0 + FRAME_S * i for i in range(1, 60)]
    search = HeadSearch(TAG, HEAD).eyes[0]
    look = search.look

    def slow(*arguments):
        clock.sleep(2.5 * FRAME_S)
        look(*arguments)

    monkeypatch.setattr(search, "look", slow)
    eye = eye_of(BufferedCapture(clock, times, BLANK), clock, search)
    eye.run()
    dates = [sight.exposed_s + 0.1 for sight in eye.take_searched_images()]
    assert len(dates) > 15
    assert np.abs(np.subtract.outer(dates, times)).min(axis=1) == pytest.approx(0.0, abs=1e-6)


def test_a_target_is_found_in_grey_and_in_colour(seen):
    image, middle = with_tag(HEAD)
    for shown in (image, np.repeat(image[..., None], 3, axis=2)):
        eye = seen(PACE, shown)
        sights = eye.take_searched_images()
        assert eye.found == eye.images == len(sights)
        assert sights[-1].pixel == pytest.approx(middle, abs=1.0)
        assert eye.frame.shape == image.shape
        assert (eye.frame[1:] == image[1:]).all()


@pytest.mark.parametrize(
    ("hangs", "turns", "images"), [(True, True, 1), (True, False, 6), (False, True, 6)]
)
def test_an_image_that_has_not_changed_while_the_eye_turned_is_none(seen, hangs, turns, images):
    eye = seen(PACE, script={"hangs": hangs}, turns=turns)
    assert len(eye.take_searched_images()) == images
    assert eye.newest_received_s == pytest.approx(PACE[3 + images])


def test_an_image_that_cannot_be_decoded_is_none(seen):
    assert seen(PACE, None).take_searched_images() == []


def test_what_ends_the_thread_is_told_outside_with_camera_and_source(seen):
    for image, said in (
        (np.zeros((720, 1280), np.uint8), "expected images of 640 x 480, as turrets has them, got"),
        (np.zeros((480, 640, 2), np.uint8), "expected an array"), (None, "the stream ended"),
    ):  # fmt: skip
        eye = seen(PACE, image, eye=1, source="http://127.0.0.1/right")
        told = rf"cameras\.right: http://127.0.0.1/right: .*{said}"
        refused(told, eye.check, error=HardwareError)


def test_a_stall_is_noticed_after_a_second_and_the_latency(eye_of):
    clock, told = FakeClock(), []
    capture = ScriptedCapture(clock, PACE, BLANK)
    eye, grab = eye_of(capture, clock), capture.grab

    def grab_or_wait():
        if not (there := grab()):
            clock.sleep(1.09)
            eye.check()
            clock.sleep(0.02)
            said = r"left: 7: expected images, got none for 1\.1"
            told.append(refused(said, eye.check, error=HardwareError))
        return there

    capture.grab = grab_or_wait
    eye.run()
    assert told


@pytest.mark.parametrize("started", [False, True])
def test_a_camera_is_released_once_whether_it_was_started_or_not(eye_of, started):
    clock, times = FakeClock(), [100.0 + FRAME_S * i for i in range(1, 10**5)]
    capture = ScriptedCapture(clock, times, BLANK)
    eye = eye_of(capture, clock)
    if started:
        eye.start()
    eye.close()
    if started:
        eye.close()
    assert not eye.is_alive()
    assert capture.released == 1


@pytest.mark.parametrize(
    ("source", "stamped_before_s", "earlier_s"),
    [("7", 0.004, 0.004), ("7", None, 0.0), ("7", -0.5, 0.0), ("http://x/left", 0.004, 0.0)],
)
def test_its_driver_dates_a_local_camera(seen, source, stamped_before_s, earlier_s):
    eye = seen(PACE, script={"stamped_before_s": stamped_before_s}, source=source)
    expected = PACE[-1] - earlier_s - HEAD.timing.latency_s
    assert eye.take_searched_images()[-1].exposed_s == pytest.approx(expected, abs=1e-9)


def test_images_that_a_driver_stamps_a_frame_ago_have_not_waited(seen):
    eye = seen(PACE, script={"stamped_before_s": 1.3 * FRAME_S})
    assert eye.images == 5  # all once they come in pace


@pytest.mark.slow
def test_preparing_compiles_what_a_target_that_comes_later_needs(monkeypatch):
    seen, find = [], Tracker.find

    def watched(tracker, image, **pose):
        seen.append(find(tracker, image, **pose))
        return seen[-1]

    monkeypatch.setattr(Tracker, "find", watched)
    compile_loop_kernels(HEAD, TAG)
    # both eyes' boards are found and followed, and an image without one is searched
    assert [one is not None for one in seen] == [True, True, False] * 2


@pytest.mark.slow
def test_a_robots_trial_calls_the_task_with_types_that_preparing_has_compiled(monkeypatch):
    robot, types = VirtualRobot(monkeypatch), []
    advance = plant.advance_task

    def watched(*arguments):
        types.append(tuple(map(typeof, arguments)))
        return advance(*arguments)

    monkeypatch.setattr(plant, "advance_task", watched)
    monkeypatch.setattr(gaze_task, "make_plant", lambda *_arguments: robot.plant)
    task = gaze_task.GazeTask(1, head=HEAD, plant="hardware")
    task.prepare(make_controller("ibvs", head=HEAD))
    prepared = set(types)
    task.begin(np.arange(1), *np.zeros((2, 1), np.uint64))
    for _ in range(20):
        task.step(np.ones((1, task.layout.count)))
    assert task.reading.frame[0] > 0
    assert len(types) > 40
    assert set(types) == prepared
    task.close()
