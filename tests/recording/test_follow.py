"""A follower returns what a growing log holds, once, and leaves the writer and its file alone."""

import logging
import math
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.naming import named
from tests.recording.logged import HEAD
from vergence.envs.reading import Reading, Truth
from vergence.errors import ConfigurationError, UnreadableFileError
from vergence.recording import schema
from vergence.recording.follow import LogFollower, newest_log
from vergence.recording.growing import GrowingFile
from vergence.recording.log import read_log
from vergence.recording.schema import LoggedCommand, LoggedDetection
from vergence.recording.writer import LogWriter

mcap_writer = pytest.importorskip("mcap.writer")

PERIOD_S = 0.1
STEPS = 30
"""Periods of a trial of the short log."""


class Clock:
    """A clock that stands still until it is set."""

    now_s = 100.0

    def __call__(self):
        return self.now_s


def log_trial(log, clock, steps):
    """Log a trial, flushed after every period."""
    begun_s = clock.now_s
    log.begin()
    for step in range(steps + 1):
        time_s = PERIOD_S * step
        clock.now_s = begun_s + time_s
        if step:
            log.command(LoggedCommand(clock.now_s, np.full(7, time_s), np.zeros(7), "go", "policy"))
        log.joints(clock.now_s, np.full(7, time_s), np.zeros(7))
        log.reading(Reading.empty(1)._replace(time_s=np.array([time_s])), begun_s)
        log.truth(Truth.unknown(1)._replace(time_s=np.array([time_s])))
        log.detection(
            LoggedDetection("right", clock.now_s - 0.05, clock.now_s, np.zeros(7), np.ones(2),
                            np.ones(2), np.ones((4, 2)), np.ones((4, 2)))
        )  # fmt: skip
        log.sync()


def open_log(path, clock, **options):
    return LogWriter(path, head=HEAD, config="# a robot", clock=clock, **options)


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    """A closed log of two trials, images in the second, and a fault."""
    path, clock = tmp_path_factory.mktemp("follow") / "run.mcap", Clock()
    with open_log(path, clock) as log:
        log_trial(log, clock, STEPS)
        logging.getLogger("vergence.hardware").warning("a servo is %s", "hot")
        clock.now_s += 1.0
        log_trial(log, clock, STEPS)
        for number in range(6):
            image = np.full((48, 64), 40 + number, np.uint8)
            log.image(number % 2, image, clock.now_s - 0.1 * (6 - number))
        log.stopped("bus: gone")
    return path


def places_of(path):
    """Places of all records of a file."""
    with closing(GrowingFile(path)) as file:
        return list(file.places())


def gathered(events):
    """All events of some calls, by kind; the newest image of each eye."""
    found = defaultdict(list)
    for one in events:
        for name in ("readings", "truths", "commands", "detections", "stop_reasons", "notes"):
            found[name] += getattr(one, name)
        for eye, image in enumerate(one.images):
            if image is not None:
                found["images", eye] = image
    return found


def assert_same(rows, others):
    """Tuples of arrays and texts are equal."""
    for one, other in zip(rows, others, strict=True):
        for value, expected in zip(one, other, strict=True):
            np.testing.assert_array_equal(value, expected)


def assert_holds(found, log):
    """A follower's events are those of the whole log."""
    numbered = [
        (trial.number, trial.begun_s, step, trial)
        for trial in log.trials
        for step in range(trial.steps + 1)
    ]
    readings = found["readings"]
    assert [one[:2] for one in readings] == [one[:2] for one in numbered]
    of_log = [[field[step, 0] for field in trial.readings] for _, _, step, trial in numbered]
    assert_same([one.reading for one in readings], of_log)
    of_log = [[field[step, 0] for field in trial.truths] for _, _, step, trial in numbered]
    assert_same(found["truths"], of_log)
    assert_same(found["commands"], [one for trial in log.trials for one in trial.commands])
    assert_same(found["detections"], log.detections)
    assert found["stop_reasons"] == list(log.stop_reasons)
    for eye in range(2):
        assert found["images", eye] == log.trials[-1].images[eye][-1]


