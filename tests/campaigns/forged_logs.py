"""Robot logs whose records are well-formed and whose content is not."""

import copy
import json
import re
import zlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import lz4.frame
import zstandard
from hypothesis import strategies as st
from mcap import records
from mcap.data_stream import RecordBuilder

from tests.recording.logged import log_trials
from vergence.recording import schema
from vergence.recording.log import read_records

_MAGIC: Final = b"\x89MCAP0\r\n"
_BOMB: Final = 2**30
"""Bytes that a chunk of a few KB unpacks to (chosen: more than a process may use)."""
VALUES: Final = (
    "null", "true", "0", "-1", "0.5", "-1e300", "1e999", "NaN", "9" * 5000, '""', '"1.5"',
    '"evil.py:X"', '"a\\nb"', '"\\ud800"', '"\\u0000"', '"' + 2000 * "a" + '"', "[]", "[[]]", "{}",
    "[null]", "[1, 2]", '["1", "2"]', "[[1], [2, 3]]", "[0, 0, 0, 0, 0, 0]",
    *(f"[{', '.join(7 * [one])}]" for one in ("1e999", "0.1", "null")), "[[1e18, 0], [0, -1e18]]",
    '{"sec": 1e999, "nsec": 0}', '{"sec": -5, "nsec": "7"}', '{"a": {"b": [1, {"c": null}]}}',
    "[" * 900 + "]" * 900, "[" * 60000 + "]" * 60000, '{"a":' * 900 + "1" + "}" * 900, "", "[1, ",
    "\ufeff1", "\x00", "0x" + "f" * 9000,
)  # fmt: skip
"""JSON in place of a value: wrong types, shapes and sizes, and some that is none."""
FACTS: Final = (
    "", "1", "nan", "9" * 30, "9" * 4000, "evil.py:X", "os:system", "[]", "null", "[" * 60000,
    '{"gain": 1e999}', '{"gain": "x"}', '{"gain": {"a": 1}}', '{"": 1}', '{"self": 1, "head": 2}',
    '{"gain": true}', '{"a\\nb": 1}', '{"gain": ' + "9" * 400 + "}", "a\nb", "\x1b[31m", "ibvs",
    "learned-gain", '{"head": "x"}',
)  # fmt: skip
"""Texts in place of a fact."""
EDITS: Final = (
    *4 * ("value",), "inner", "inner", "twice", "without", "drop", "repeat", "swap", "data",
    "fact", "fact", "no fact", "head", "head", "no head", "config", "channel", "channel",
    "encoding", "compression", "bomb", "size", "image", "image", "time", "flip", "cut",
)  # fmt: skip
COMPRESSIONS: Final = ("", "zstd", "lz4", "gzip", "\u00e9", "zstd ")


class Edit(NamedTuple):
    """One thing that is done to a log."""

    kind: str
    where: int
    """Picks a message, or a place in the file."""
    field: int
    value: int


def edits() -> st.SearchStrategy[tuple[Edit, ...]]:
    """One to three edits of a log."""
    numbers = st.integers(0, 2**20)
    one = st.builds(Edit, st.sampled_from(EDITS), numbers, numbers, numbers)
    return st.lists(one, min_size=1, max_size=3).map(tuple)


class _Parts(NamedTuple):
    """A log taken apart."""

    messages: list[list[Any]]
    """Topics and messages, in which `@n` stands for the n-th of the values."""
    facts: dict[str, str]
    files: dict[str, str]


def parts(folder: Path) -> _Parts:
    """A small whole log of two trials, with detections and images, taken apart."""
    path = folder / "whole.mcap"
    log_trials(path, steps=8)
    found = _Parts([], {}, {})
    topics: dict[int, str] = {}
    for one in read_records(path):
        if isinstance(one, records.Channel):
            topics[one.id] = one.topic
        elif isinstance(one, records.Message):
            found.messages.append([topics[one.channel_id], json.loads(one.data)])
        elif isinstance(one, records.Metadata):
            found.facts.update(one.metadata)
        elif isinstance(one, records.Attachment):
            found.files[one.name] = one.data.decode()
    nan = [None, None]
    seen = {"eye": "left", "exposed_s": 4.9, "ready_s": 5.0, "positions": [0.0] * 7,
            "point_px": nan, "sigma_px": nan, "corners_px": [], "corners_sigma_px": []}  # fmt: skip
    found.messages.append([schema.DETECTION.name, seen])
    found.messages.append([schema.FAULT.name, {"text": "bus: gone"}])
    image = {"timestamp": {"sec": 10**9, "nsec": 0}, "format": "jpeg", "data": "AAAA"}
    for topic in schema.IMAGES:
        found.messages.append([topic.name, {**image, "frame_id": topic.name}])
    return found


def forged(whole: _Parts, steps: Sequence[Edit], images: Sequence[str]) -> bytes:
    """The file of a log after some edits; images are base64 in place of those of a log."""
    log, more = copy.deepcopy(whole), {}
    for step in steps:
        if log.messages:
            _edit(step, log, images)
        more[step.kind] = step
    data = _file(log, more)
    for step in steps:
        place = step.where * len(data) >> 20
        if step.kind == "flip" and place < len(data):
            data = data[:place] + bytes((data[place] ^ (1 << step.value % 8),)) + data[place + 1 :]
        elif step.kind == "cut":
            data = data[:place]
    return data


