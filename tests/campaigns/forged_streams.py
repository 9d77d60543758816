"""Forged camera streams and serial lines, which send faulty images and answers."""

import socket
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from itertools import pairwise
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from hypothesis import strategies as st

from vergence.hardware.dynamixel.packets import (
    BROADCAST,
    HEADER,
    Instruction,
    instruction_packet,
    status_packet,
)

WIDTH, HEIGHT = 640, 480
_TYPE: Final = b"Content-Type: multipart/x-mixed-replace; boundary=frame\r\n"
_OK: Final = b"HTTP/1.1 200 OK\r\n"
HEADS: Final = (
    *5 * (_OK + _TYPE + b"\r\n",),
    _OK + b"Content-Length: 999999999999999999\r\n" + _TYPE + b"\r\n",
    _OK + b"Transfer-Encoding: chunked\r\n" + _TYPE + b"\r\nFFFFFFFFFFFFFFFF\r\n",
    _OK + b"Content-Encoding: gzip\r\n" + _TYPE + b"\r\n",
    b"HTTP/1.1 302 Found\r\nLocation: /\r\n\r\n",
    b"HTTP/1.1 302 Found\r\nLocation: file:///etc/passwd\r\n\r\n",
    _OK + b"Content-Type: image/jpeg\r\n\r\n",
    _OK + _TYPE.replace(b"=frame", b"=") + b"\r\n",
    _OK + _TYPE + b"X: " + 2**20 * b"a",
    _OK + b"Content-Type: application/vnd.apple.mpegurl\r\n\r\n#EXTM3U\n"
    b"#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nfile:///etc/passwd\n",
    b"HTTP/1.0 404 Not Found\r\n\r\n", b"\x00\xff" * 500, b"", b"RTSP/1.0 200 OK\r\n\r\n",
)  # fmt: skip
LENGTHS: Final = (b"", b"-1", b"0", b"5", b"2147483647", b"99999999999999999999", b"x")


@cache
def jpeg(width: int = WIDTH, height: int = HEIGHT, colour: bool = False) -> bytes:
    """A JPEG of grey levels with a gradient."""
    image = np.tile(np.arange(width, dtype=np.uint8), (height, 1))
    image = np.repeat(image[..., None], 3, axis=2) if colour else image
    return bytes(cv2.imencode(".jpg", image)[1].tobytes())


def announced(width: int, height: int) -> bytes:
    """A JPEG that claims another size."""
    at = jpeg().find(b"\xff\xc0") + 5
    return jpeg()[:at] + height.to_bytes(2, "big") + width.to_bytes(2, "big") + jpeg()[at + 4 :]


