"""A follower returns what a growing log holds, once, and leaves the writer and its file alone."""

import logging
import math
import os
from itertools import pairwise
from unittest.mock import Mock

import numpy as np
import pytest
from mcap import stream_reader
from mcap.writer import Writer

from tests.hardware.fakes import FakeClock
from tests.naming import named, refused
from tests.recording.logged import HEAD, open_log
from vergence.envs.reading import Reading, Truth
from vergence.errors import UnreadableFileError
from vergence.recording import schema
from vergence.recording.follow import (
    Click,
    ClickReader,
    LogFollower,
    newest_log,
    write_click,
)
from vergence.recording.log import read_log, records_in
from vergence.recording.schema import LoggedCommand

PERIOD_S = 0.1
STEPS = 30


def log_trial(log, clock, steps):
    """Log a trial, flushed after every period."""
    begun_s = clock.now
    log.begin()
    for step in range(steps + 1):
        time_s = PERIOD_S * step
        clock.now = begun_s + time_s
        if step:
            log.command(LoggedCommand(clock.now, np.full(7, time_s), np.zeros(7), "go", "policy"))
        log.reading(Reading.empty(1)._replace(time_s=np.array([time_s])), begun_s)
        log.truth(Truth.unknown(1)._replace(time_s=np.array([time_s])))
        log.sync()


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    """A closed log of two trials, images in the second, and a fault."""
    path, clock = tmp_path_factory.mktemp("follow") / "run.mcap", FakeClock()
    with open_log(path, clock) as log:
        log_trial(log, clock, STEPS)
        logging.getLogger("vergence.hardware").warning("a servo is %s", "hot")
        clock.now += 1.0
        log_trial(log, clock, STEPS)
        for number in range(6):
            grey = np.full((48, 64), 40 + number, np.uint8)
            log.image(number % 2, grey, clock.now - 0.1 * (6 - number))
        log.stopped("bus: gone")
    return path


def assert_holds(events, log):
    """The events of some calls are those of the whole log."""
    readings, truths, stop_reasons = (
        [one for part in events for one in getattr(part, name)]
        for name in ("readings", "truths", "stop_reasons")
    )
    steps = [(trial, step) for trial in log.trials for step in range(trial.steps + 1)]
    assert [one[:2] for one in readings] == [(trial.number, trial.begun_s) for trial, _ in steps]
    for now, truth, (trial, step) in zip(readings, truths, steps, strict=True):
        for found, whole in ((now.reading, trial.readings), (truth, trial.truths)):
            for value, values in zip(found, whole, strict=True):
                np.testing.assert_array_equal(value, values[step, 0])
    assert stop_reasons == list(log.stop_reasons)
    for eye in range(2):
        newest = [one.images[eye] for one in events if one.images[eye] is not None][-1]
        assert newest == log.trials[-1].images[eye][-1]


def ends_of(path):
    """Where each record of a log ends."""
    with path.open("rb") as file:
        reader = stream_reader.StreamReader(file, emit_chunks=True)
        return [file.tell() for _record in reader.records]


