"""A server of an emulated head's world: the servos' serial line and TCP connections, in one thread.

A client sends one JSON object per line and receives one. The object's only key is

    state                       ground truth
    expose                      ground truth and camera faults, at the exposure of an image
    exposures                   times of the last exposures: {"times": [s, ...]}
    show, begin                 place a target, and start its time
    streams                     set the URL of the cameras' streams
    fault, clear                begin a fault (see `parse_fault`), and end all: {"time": s}
    unplug                      pull the cable of the line
    rest                        {"since": s}, see `World.rest_report`
    record                      see `World.motion_since_last_call`

Times are those of the monotonic clock.
"""

import json
import logging
import selectors
import socket
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from vergence.errors import ConfigurationError, HeadFileError
from vergence.hardware.dynamixel.packets import PacketParser
from vergence.hardware.emulator.fault import parse_fault
from vergence.hardware.emulator.terminal import PseudoTerminal
from vergence.hardware.emulator.world import World

_LOG: Final = logging.getLogger(__name__)
_BITS_PER_BYTE: Final = 10
"""Bits of a byte on the line, with start and stop bit (physical: 8N1 serial)."""
_MAX_SEND_WAIT_S: Final = 0.005
"""Answers due sooner than this are sent before the next request is served, s (chosen)."""
_KEPT_EXPOSURES: Final = 1024
"""Number of exposure times that are kept (numerical)."""
_REQUEST_ERRORS: Final = (
    ValueError,
    TypeError,
    KeyError,
    AttributeError,
    OverflowError,
    RecursionError,
    ConfigurationError,
)
"""Errors that an invalid request raises."""


class EmulatorServer:
    """Serves an emulated head: servos on a pseudo-terminal, and its world over TCP.

    One thread does both; `serve` blocks.

    Args:
        world: the world to serve.
        clock: the monotonic clock, s.

    Attributes:
        port: the device file of the line's other end.
        address: HOST:PORT for connections.
        streams: URL of the streams, set by the cameras' process; empty until then.

    Raises:
        ConfigurationError: the system has no pseudo-terminals.
    """

    def __init__(self, world: World, clock: Callable[[], float] = time.monotonic) -> None:
        self._world = world
        self._clock = clock
        self._parser = PacketParser()
        self._terminal = PseudoTerminal()
        self.port = self._terminal.port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self.streams = ""
        self._exposed_s: deque[float] = deque(maxlen=_KEPT_EXPOSURES)
        # not epoll, whose timeout has a resolution of 1 ms
        self._selector = selectors.SelectSelector()
        self._selector.register(self._terminal.fd, selectors.EVENT_READ, self._answer_line)
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)

    def serve(self, until: Callable[[], bool], poll_s: float = 0.2) -> None:
        """Serve until `until`, which is polled at least every `poll_s`, returns True."""
        while not until():
            due_s = min(self._terminal.due_s, self._world.faults.due_s)
            wait_s = min(max(due_s - self._clock(), 0.0), poll_s)
            for key, _ in self._selector.select(wait_s):
                key.data()
            self._keep_up()

    def _keep_up(self) -> None:
        """Advance due faults and send due answers."""
        now_s = self._clock()
        if self._world.faults.due_s <= now_s:
            self._world.advance_to(now_s)
        if self._world.faults.unplugged:
            self._unplug()
        # answers due soon are sent before the next request is served, which may take longer
        left_s = self._terminal.due_s - now_s
        if 0.0 < left_s < _MAX_SEND_WAIT_S:
            time.sleep(left_s)
        self._terminal.flush(self._clock())

    def _answer_line(self) -> None:
        if self._terminal.fd < 0:  # unplugged by a request of the same round
            return
        data, rate = self._terminal.read(), self._terminal.baud_rate
        for packet in self._parser.feed(data):
            now_s = self._clock()
            sent = self._world.answer(packet, now_s, rate)
            # request and answer take time on the line
            count = len(data) + sum(len(answer) for _, answer in sent)
            for delay_s, answer in sent:
                self._terminal.send(answer, now_s + delay_s + _BITS_PER_BYTE * count / rate)

    def _accept(self) -> None:
        connection, (host, port) = self._listener.accept()
        _LOG.info("client connected from %s:%d", host, port)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        lines = _Lines(connection, self._reply, self._selector)
        self._selector.register(connection, selectors.EVENT_READ, lines.read)

    def _reply(self, line: bytes) -> bytes:
        try:
            request = json.loads(line)
            answer = self._do(request)
        except HeadFileError as error:
            answer = {"error": str(error)}
        except _REQUEST_ERRORS as error:
            answer = {"error": f"expected a request, got {line[:80]!r}: {error}"}
        return json.dumps(answer).encode() + b"\n"

    def _do(self, request: dict[str, Any]) -> dict[str, Any]:
        now_s, world = self._clock(), self._world
        if "state" in request:
            return world.state(now_s)
        if "expose" in request:
            self._exposed_s.append(now_s)
            cameras = [fault.to_plain() for fault in world.faults.active_on("camera")]
            return {**world.state(now_s), "faults": cameras}
        if "exposures" in request:
            return {"times": list(self._exposed_s)}
        if "rest" in request:
            return world.rest_report(float(request["rest"]["since"]), now_s)
        if "record" in request:
            return world.motion_since_last_call(now_s)
        if "fault" in request:
            world.begin_fault(parse_fault(request["fault"], world.ids, timed=False), now_s)
            return {"time": now_s}
        if "clear" in request:
            world.clear_faults(now_s)
            return {"time": now_s}
        if "show" in request:
            world.place_target(request["show"])
        elif "begin" in request:
            world.start_target_motion(float(request["begin"]))
        elif "unplug" in request:
            self._unplug()
        elif "streams" in request:
            self.streams = str(request["streams"])
        else:
            raise ConfigurationError("no such request")
        return {}

    def _unplug(self) -> None:
        """Pull the cable: the line's other end receives nothing more."""
        if self._terminal.fd >= 0:
            self._selector.unregister(self._terminal.fd)
            self._terminal.unplug()

    def close(self) -> None:
        """Close the line and all connections."""
        self._unplug()
        for key in list(self._selector.get_map().values()):
            if isinstance(key.fileobj, socket.socket):
                key.fileobj.close()
        self._selector.close()


class _Lines:
    """Splits the data of one connection into requests, a line each."""

    def __init__(
        self,
        connection: socket.socket,
        reply: Callable[[bytes], bytes],
        selector: selectors.BaseSelector,
    ) -> None:
        self._connection = connection
        self._reply = reply
        self._selector = selector
        self._rest = b""

    def read(self) -> None:
        try:
            data = self._connection.recv(65536)
            *lines, self._rest = (self._rest + data).split(b"\n")
            for line in lines:
                self._connection.sendall(self._reply(line))
        except OSError:
            data = b""
        if not data:
            self._selector.unregister(self._connection)
            self._connection.close()