@settings(max_examples=6)
@given(shares=st.lists(st.floats(0.0, 1.0), max_size=12))
def test_a_log_in_pieces_cut_anywhere_gives_each_event_once(logged, shares):
    data = logged.read_bytes()
    ends = sorted(int(share * len(data)) for share in shares)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        path.touch()
        with LogFollower(path, history_s=math.inf) as follower, path.open("ab", 0) as file:
            events = [follower.poll()]
            for start, end in zip([0, *ends], [*ends, len(data)], strict=True):
                file.write(data[start:end])
                events.append(follower.poll())
            assert follower.closed
            assert follower.ended
            assert follower.poll() is None
    assert_holds(gathered(filter(None, events)), read_log(logged))


def test_an_open_log_gives_what_its_writer_has_flushed(tmp_path):
    clock = Clock()
    log = open_log(tmp_path / "open.mcap", clock, facts={"seed": "7"})
    with log, LogFollower(log.path) as follower:
        assert follower.poll() is None
        assert follower.head.digest == HEAD.digest
        assert follower.config == "# a robot"
        assert follower.facts["seed"] == "7"
        log_trial(log, clock, 3)
        assert len(follower.poll().readings) == 4
        assert follower.poll() is None
        assert not follower.closed
        log.close()
        assert follower.poll() is None
        assert follower.closed


def test_the_log_and_its_folder_stay_as_they_are(logged):
    def state():
        return logged.read_bytes(), logged.stat().st_mtime_ns, os.listdir(logged.parent)

    before = state()
    with LogFollower(logged) as follower:
        follower.poll()
    assert state() == before