def test_a_log_in_pieces_cut_anywhere_gives_each_event_once_and_stays_as_it_is(logged, tmp_path):
    data, path = logged.read_bytes(), tmp_path / "log.mcap"
    ends = ends_of(logged)
    middle = ends[len(ends) // 2]
    cuts = [0, 4, 8, 20, middle - 1, middle, middle + 5, middle + 9, len(data) - 30, len(data)]
    cuts += np.random.default_rng(2).integers(len(data), size=12).tolist()
    path.touch()
    with LogFollower(path, history_s=math.inf) as follower, path.open("ab", 0) as file:
        events = []
        for start, end in pairwise(sorted(cuts)):
            file.write(data[start:end])
            events += [follower.poll(), follower.poll()]
            assert events[-1] is None
        assert follower.closed
        assert follower.ended
    assert (path.read_bytes(), os.listdir(tmp_path)) == (data, [path.name])
    assert_holds([one for one in events if one], read_log(logged))


def test_an_open_log_gives_what_its_writer_has_flushed(tmp_path):
    clock = FakeClock()
    log = open_log(tmp_path / "open.mcap", clock, seed="7")
    with log, LogFollower(log.path) as follower:
        assert follower.poll() is None
        assert follower.head.digest == HEAD.digest
        assert follower.facts["seed"] == "7"
        log_trial(log, clock, 3)
        assert len(follower.poll().readings) == 4
        assert (follower.poll(), follower.closed) == (None, False)
        log.close()
        assert (follower.poll(), follower.closed) == (None, True)


def test_only_the_recent_part_of_a_long_log_is_unpacked(tmp_path, monkeypatch):
    records = Mock(side_effect=records_in)
    monkeypatch.setattr("vergence.recording.follow.records_in", records)
    clock, steps = FakeClock(), 300
    with open_log(tmp_path / "long.mcap", clock) as log:
        log_trial(log, clock, 1)
        log_trial(log, clock, steps)
        with LogFollower(log.path, history_s=2.0) as follower:
            events = follower.poll()
            attached = records.call_count
            log_trial(log, clock, 1)
            later = follower.poll()
    times = [float(one.reading.time_s) for one in events.readings]
    # A chunk spans one period, or two where the writer's own flush fell between.
    assert times[0] == pytest.approx(PERIOD_S * steps - 2.0, abs=2 * PERIOD_S)
    assert times[-1] == pytest.approx(PERIOD_S * steps)
    assert {one.trial for one in events.readings} == {2}
    assert [one.trial for one in later.readings] == [3, 3]
    assert attached < 0.4 * steps


def test_images_are_the_newest_and_notes_begin_at_warnings(tmp_path, caplog):
    caplog.set_level(logging.INFO, "vergence")
    clock = FakeClock()
    with open_log(tmp_path / "eyes.mcap", clock) as log, LogFollower(log.path) as follower:
        logging.getLogger("vergence.hardware").info("a servo is warm")
        logging.getLogger("vergence.hardware").warning("a servo is hot")
        for number in range(3):
            log.image(0, np.full((48, 64), 40 + number, np.uint8), 99.0 + number)
        log.sync()
        events = follower.poll()
    left, right = events.images
    assert left.exposed_s == pytest.approx(101.0)
    assert right is None
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
            refused(rf"lost\.mcap: {reason}", follower.poll, error=UnreadableFileError)
            assert follower.ended
            assert not follower.closed
            assert follower.poll() is None


def test_garbage_is_one_error_after_the_events_before_it(logged, tmp_path):
    path, data = tmp_path / "garbage.mcap", logged.read_bytes()
    ends = ends_of(logged)
    for garbage in (bytes(64), b"not a record of MCAP", b"\x06" + bytes(8)):  # an empty chunk
        path.write_bytes(data[: ends[len(ends) // 2]] + garbage + data)
        with named(garbage), LogFollower(path, history_s=math.inf) as follower:
            assert follower.poll().readings
            refused(r"garbage\.mcap: it is damaged", follower.poll, error=UnreadableFileError)
            assert follower.poll() is None


def test_another_file_and_a_log_without_a_head_or_of_another_schema_are_refused(tmp_path):
    for one in (tmp_path / "none.mcap", tmp_path):
        refused("expected a log of a robot", LogFollower, one, error=UnreadableFileError)
    path = tmp_path / "other.mcap"
    path.write_text("nothing of the kind")
    with LogFollower(path) as follower:
        refused("no MCAP file", follower.poll, error=UnreadableFileError)
    for version, reason in ((None, "it has no head"), ("0", "its schema is")):
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start()
            if version is not None:
                writer.add_metadata(schema.FACTS_RECORD_NAME, {"schema": version})
                writer.add_attachment(0, 0, schema.HEAD_FILE, "application/toml", b"")
            writer.add_message(writer.register_channel("/fault", "json", 0), 0, b'{"text": ""}', 0)
            writer.finish()
        with LogFollower(path) as follower:
            refused(reason, follower.poll, error=UnreadableFileError)


def test_the_newest_log_is_the_one_written_last(tmp_path):
    assert newest_log(tmp_path / "runs") is None
    assert newest_log(tmp_path) is None
    for number, name in enumerate(("b.mcap", "a.mcap", "c.txt")):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (number, number))
    assert newest_log(tmp_path) == tmp_path / "a.mcap"


def test_each_click_is_read_once_and_the_file_goes_with_the_reader(tmp_path):
    log = tmp_path / "one.mcap"
    write_click(log, Click(1, np.array([1.0, 2.0]), 3.0))
    reader = ClickReader(log)
    assert reader.poll() is None  # of an earlier run
    for pixel in ([10.5, 20.0], [30.0, 40.25]):
        write_click(log, Click(1, np.array(pixel), 5.0))
        click = reader.poll()
        assert (click.eye, click.pixel.tolist(), click.exposed_s) == (1, pixel, 5.0)
        assert reader.poll() is None
    reader.close()
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_no_viewer_wrote_is_no_click(tmp_path):
    reader = ClickReader(tmp_path / "one.mcap")
    for text in ("", "[1, 2]", "null", '["left", 1, 2, 3]'):
        (tmp_path / "one.click").write_text(text)
        assert reader.poll() is None
