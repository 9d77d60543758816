"""Trials of an evaluation on a robot count if the journal and their log have them whole."""

import pytest

from tests.recording.logged import STEPS, log_trials
from vergence.errors import ConfigurationError
from vergence.eval.robot.evaluation_record import EvaluationRecord, JournalEntry, TrialKey

pytest.importorskip("mcap")


def entry(trial, number, log="trials-1.mcap"):
    return JournalEntry(
        scenario="webcam", controller="ibvs", trial=trial, log=log, number=number,
        point_m=(0.1, 0.2, 1.0), controller_sha256="", options="{}",
    )  # fmt: skip


@pytest.fixture
def record(tmp_path):
    found = EvaluationRecord(tmp_path / "run", {"controllers": ["ibvs"]})
    log_trials(found.new_log(), trials=2)
    for number in (1, 2):
        found.add(entry(number - 1, number))
    return found


def test_trials_are_found_again_by_another_process(record, tmp_path):
    again = EvaluationRecord(tmp_path / "run")
    assert again.configuration == {"controllers": ["ibvs"]}
    assert again.new_log().name == "trials-2.mcap"
    whole = again.completed_trials(lambda scenario: STEPS)
    assert list(whole) == [TrialKey("webcam", "ibvs", 0), TrialKey("webcam", "ibvs", 1)]
    assert [one.trial.number for one in whole.values()] == [1, 2]
    assert whole[TrialKey("webcam", "ibvs", 1)].point.tolist() == [0.1, 0.2, 1.0]


def test_a_trial_whose_log_has_lost_its_end_does_not_count(record):
    record.add(entry(2, 3))  # which the log has lost as a whole
    assert len(record.completed_trials(lambda scenario: STEPS)) == 2
    assert record.completed_trials(lambda scenario: STEPS + 1) == {}


def test_trials_of_a_log_that_cannot_be_read_are_missing(record):
    (record.folder / "trials-1.mcap").write_bytes(bytes(100))
    assert record.completed_trials(lambda scenario: STEPS) == {}
    assert list(record.unreadable) == ["trials-1.mcap"]


def test_a_line_that_a_kill_has_cut_off_is_no_trial_and_spoils_none(record):
    place = record.folder / "journal.jsonl"
    place.write_bytes(place.read_bytes()[:-30])
    assert record.count() == 1
    record.add(entry(1, 2))
    assert record.count() == 2


def test_a_journal_that_is_none_is_refused_by_its_line(record):
    place = record.folder / "journal.jsonl"
    good = place.read_bytes()
    for bad in (b'{"trial": 1}\n', good.splitlines()[0].replace(b'"trial": 0', b'"trial": "0"')):
        place.write_bytes(bad + b"\n" + good)
        with pytest.raises(ConfigurationError, match=r"journal\.jsonl: line 1: expected a trial"):
            record.count()


def test_nothing_is_written_before_the_first_log(tmp_path):
    EvaluationRecord(tmp_path / "run", {"controllers": ["ibvs"]})
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_a_record_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="resume: expected a run folder"):
        EvaluationRecord(tmp_path)