def _edit(step: Edit, log: _Parts, images: Sequence[str]) -> None:
    kind, messages, files = step.kind, log.messages, log.files
    number = step.value % len(VALUES)
    place, other = step.where % len(messages), step.value % len(messages)
    topic, message = one = messages[place]
    name, fact = (
        sorted(names)[step.field % len(names)] if names else "schema"
        for names in (message, log.facts)
    )
    if kind == "value":
        message[name] = f"@{number}"
    elif kind == "inner":
        inner = message.get(name)
        while isinstance(inner, list) and inner and isinstance(inner[0], list):
            inner = inner[step.field % len(inner)]
        if isinstance(inner, list) and inner:
            inner[step.where % len(inner)] = f"@{number}"
        elif isinstance(inner, dict) and inner:
            inner[sorted(inner)[step.field % len(inner)]] = f"@{number}"
    elif kind == "twice":
        message[f"{name}@"] = f"@{number}"
    elif kind == "without":
        message.pop(name, None)
    elif kind == "drop":
        del messages[place : place + 1 + step.value % 4]
    elif kind == "repeat":
        messages[place:place] = [one] * (1 + step.value % 3 * 1500)
    elif kind == "swap":
        messages[place], messages[other] = messages[other], messages[place]
    elif kind == "data":
        one[1] = {"@whole": f"@{number}"}
    elif kind == "fact":
        log.facts[fact] = FACTS[step.value % len(FACTS)]
    elif kind == "no fact":
        log.facts.pop(fact, None)
    elif kind == "head" and schema.HEAD_FILE in files:
        lines = files[schema.HEAD_FILE].splitlines() or [""]
        at = step.where % len(lines)
        key = lines[at].partition("=")[0]
        lines[at] = f"{key} = {VALUES[number]}" if step.field % 4 else VALUES[number]
        files[schema.HEAD_FILE] = "\n".join(lines)
    elif kind == "no head":
        files.pop(schema.HEAD_FILE, None)
    elif kind == "config":
        files[schema.CONFIG_FILE] = VALUES[number]
    elif kind == "image":
        for topic, message in messages:
            if topic in [image.name for image in schema.IMAGES]:
                message["data"] = images[step.value % len(images)]
    elif kind == "time" and topic == schema.READING.name:
        for _, message in messages[place:]:
            if isinstance(message.get("time_s"), int | float):
                message["time_s"] += (1e9, -1e9, 1e4, 5e15, -0.01, 90000.0)[step.value % 6]


def _encoded(message: dict[str, Any]) -> bytes:
    text = json.dumps(message.get("@whole", message)).replace('@": ', '": ')
    return re.sub(r'"@(\d+)"', lambda n: VALUES[int(n[1])], text).encode("utf-8", "replace")


@cache
def _bomb() -> bytes:
    packer = zstandard.ZstdCompressor().compressobj(size=_BOMB)
    zeros = bytes(2**20)
    return b"".join(packer.compress(zeros) for _ in range(_BOMB >> 20)) + packer.flush()


def _file(log: _Parts, more: dict[str, Edit]) -> bytes:
    out = RecordBuilder()
    records.Header(profile="", library="vergence").write(out)
    for name, text in log.files.items():
        records.Attachment(0, 0, name, "application/toml", text.encode("utf-8", "replace")).write(
            out
        )
    records.Metadata(name=schema.FACTS_RECORD_NAME, metadata=log.facts).write(out)
    inside = RecordBuilder()
    numbers = {topic.name: number for number, topic in enumerate(schema.TOPICS, 1)}
    for topic in schema.TOPICS:
        number, kind = numbers[topic.name], "protobuf" if "encoding" in more else "json"
        form = json.dumps(topic.schema).encode()
        records.Schema(number, form, "jsonschema", topic.schema_name).write(inside)
        records.Channel(number, topic.name, kind, {}, number).write(inside)
    for place, (topic, message) in enumerate(log.messages):
        again = more.get("channel")
        if again is not None and place == again.where % (len(log.messages) + 1):
            other = schema.TOPICS[again.value % len(schema.TOPICS)].name
            records.Channel(1 + again.field % len(numbers), other, "json", {}, 60000).write(inside)
        records.Message(
            channel_id=numbers[topic], log_time=2**63, data=_encoded(message),
            publish_time=0, sequence=place,
        ).write(inside)  # fmt: skip
    plain = inside.end()
    named = more.get("compression")
    compression = COMPRESSIONS[named.value % len(COMPRESSIONS)] if named else "zstd"
    pack = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}.get(compression, bytes)
    size = len(plain)
    if "size" in more:
        size = (0, 1, 2**40, 2**63, size - 1)[more["size"].value % 5]
    records.Chunk(compression, bytes(pack(plain)), 2**63, 0, zlib.crc32(plain), size).write(out)
    if "bomb" in more:
        step = more["bomb"]
        for _ in range(1 + step.where % 3):
            size = (len(plain), 2**25, _BOMB)[step.value % 3]
            records.Chunk("zstd", _bomb(), 0, 0, 0, size).write(out)
    records.DataEnd(0).write(out)
    records.Footer(0, 0, 0).write(out)
    return _MAGIC + out.end() + _MAGIC
