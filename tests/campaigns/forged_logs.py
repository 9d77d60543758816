"""Robot logs whose records are well-formed and whose content is not."""

import json
import zlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import zstandard
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    DataEnd,
    Footer,
    Header,
    Message,
    Metadata,
    Schema,
)

from tests.recording.logged import log_trials
from vergence.recording import schema
from vergence.recording.records import read_records

_MAGIC: Final = b"\x89MCAP0\r\n"
_BOMB: Final = 2**30
"""Bytes that a chunk of a few KB unpacks to (chosen: more than a process may use)."""
VALUES: Final = (
    "null", "true", "false", "0", "1", "-1", "3", "0.5", "1e9", "-1e9", "1e300", "-1e300", "1e999",
    "-1e999", "NaN", "1e-320", "9" * 30, "9" * 400, "9" * 5000, '""', '"1.5"', '"evil.py:X"',
    '"a\\nb"', '"\\ud800"', '"\\u0000"', '"' + 2000 * "a" + '"', "[]", "[[]]", "{}", "[null]",
    "[1, 2]", "[true, false]", '["1", "2"]', "[[1, 2], [3, 4]]", "[[1], [2, 3]]",
    "[1e999, 1e999, 1e999, 1e999, 1e999, 1e999, 1e999]", "[1e200, 0, 0, 0, 0, 0, 1e200]",
    "[0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1]", "[0, 0, 0, 0, 0, 0]", "[0, 0, 0, 0, 0, 0, 0, 0]",
    "[null, null, null, null, null, null, null]", "[[1e18, 0], [0, -1e18]]", "[[1], [2]]",
    '{"sec": 0, "nsec": 0}', '{"sec": 1e999, "nsec": 0}', '{"sec": ' + "9" * 400 + ', "nsec": 0}',
    '{"sec": -5, "nsec": "7"}', '{"a": {"b": [1, {"c": null}]}}',
    "[" * 900 + "]" * 900, "[" * 60000 + "]" * 60000, '{"a":' * 900 + "1" + "}" * 900,
    "", "[1, ", "\ufeff1",
)  # fmt: skip
"""JSON in place of a value: wrong types, shapes and sizes, and some that is none."""
FACTS: Final = (
    "", "1", "2", "nan", "-1", "9" * 30, "9" * 4000, "evil.py:X", "evil:X", "os:system", "{}", "[]",
    "null", '{"gain": 1e999}', '{"gain": "x"}', '{"gain": [1]}', '{"gain": {"a": 1}}', '{"": 1}',
    '{"self": 1, "head": 2}', '{"gain": true}', '{"gain": null}', '{"a\\nb": 1}', "[" * 60000,
    '{"gain": ' + "9" * 400 + "}", "a\nb", "\x1b[31m", "state-feedback", "ibvs", "pid", "saccade",
    "learned-gain", "1.0", '{"head": "x"}',
)  # fmt: skip
"""Texts in place of a fact."""
EDITS: Final = (
    "value", "value", "value", "value", "inner", "inner", "twice", "without", "drop", "repeat",
    "swap", "data", "fact", "fact", "no fact", "head", "other head", "no head", "config", "channel",
    "encoding", "compression", "bomb", "size", "again", "image", "image", "time", "flip", "cut",
)  # fmt: skip
COMPRESSIONS: Final = ("", "zstd", "lz4", "gzip", "pickle", "\u00e9", "zstd ")


class Edit(NamedTuple):
    """One thing that is done to a log."""

    kind: str
    where: int
    """Picks a message, or a place in the file."""
    field: int
    value: int


@st.composite
def edits(draw: Any) -> tuple[Edit, ...]:
    """Strategy for edits of a log, one to three."""
    numbers = st.integers(0, 2**20)
    one = st.builds(Edit, st.sampled_from(EDITS), numbers, numbers, numbers)
    return tuple(draw(st.lists(one, min_size=1, max_size=3)))


class _Parts(NamedTuple):
    """A log taken apart."""

    messages: list[list[Any]]
    """Topic, message and JSON in place of values by placeholder."""
    facts: dict[str, str]
    files: dict[str, str]