@cache
def pictures() -> tuple[bytes, ...]:
    """Images and what is none."""
    good, blank = jpeg(), np.zeros((HEIGHT, WIDTH), np.uint8)
    return (
        good, good, good, jpeg(colour=True), good[: len(good) // 2], good[:20], good[:-2],
        jpeg(1, 1), jpeg(1280, 720), jpeg(8000, 8000), announced(65500, 65500), announced(0, 0),
        announced(641, 480), b"", b"\xff\xd8\xff\xd9", b"\x00" * 10**6, bytes(range(256)) * 40,
        good[:300] + b"\xff" * 3000 + good[300:], bytes(cv2.imencode(".png", blank)[1].tobytes()),
        b"GIF89a" + bytes(300), b"#EXTM3U\nfile:///etc/passwd\n", b"P5 99999 99999 255\n",
        b"\xff\xd8" + b"\xff\xfe\xff\xff" * 5000, good.replace(b"\xff\xda", b"\xff\xc4"),
    )  # fmt: skip


class Part(NamedTuple):
    """Some images in a row."""

    picture: int
    length: bytes | None
    """Length stated in the part's header; None for the true length."""
    count: int
    pause_s: float
    boundary: bytes = b"--frame"
    ends: bytes = b"\r\n"


class Script(NamedTuple):
    """Data that a server sends."""

    head: bytes
    parts: tuple[Part, ...]
    after: str


@st.composite
def scripts(draw: Any) -> Script:
    """A stream, of which the beginning is mostly good."""
    few = st.sampled_from((None, None, None, None, *LENGTHS))
    part = st.builds(
        Part, st.integers(0, len(pictures()) - 1), few, st.sampled_from((1, 3, 12)),
        st.sampled_from((0.0, 0.033)), st.sampled_from((b"--frame",) * 5 + (b"--other", b"")),
        st.sampled_from((b"\r\n", b"\r\n", b"\n", b"")),
    )  # fmt: skip
    bad = tuple(draw(st.lists(part, min_size=1, max_size=3)))
    good = draw(st.sampled_from((0, 12, 12)))
    begun = (Part(0, None, good, 0.033),) if good else ()
    ends = st.sampled_from(("close", "silence", "endless header", "endless body", "good", "good"))
    return Script(draw(st.sampled_from(HEADS)), begun + bad, draw(ends))


class Server:
    """An HTTP server of one script, which forgets who goes away."""

    def __init__(self, script: Script) -> None:
        self._script, self._ended = script, False
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._socket.getsockname()[1]}/"
        threading.Thread(target=self._run, daemon=True).start()

    def close(self) -> None:
        self._ended = True
        self._socket.close()

    def _run(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self._socket.accept()
                threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with suppress(OSError), connection:
            connection.recv(4096)
            connection.sendall(self._script.head)
            for part in self._script.parts:
                for _ in range(part.count):
                    self._send(connection, part)
            while not self._ended and self._script.after != "close":
                if self._script.after == "good":
                    self._send(connection, Part(0, None, 1, 0.033))
                elif self._script.after == "silence":
                    time.sleep(0.05)
                else:
                    begun = b"--frame\r\n" if self._script.after == "endless header" else b""
                    connection.sendall(begun + b"X-Y: " + 2**16 * b"z" + b"\r\n")

    def _send(self, connection: socket.socket, part: Part) -> None:
        data = pictures()[part.picture]
        length = str(len(data)).encode() if part.length is None else part.length
        head = part.boundary + part.ends + b"Content-Type: image/jpeg" + part.ends
        head += b"Content-Length: " + length + 2 * part.ends if length else part.ends
        connection.sendall(head + data + part.ends)
        time.sleep(part.pause_s)


@st.composite
def lines(draw: Any) -> tuple[bytes, ...]:
    """Strategy for data of a serial line, in pieces: whole and damaged packets, random bytes."""
    ids = st.sampled_from((0, 1, 2, 3, 4, 252, BROADCAST))
    data = st.binary(max_size=24) | st.sampled_from((HEADER, b"\xff\xff\xfd" * 5, bytes(380)))
    status = st.builds(status_packet, ids, data.map(lambda x: x[:370]), st.integers(0, 255))
    answered = st.sampled_from((3, 4, 10)).flatmap(lambda n: st.binary(min_size=n, max_size=n))
    answer = st.builds(status_packet, st.integers(1, 4), answered, st.sampled_from((0, 0, 0x80, 4)))
    echo = st.builds(instruction_packet, ids, st.sampled_from(list(Instruction)), st.just(b""))
    announced_ = st.builds(
        lambda id, length, rest: HEADER + bytes((id,)) + length.to_bytes(2, "little") + rest,
        st.integers(0, 255), st.integers(0, 65535) | st.integers(0, 12), data,
    )  # fmt: skip
    flood = st.sampled_from((HEADER * 50, b"\xff" * 5000))
    piece = answer | status | echo | announced_ | data | flood
    found = bytearray(b"".join(draw(st.lists(piece, max_size=8))))
    flips = st.tuples(st.integers(0, 2**12), st.integers(0, 7))
    for place, bit in draw(st.lists(flips, max_size=3)):
        if found:
            found[place % len(found)] ^= 1 << bit
    cuts = sorted({0, len(found), *draw(st.lists(st.integers(0, len(found)), max_size=6))})
    return tuple(bytes(found[a:b]) for a, b in pairwise(cuts))


class ForgedLine:
    """A serial line on which whatever is sent is answered by data, without end if it babbles."""

    port = "forged"

    def __init__(self, pieces: Sequence[bytes], babbles: bool) -> None:
        self._pieces = [piece for piece in pieces if piece]
        self._babbles = babbles
        self._waiting: list[bytes] = []

    def wire_s(self, count: int) -> float:
        return 1e-5 * count

    def send(self, data: bytes, timeout_s: float = 0.1) -> None:
        self._waiting = list(self._pieces)

    def receive(self, until_s: float) -> bytes:
        if not self._waiting and self._babbles:
            self._waiting = list(self._pieces)
        return self._waiting.pop(0) if self._waiting else b""

    def drain(self) -> bytes:
        return b"".join(self._pieces)

    def close(self) -> None:
        pass