def test_a_record_that_is_cut_off_waits_for_its_rest(logged, tmp_path):
    data, path = logged.read_bytes(), tmp_path / "cut.mcap"
    chunk = [place for place in places_of(logged) if place.opcode == 6][STEPS // 2]
    for cut in (chunk.start - 4, chunk.start, chunk.start + chunk.size - 1):
        path.write_bytes(data[:cut])
        with LogFollower(path, history_s=math.inf) as follower:
            before = follower.poll()
            assert follower.poll() is None
            with path.open("ab") as file:
                file.write(data[cut : chunk.start + chunk.size])
            rest = follower.poll()
            assert rest is not None
            assert follower.poll() is None
        times = [float(one.reading.time_s) for part in (before, rest) for one in part.readings]
        np.testing.assert_allclose(times, PERIOD_S * np.arange(len(times)))  # rounded in JSON


def test_only_the_recent_part_of_a_long_log_is_unpacked(tmp_path, monkeypatch):
    unpacked = []
    records = GrowingFile.records

    def counted(file, place):
        unpacked.append(place)
        return records(file, place)

    monkeypatch.setattr(GrowingFile, "records", counted)
    clock, steps = Clock(), 300
    with open_log(tmp_path / "long.mcap", clock) as log:
        log_trial(log, clock, 1)
        log_trial(log, clock, steps)
        with LogFollower(log.path, history_s=2.0) as follower:
            events = follower.poll()
            attached = len(unpacked)
            log_trial(log, clock, 1)
            later = follower.poll()
    times = [float(one.reading.time_s) for one in events.readings]
    # A chunk spans one period, or two where the writer's own flush fell between.
    assert times[0] == pytest.approx(PERIOD_S * steps - 2.0, abs=2 * PERIOD_S)
    assert times[-1] == pytest.approx(PERIOD_S * steps)
    assert {one.trial for one in events.readings} == {2}
    assert [one.trial for one in later.readings] == [3, 3]
    assert attached < 0.4 * steps


def test_images_and_joints_are_the_newest_and_notes_begin_at_warnings(tmp_path, caplog):
    caplog.set_level(logging.INFO, "vergence")
    clock = Clock()
    with open_log(tmp_path / "eyes.mcap", clock) as log, LogFollower(log.path) as follower:
        logging.getLogger("vergence.hardware").info("a servo is warm")
        logging.getLogger("vergence.hardware").warning("a servo is hot")
        for number in range(3):
            log.image(0, np.full((48, 64), 40 + number, np.uint8), 99.0 + number)
            log.joints(99.0 + number, np.full(7, float(number)), np.zeros(7))
        log.sync()
        events = follower.poll()
    left, right = events.images
    assert left.exposed_s == pytest.approx(101.0)
    assert right is None
    assert events.joints.positions[0] == 2.0
    assert [(one.level, one.message) for one in events.notes] == [(3, "a servo is hot")]


def test_the_loss_of_the_file_is_one_error_after_the_last_events(logged, tmp_path):
    path, data = tmp_path / "lost.mcap", logged.read_bytes()
    new = path.with_suffix(".new")
    for reason, change in {
        "it was deleted": path.unlink,
        "it was replaced": lambda: new.replace(path),
        "it became shorter": lambda: os.truncate(path, 100),
    }.items():
        path.write_bytes(data[: len(data) // 2])
        new.write_bytes(data)
        with named(reason), LogFollower(path) as follower:
            assert follower.poll() is not None
            change()
            with pytest.raises(UnreadableFileError, match=rf"lost\.mcap: {reason}"):
                follower.poll()
            assert follower.ended
            assert not follower.closed
            assert follower.poll() is None


def test_garbage_is_one_error_after_the_events_before_it(logged, tmp_path):
    path, data = tmp_path / "garbage.mcap", logged.read_bytes()
    ends = [place.start + place.size for place in places_of(logged)]
    for garbage in (bytes(64), b"not a record of MCAP", b"\x06" + bytes(8)):  # an empty chunk
        path.write_bytes(data[: ends[len(ends) // 2]] + garbage + data)
        with named(garbage), LogFollower(path, history_s=math.inf) as follower:
            assert follower.poll().readings
            with pytest.raises(UnreadableFileError, match=r"garbage\.mcap: it is damaged"):
                follower.poll()
            assert follower.poll() is None


def test_damage_anywhere_is_one_error_of_ours_or_none(logged, tmp_path):
    data, path, rng = logged.read_bytes(), tmp_path / "damaged.mcap", np.random.default_rng(2)
    for _ in range(20):
        damaged = bytearray(data)
        for place in rng.integers(len(data), size=4):
            damaged[place] = rng.integers(256)
        path.write_bytes(damaged)
        errors = 0
        with LogFollower(path, history_s=math.inf) as follower:
            for _ in range(4):
                try:
                    follower.poll()
                except (UnreadableFileError, ConfigurationError):
                    errors += 1
        assert errors <= 1


def test_a_message_that_is_none_of_its_topic_names_file_and_field(tmp_path):
    with open_log(tmp_path / "bad.mcap", Clock()) as log, LogFollower(log.path) as follower:
        log._put(schema.READING, 0.0, {"begun_s": 0.0, "time_s": "soon"})
        log.sync()
        with pytest.raises(ConfigurationError, match=r"bad\.mcap: /reading: time_s: .*got 'soon'"):
            follower.poll()


def test_another_file_is_no_log(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("nothing of the kind")
    for one in (tmp_path / "none.mcap", tmp_path):
        with pytest.raises(UnreadableFileError, match="expected a log of a robot"):
            LogFollower(one)
    with LogFollower(path) as follower, pytest.raises(UnreadableFileError, match="no MCAP file"):
        follower.poll()


@pytest.mark.parametrize(("version", "reason"), [(None, "it has no head"), ("0", "its schema is")])
def test_a_log_without_a_head_or_of_another_schema_is_refused(tmp_path, version, reason):
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = mcap_writer.Writer(file)
        writer.start()
        if version is not None:
            writer.add_metadata(schema.FACTS_RECORD_NAME, {"schema": version})
            writer.add_attachment(0, 0, schema.HEAD_FILE, "application/toml", b"")
        writer.add_message(writer.register_channel("/fault", "json", 0), 0, b'{"text": ""}', 0)
        writer.finish()
    with LogFollower(path) as follower, pytest.raises(UnreadableFileError, match=reason):
        follower.poll()


def test_the_newest_log_is_the_one_written_last(tmp_path):
    assert newest_log(tmp_path / "runs") is None
    assert newest_log(tmp_path) is None
    for number, name in enumerate(("b.mcap", "a.mcap", "c.txt")):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (number, number))
    assert newest_log(tmp_path) == tmp_path / "a.mcap"


def test_following_imports_neither_the_writer_nor_hardware_nor_pictures():
    code = "import sys, vergence.recording.follow; print(*sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy = {"vergence.recording.writer", "vergence.hardware", "vergence.viewer", "cv2", "mujoco"}
    assert heavy & set(found.stdout.split()) == set()
