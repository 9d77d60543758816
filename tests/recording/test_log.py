"""A log holds what it was given, to the bit, and a broken one is read up to its break."""

import errno
import json
import logging
import os
import re
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader

from tests.campaigns.forged_logs import FACTS, Edit, forged, parts
from tests.naming import refused
from tests.recording.logged import HEAD, STEPS, log_trials, open_log
from vergence.envs.reading import Reading
from vergence.errors import UnreadableFileError, VergenceWarning
from vergence.eval.robot.config import ReplayConfig
from vergence.eval.robot.replay import replay
from vergence.recording import schema
from vergence.recording.log import read_jpeg, read_log, recover_log
from vergence.recording.schema import LoggedDetection


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    return path, log_trials(path, seed="7")


def test_readings_truth_and_facts_come_back_to_the_bit(logged):
    path, records = logged
    log = read_log(path)
    assert log.truncation_reason == ""
    assert (log.head.digest, log.config) == (HEAD.digest, "# a robot")
    assert (log.facts["controller"], log.facts["seed"]) == ("state-feedback", "7")
    for trial, record in zip(log.trials, records, strict=True):
        assert trial.steps == STEPS
        written = (*record.reading, *record.truth)
        for read, values in zip((*trial.readings, *trial.truths), written, strict=True):
            assert read.dtype == values.dtype
            assert read.tobytes() == values.tobytes()


@pytest.mark.parametrize(("truths", "known"), [(0, False), (40, False), (STEPS, True)])
def test_ground_truth_that_ends_early_is_none(tmp_path, truths, known):
    log_trials(tmp_path / "run.mcap", trials=1, truths=truths)
    (trial,) = read_log(tmp_path / "run.mcap").trials
    assert (trial.truths is not None) == known