def parts(folder: Path) -> _Parts:
    """A small whole log of two trials, with detections and images, taken apart."""
    path = folder / "whole.mcap"
    log_trials(path, steps=8)
    found = _Parts([], {}, {})
    topics: dict[int, str] = {}
    for one in read_records(path):
        if isinstance(one, Channel):
            topics[one.id] = one.topic
        elif isinstance(one, Message):
            found.messages.append([topics[one.channel_id], json.loads(one.data), ""])
        elif isinstance(one, Metadata):
            found.facts.update(one.metadata)
        elif isinstance(one, Attachment):
            found.files[one.name] = one.data.decode()
    nan = [None, None]
    seen = {"eye": "left", "exposed_s": 4.9, "ready_s": 5.0, "positions": [0.0] * 7,
            "point_px": nan, "sigma_px": nan, "corners_px": [], "corners_sigma_px": []}  # fmt: skip
    found.messages.append([schema.DETECTION.name, seen, ""])
    found.messages.append([schema.FAULT.name, {"text": "bus: gone"}, ""])
    for topic in schema.IMAGES:
        image = {"timestamp": {"sec": 10**9, "nsec": 0}, "frame_id": topic.name, "format": "jpeg",
                 "data": "AAAA"}  # fmt: skip
        found.messages.append([topic.name, image, ""])
    return found


def forged(whole: _Parts, steps: Sequence[Edit], images: Sequence[str]) -> bytes:
    """The file of a log after some edits.

    Args:
        whole: log to edit; it is not changed.
        steps: the edits.
        images: base64 in place of that of images.
    """
    messages = [[topic, json.loads(json.dumps(one)), ""] for topic, one, _ in whole.messages]
    facts, files = dict(whole.facts), dict(whole.files)
    more: dict[str, Any] = {"compression": "zstd"}
    for step in steps:
        _edit(step, messages, facts, files, images, more)
    data = _file(messages, facts, files, more)
    for step in steps:
        place = step.where * len(data) >> 20
        if step.kind == "flip" and place < len(data):
            data = data[:place] + bytes((data[place] ^ (1 << step.value % 8),)) + data[place + 1 :]
        elif step.kind == "cut":
            data = data[:place]
    return data


def _edit(
    step: Edit,
    messages: list[list[Any]],
    facts: dict[str, str],
    files: dict[str, str],
    images: Sequence[str],
    more: dict[str, Any],
) -> None:
    kind = step.kind
    raw = VALUES[step.value % len(VALUES)]
    if not messages:
        return
    place = step.where % len(messages)
    topic, message, _ = one = messages[place]
    names = sorted(message)
    name = names[step.field % len(names)] if names else "x"
    if kind == "value":
        message[name], one[2] = "@raw@", raw
    elif kind == "inner":
        inner = message.get(name)
        while isinstance(inner, list) and inner and isinstance(inner[0], list):
            inner = inner[step.field % len(inner)]
        if isinstance(inner, list) and inner:
            inner[step.where % len(inner)], one[2] = "@raw@", raw
        elif isinstance(inner, dict) and inner:
            inner[sorted(inner)[step.field % len(inner)]], one[2] = "@raw@", raw
    elif kind == "twice":
        one[2] = f'{name}":@{raw}'
    elif kind == "without":
        message.pop(name, None)
    elif kind == "drop":
        del messages[place : place + 1 + step.value % 4]
    elif kind == "repeat":
        messages[place:place] = [one] * (1 + step.value % 3 * 1500)
    elif kind == "swap":
        other = step.value % len(messages)
        messages[place], messages[other] = messages[other], messages[place]
    elif kind == "data":
        one[1], one[2] = {"@raw@": 0}, "@whole@" + raw
    elif kind == "fact":
        name = sorted(facts)[step.field % len(facts)] if facts else "schema"
        facts[name] = FACTS[step.value % len(FACTS)]
    elif kind == "no fact":
        facts.pop(sorted(facts)[step.field % len(facts)] if facts else "", None)
    elif kind == "head" and schema.HEAD_FILE in files:
        lines = files[schema.HEAD_FILE].splitlines() or [""]
        at = step.where % len(lines)
        key = lines[at].partition("=")[0]
        lines[at] = f"{key} = {raw}" if step.field % 4 else raw
        files[schema.HEAD_FILE] = "\n".join(lines)
    elif kind == "other head":
        files[schema.HEAD_FILE] = ("", "\x00", 'name = "a\\nb"', "x = 0x" + "f" * 9000)[
            step.value % 4
        ]
    elif kind == "no head":
        files.pop(schema.HEAD_FILE, None)
    elif kind == "config":
        files[schema.CONFIG_FILE] = raw
    elif kind == "compression":
        more["compression"] = COMPRESSIONS[step.value % len(COMPRESSIONS)]
    elif kind == "image":
        data = images[step.value % len(images)]
        for at, (topic, message, _) in enumerate(messages):
            if topic in [image.name for image in schema.IMAGES]:
                messages[at] = [topic, {**message, "data": data}, ""]
    elif kind == "time" and topic == schema.READING.name:
        for one in messages[place:]:
            if isinstance(one[1].get("time_s"), int | float):
                one[1]["time_s"] += (1e9, -1e9, 1e4, 5e15, -0.01, 90000.0)[step.value % 6]
    else:
        more[kind] = step


