"""Some seconds of what `tests.faults.robot_inputs` does for minutes, and forgeries by name."""

import pytest

pytest.importorskip("mcap")

from tests.faults import forged_streams
from tests.faults.forged_logs import EDITS, FACTS, VALUES, Edit, forged
from tests.faults.harness import try_each
from tests.faults.robot_inputs import FaultError, Inputs, configs, watched
from vergence.errors import ConfigurationError, HeadFileError, UnreadableFileError
from vergence.eval.robot.config import ReplayConfig
from vergence.eval.robot.replay import replay
from vergence.hardware.config import load_hardware
from vergence.hardware.dynamixel import bus as dynamixel_bus
from vergence.recording.jpeg import read_jpeg
from vergence.recording.log import read_log

SEED = 20261125


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    return Inputs(tmp_path_factory.mktemp("inputs"))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "count"), [("config", 60), ("log", 60), ("line", 60)])
def test_whatever_comes_is_an_answer_or_one_error_of_ours(inputs, name, count):
    cases, attempt = inputs.attempts()[name]
    try_each(cases, attempt, SEED, count)
    assert inputs.ended.total()


@pytest.mark.slow
def test_a_stream_of_anything_ends_in_images_or_in_one_error(inputs):
    images = range(len(forged_streams.pictures()))
    parts = tuple(forged_streams.Part(place, None, 1, 0.0) for place in images)
    before = inputs.ended.total()
    inputs.stream(forged_streams.Script(forged_streams.HEADS[0], parts, "close"))
    assert inputs.ended.total() == before + 1


def test_what_nobody_should_see_is_a_fault(tmp_path):
    def raises(error):
        with watched(tmp_path):
            raise error

    for error in (
        ValueError("x"),
        ConfigurationError("a\nb"),
        ConfigurationError("\x1b[31m"),
        ConfigurationError(""),
        ConfigurationError(5000 * "a"),
    ):
        with pytest.raises(FaultError):
            raises(error)
    raises(ConfigurationError("one line"))


def forged_log(inputs, kind, **numbers):
    path = inputs.folder / "forged.mcap"
    edit = Edit(**{"kind": kind, "where": 0, "field": 0, "value": 0, **numbers})
    assert kind in EDITS
    path.write_bytes(forged(inputs.whole, [edit], inputs.images))
    return path


@pytest.mark.slow
def test_a_chunk_that_unpacks_without_end_is_where_a_log_breaks(inputs):
    for value in range(3):
        log = read_log(forged_log(inputs, "bomb", value=value))
        assert "chunk" in log.truncation_reason
        assert len(log.trials) == 2


@pytest.mark.slow
def test_a_chunk_packed_in_an_unknown_way_is_where_a_log_breaks(inputs):
    log = read_log(forged_log(inputs, "compression", value=3))
    assert "packed by 'gzip'" in log.truncation_reason
    assert log.trials == ()
    assert len(read_log(forged_log(inputs, "compression", value=2)).trials) == 2


def test_truth_and_words_are_no_numbers(inputs):
    readings = [place for place, one in enumerate(inputs.whole.messages) if one[0] == "/reading"]
    names = sorted(inputs.whole.messages[readings[0]][1])
    for value in ("true", '"1.5"', "1e999", "9" * 400, "[" * 900 + "]" * 900, "{}"):
        path = forged_log(
            inputs, "value", where=readings[0], field=names.index("time_s"),
            value=VALUES.index(value),
        )  # fmt: skip
        with pytest.raises(ConfigurationError, match="/reading: time_s: expected a number"):
            read_log(path)


def test_a_log_that_lacks_commands_is_refused(inputs):
    place = next(n for n, one in enumerate(inputs.whole.messages) if one[0] == "/command")
    with pytest.raises(ConfigurationError, match="/command: expected one before each of 8"):
        read_log(forged_log(inputs, "drop", where=place))


@pytest.mark.slow
def test_a_gaze_that_ended_before_its_first_period_has_no_answers(inputs):
    path = inputs.folder / "short.mcap"
    first = next(n for n, one in enumerate(inputs.whole.messages) if one[0] == "/command")
    path.write_bytes(forged(inputs.whole._replace(messages=inputs.whole.messages[:first]), [], []))
    (row,) = replay(ReplayConfig(log=path)).gazes.rows()
    assert row["settle_2px_s"] is None
    assert not row["swings"]
    assert not row["left_again"]


@pytest.mark.slow
def test_options_that_are_none_are_refused(inputs):
    options = sorted(inputs.whole.facts).index("options")
    for text in ('{"gain": ' + "9" * 400 + "}", '{"self": 1, "head": 2}', '{"a\\nb": 1}', "[]"):
        path = forged_log(inputs, "fact", field=options, value=FACTS.index(text))
        with watched(inputs.folder), pytest.raises(ConfigurationError):
            replay(ReplayConfig(log=path, controller="state-feedback"))


def test_a_clock_beyond_all_clocks_is_refused(inputs):
    zero = sorted(inputs.whole.facts).index("clock_zero_ns")
    path = forged_log(inputs, "fact", field=zero, value=FACTS.index("9" * 30))
    with pytest.raises(ConfigurationError, match="clock_zero_ns: expected ns"):
        read_log(path)


def test_an_image_that_is_no_jpeg_or_too_large_is_none():
    good = forged_streams.jpeg()
    assert read_jpeg(good).shape == (forged_streams.HEIGHT, forged_streams.WIDTH)
    for data in (
        b"",
        b"\xff\xd8",
        good[:20],
        forged_streams.announced(good, 30000, 30000),
        forged_streams.announced(good, 0, 0),
        b"GIF89a" + bytes(300),
    ):
        assert read_jpeg(data) is None


@pytest.mark.slow
def test_a_line_that_babbles_is_no_hang(inputs, monkeypatch):
    line = forged_streams.ForgedLine([bytes(300)], True)
    monkeypatch.setattr(dynamixel_bus, "SerialLine", lambda *_: line)
    bus = dynamixel_bus.Bus("forged")
    with watched(inputs.folder):
        assert bus.sync_read((1, 2), 126, 10) == {}


def test_a_pipe_or_a_device_is_no_file(inputs):
    fifo = inputs.folder / "FIFO.toml"
    with watched(inputs.folder), pytest.raises(UnreadableFileError, match="no regular file"):
        read_log(fifo)
    for name in ("FIFO.toml", "/dev/zero"):
        text = inputs.text.replace('"head.toml"', f'"{name}"')
        path = inputs.folder / "robot.toml"
        path.write_text(text)
        with watched(inputs.folder), pytest.raises(HeadFileError, match="no regular file"):
            load_hardware(path)


def test_configurations_are_drawn():
    found = []
    try_each(configs(), found.append, SEED, 3)
    assert found