def test_other_readers_of_mcap_find_messages_with_schemas(logged):
    with logged[0].open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        counts = Counter()
        for kind, channel, message in reader.iter_messages():
            assert (kind.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert message.log_time == 10**18  # the clock stands still
            counts[channel.topic] += 1
    assert counts == {
        "/trial": 2, "/reading": 2 * STEPS + 2, "/truth": 2 * STEPS + 2, "/command": 2 * STEPS,
    }  # fmt: skip


def test_schemas_have_only_what_foxglove_reads():
    """After the parser of foxglove/studio, mcap-support: no unions, no arrays of arrays."""
    for topic in schema.TOPICS:
        fields = [topic.schema]
        while fields:
            field = fields.pop()
            assert isinstance(field["type"], str)
            fields += field.get("properties", {}).values()
            if field["type"] == "array":
                assert field["items"]["type"] in {"boolean", "string", "number", "integer"}


def test_the_docs_list_every_topic_with_its_fields():
    doc = (Path(__file__).resolve().parents[2] / "docs" / "robot.md").read_text("utf-8")
    for topic in schema.TOPICS:
        row = re.search(rf"^\| `{topic.name}` \| `(.*?)` \| .* \| (.*) \|$", doc, re.MULTILINE)
        assert row is not None, topic.name
        assert row[1] == topic.schema_name
        assert re.findall(r"`(\w+)`", row[2]) == list(topic.schema["properties"])


def test_a_log_that_is_cut_off_is_read_up_to_there_and_recovered(logged, tmp_path):
    data = logged[0].read_bytes()
    for share in (0.3, 0.6, 0.95):
        cut, whole = tmp_path / f"{share}.mcap", tmp_path / f"whole{share}.mcap"
        cut.write_bytes(data[: int(share * len(data))])
        log = read_log(cut)
        assert log.truncation_reason
        assert log.head.digest == HEAD.digest
        recover_log(cut, whole)
        again = read_log(whole)
        assert again.truncation_reason == ""
        assert [trial.steps for trial in again.trials] == [trial.steps for trial in log.trials]


def test_a_message_that_is_none_of_its_topic_names_field_and_value(tmp_path):
    path = tmp_path / "bad.mcap"
    with open_log(path) as log:
        log.begin()
        log._put(schema.READING, 0.0, {"begun_s": 0.0, "time_s": "soon"})
    refused(r"bad\.mcap: /reading: time_s: .*got 'soon'", read_log, path)


def test_truth_and_words_are_no_numbers_and_null_is_nan():
    joints = {"positions": [0] * 7, "velocities": [None] * 7}
    for value in (True, "1.5", [0.5], 1e300, 10**400):
        data = json.dumps({"clock_s": value, **joints}).encode()
        refused("clock_s: expected a number", schema.decode_message, schema.JOINTS, data)
    found = schema.decode_message(schema.JOINTS, json.dumps({"clock_s": 1, **joints}).encode())
    assert found["clock_s"] == 1.0
    assert np.isnan(found["velocities"]).all()


def test_another_file_is_no_log(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("nothing of the kind")
    os.mkfifo(tmp_path / "pipe.mcap")
    for one in (path, tmp_path / "none.mcap", tmp_path, tmp_path / "pipe.mcap"):
        said = "no regular file" if one.is_fifo() else "expected a log of a robot"
        refused(said, read_log, one, error=UnreadableFileError)


def test_a_log_is_never_written_over(logged):
    before = logged[0].read_bytes()
    refused("log: expected a new file", open_log, logged[0])
    assert logged[0].read_bytes() == before


def test_loggers_faults_detections_and_images_are_kept(tmp_path, caplog):
    caplog.set_level(logging.INFO, "vergence")
    path = tmp_path / "all.mcap"
    nan = np.full(2, np.nan)
    with open_log(path) as log:
        logging.getLogger("vergence.hardware").info("a servo is %s", "warm")
        log.begin()
        log.reading(Reading.empty(1), 4.0)
        pixels = (nan, nan, np.empty((0, 2)), np.empty((0, 2)))
        log.detection(LoggedDetection("left", 4.9, 5.0, np.arange(7.0), *pixels))
        for eye in range(2):
            log.image(eye, np.full((48, 64), 40 + eye, np.uint8), 4.0)
        log.stopped("bus: gone")
        log.stopped("bus: gone")
    found = read_log(path)
    assert found.stop_reasons == ("bus: gone",)
    assert found.detections[0].eye == "left"
    assert np.isnan(found.detections[0].point_px).all()
    assert found.detections[0].corners_px.shape == (0, 2)
    left, right = found.trials[0].frames(0)
    assert (left.mean(), right.mean()) == (40.0, 41.0)
    with path.open("rb") as file:
        _, _, note = next(make_reader(file).iter_messages(topics=["/log"]))
    assert b"a servo is warm" in note.data


def test_a_jpeg_that_is_broken_or_claims_too_much_is_no_image():
    grey = np.full((48, 64), 40, np.uint8)
    data = cv2.imencode(".jpg", grey)[1].tobytes()
    assert np.array_equal(read_jpeg(data), grey)
    size = data.index(b"\xff\xc0") + 5
    for one in (b"", data[:100], data[:size] + b"\x60\x00" * 2 + data[size + 4 :]):
        assert read_jpeg(one) is None


def full(*_args, **_kwargs):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_ends_the_log_and_not_the_robot(tmp_path, monkeypatch):
    log = open_log(tmp_path / "full.mcap")
    monkeypatch.setattr("mcap.writer.Writer.flush", full)
    log.begin()
    with pytest.warns(VergenceWarning, match=r"full\.mcap ends early: No space left on device"):
        log.close()
    log.begin()
    log.close()


def test_a_log_that_cannot_even_begin_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("mcap.writer.Writer.flush", full)
    refused(r"got .*new\.mcap: No space left on device", open_log, tmp_path / "new.mcap")
    assert not (tmp_path / "new.mcap").exists()


def test_what_was_synced_is_on_disk_while_the_log_is_open(tmp_path):
    with open_log(tmp_path / "open.mcap") as log:
        for number in range(3):
            log.joints(5.0, np.full(7, float(number)), np.zeros(7))
            log.sync()
            found = read_log(log.path)
            assert len(found.joints) == number + 1
            assert found.truncation_reason
    assert not read_log(log.path).truncation_reason


# ---- logs whose records are well-formed and whose content is not ----


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return parts(tmp_path_factory.mktemp("log"))


def forged_log(folder, whole, kind, **numbers):
    path = folder / "forged.mcap"
    edit = Edit(**{"kind": kind, "where": 0, "field": 0, "value": 0, **numbers})
    path.write_bytes(forged(whole, [edit], [""]))
    return path


@pytest.mark.slow
def test_a_chunk_that_cannot_be_unpacked_is_where_a_log_breaks(tmp_path, whole):
    assert len(read_log(forged_log(tmp_path, whole, "compression", value=2)).trials) == 2
    log = read_log(forged_log(tmp_path, whole, "compression", value=3))
    assert "packed by 'gzip'" in log.truncation_reason
    assert log.trials == ()
    without_end = read_log(forged_log(tmp_path, whole, "bomb", value=2))
    assert "chunk" in without_end.truncation_reason
    assert len(without_end.trials) == 2


def test_a_gaze_that_ended_before_its_first_period_has_no_answers(tmp_path):
    path = tmp_path / "short.mcap"
    log_trials(path, trials=1, steps=0)
    (row,) = replay(ReplayConfig(log=path)).gazes.rows()
    assert row["settle_2px_s"] is None
    assert not row["swings"]


def test_facts_that_cannot_be_are_refused(tmp_path, whole):
    def with_fact(name, text):
        numbers = {"field": sorted(whole.facts).index(name), "value": FACTS.index(text)}
        return forged_log(tmp_path, whole, "fact", **numbers)

    for text in ('{"self": 1, "head": 2}', '{"a\\nb": 1}', "[]"):
        log = with_fact("options", text)
        refused(".", replay, ReplayConfig(log=log, controller="state-feedback"))
    refused("clock_zero_ns: expected ns", read_log, with_fact("clock_zero_ns", "nan"))