def _encoded(message: dict[str, Any], raw: str) -> bytes:
    if raw.startswith("@whole@"):
        return raw.removeprefix("@whole@").encode("utf-8", "replace")
    text = json.dumps(message)
    if '":@' in raw:
        return (text[:-1] + f', "{raw}'.replace('":@', '": ') + "}").encode("utf-8", "replace")
    return text.replace('"@raw@"', raw).encode("utf-8", "replace")


@cache
def _bomb() -> bytes:
    packer = zstandard.ZstdCompressor().compressobj(size=_BOMB)
    zeros = bytes(2**20)
    return b"".join(packer.compress(zeros) for _ in range(_BOMB >> 20)) + packer.flush()


def _packed(data: bytes, compression: str) -> bytes:
    if compression == "zstd":
        return zstandard.compress(data)
    if compression == "lz4":
        import lz4.frame

        return bytes(lz4.frame.compress(data))
    return data


def _file(
    messages: list[list[Any]], facts: dict[str, str], files: dict[str, str], more: dict[str, Any]
) -> bytes:
    out = RecordBuilder()
    Header(profile="", library="vergence").write(out)
    for name, text in files.items():
        Attachment(0, 0, name, "application/toml", text.encode("utf-8", "replace")).write(out)
    Metadata(name=schema.FACTS_RECORD_NAME, metadata=facts).write(out)
    inside = RecordBuilder()
    numbers: dict[str, int] = {}
    for number, topic in enumerate(schema.TOPICS, 1):
        numbers[topic.name] = number
        Schema(number, topic.encoded_schema, "jsonschema", topic.schema_name).write(inside)
        kind = "protobuf" if "encoding" in more else "json"
        Channel(number, topic.name, kind, {}, number).write(inside)
    for place, (topic, message, raw) in enumerate(messages):
        again = more.get("again", more.get("channel"))
        if again is not None and place == again.where % (len(messages) + 1):
            other = schema.TOPICS[again.value % len(schema.TOPICS)].name
            Channel(1 + again.field % len(numbers), other, "json", {}, 60000).write(inside)
        Message(
            channel_id=numbers[topic], log_time=2**63, data=_encoded(message, raw),
            publish_time=0, sequence=place,
        ).write(inside)  # fmt: skip
    plain = inside.end()
    data, size = _packed(plain, more["compression"]), len(plain)
    if "size" in more:
        size = (0, 1, 2**40, 2**63, size - 1)[more["size"].value % 5]
    Chunk(more["compression"], data, 2**63, 0, zlib.crc32(plain), size).write(out)
    if "bomb" in more:
        step = more["bomb"]
        for _ in range(1 + step.where % 3):
            size = (len(plain), 2**25, _BOMB)[step.value % 3]
            Chunk("zstd", _bomb(), 0, 0, 0, size).write(out)
    DataEnd(0).write(out)
    Footer(0, 0, 0).write(out)
    return _MAGIC + out.end() + _MAGIC
