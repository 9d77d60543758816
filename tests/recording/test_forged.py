"""Logs whose records are well-formed and whose content is not are read as far as they are sound."""

import pytest

pytest.importorskip("mcap")

from tests.campaigns.forged_logs import FACTS, Edit, forged, parts
from vergence.errors import ConfigurationError
from vergence.eval.robot.config import ReplayConfig
from vergence.eval.robot.replay import replay
from vergence.recording.log import read_log


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


def first_of(whole, topic):
    return next(n for n, one in enumerate(whole.messages) if one[0] == topic)


def test_a_gaze_that_ended_before_its_first_period_has_no_answers(tmp_path, whole):
    path = tmp_path / "short.mcap"
    short = whole.messages[: first_of(whole, "/command")]
    path.write_bytes(forged(whole._replace(messages=short), [], []))
    (row,) = replay(ReplayConfig(log=path)).gazes.rows()
    assert row["settle_2px_s"] is None
    assert not row["swings"]


def test_facts_that_cannot_be_are_refused(tmp_path, whole):
    names = sorted(whole.facts)
    for text in ('{"self": 1, "head": 2}', '{"a\\nb": 1}', "[]"):
        options = {"field": names.index("options"), "value": FACTS.index(text)}
        path = forged_log(tmp_path, whole, "fact", **options)
        with pytest.raises(ConfigurationError):
            replay(ReplayConfig(log=path, controller="state-feedback"))
    clock = {"field": names.index("clock_zero_ns"), "value": FACTS.index("nan")}
    with pytest.raises(ConfigurationError, match="clock_zero_ns: expected ns"):
        read_log(forged_log(tmp_path, whole, "fact", **clock))
