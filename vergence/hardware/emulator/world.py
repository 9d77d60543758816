"""The world of an emulated head: its servos on a pseudo-terminal, and the target before it.

One thread serves the serial line and the connections that ask for the state or place the target.
Joints move by the package's joint law, lazily and exactly: whatever is asked for brings them to the
present first.
"""

import json
import os
import selectors
import socket
import sys
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from vergence.envs.targets.motion import (
    MOTION,
    is_shown,
    motion_of,
    motion_rows,
    target_position,
)
from vergence.errors import ConfigurationError
from vergence.hardware.config import actuator_slots
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.packets import Parser
from vergence.hardware.emulator.servos import Servo, ServoLine
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_BITS: Final = 10
"""Of a byte on the line, with start and stop."""
_DIFFERENCE_S: Final = 1e-4
_EXPOSURES: Final = 1024
"""How many of the last exposures' times are kept."""
_GARBAGE: Final = (
    ValueError,
    TypeError,
    KeyError,
    AttributeError,
    OverflowError,
    RecursionError,
    ConfigurationError,
)
"""Errors of a request that is none."""


class World:
    """A head's joints and its target, in real time.

    Args:
        head: the head that really moves.
        point: (3,) where the target is until another one is placed, in N, m.
        speed_filter_s: time constant of the filter through which servos report speeds, s.
    """

    def __init__(self, head: HeadModel, point: FloatArray, speed_filter_s: float = 0.0) -> None:
        self.head = head
        self._slots = actuator_slots(head)
        actuation, timing = head.actuation, head.timing
        start = actuation.actuators_of(head.rest())
        self.servos = {
            name: Servo(
                ident,
                lower=float(actuation.lower[slot]),
                upper=float(actuation.upper[slot]),
                lag_s=float(timing.lag_s * actuation.lag_ratio[slot]),
                acceleration=float(actuation.acceleration[slot]),
                position_rad=float(start[slot]),
                speed_filter_s=speed_filter_s,
            )
            for ident, (name, slot) in enumerate(self._slots.items(), 1)
        }
        self.line = ServoLine(self.servos.values())
        self._motion = motion_rows(point, before=point)
        self._begun_s = np.inf
        self._T_0_N = head.base_pose(head.rest())

    def show(self, motion: list[float]) -> None:
        """Place another target; its own time begins with `begin`."""
        row = np.array([motion], dtype=np.float64)
        if row.ndim != 2 or row.shape[1] < MOTION:
            raise ConfigurationError(f"show: expected {MOTION} numbers or more, got {row.size}")
        self._motion, self._begun_s = row, np.inf
        self._T_0_N = self.head.base_pose(self._joints()[0])

    def begin(self, now_s: float) -> None:
        """Let the target's own time begin."""
        self._begun_s = now_s

    def _joints(self) -> tuple[FloatArray, FloatArray]:
        own = np.zeros((2, 7))
        for name, servo in self.servos.items():
            own[:, self._slots[name]] = servo.q, servo.v
        return self.head.actuation.joints_of(own[0]), own[1]

    def state(self, now_s: float) -> dict[str, Any]:
        """What is true at a time.

        Args:
            now_s: s of the monotonic clock, not before any that was asked for.
        """
        self.line.to(now_s)
        motors = self.head.actuation.actuators_of(q := self._joints()[0])
        v = self._joints()[1]
        if not self.head.actuation.direct:
            v[3:] = self.head.actuation.to_joints @ v[3:]
        own_s = now_s - self._begun_s
        times = max(own_s, -1e9) + _DIFFERENCE_S * np.array([-0.5, 0.5])
        before, after = target_position(np.repeat(self._motion, 2, axis=0), times)
        T_N_now = np.linalg.inv(self.head.base_pose(q)) @ self._T_0_N
        point = T_N_now[:3, :3] @ (0.5 * (before + after)) + T_N_now[:3, 3]
        velocity = T_N_now[:3, :3] @ ((after - before) / _DIFFERENCE_S)
        if not is_shown(motion_of(self._motion[0]), own_s):
            point = np.full(3, np.nan)
        return {
            "time": now_s,
            "positions": q.tolist(),
            "velocities": v.tolist(),
            "motors": motors.tolist(),
            "target": point.tolist(),
            "target_velocity": velocity.tolist(),
            "pixels": self.head.project(q, point).tolist(),
            "trips": self.line.trips,
        }


class WorldServer:
    """Serves a world: its servos' line and its connections, in one thread.

    Args:
        world: what is served.
        baud_rate: of the line, by which answers take their time.
        clock: the monotonic clock, s.

    Attributes:
        port: the device file of the line's other end.
        address: HOST:PORT for connections.
        streams: where the cameras' process has said that it streams; empty until then.
    """

    def __init__(
        self,
        world: World,
        baud_rate: int = 1_000_000,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if sys.platform == "win32":
            raise ConfigurationError(
                "emulate: expected Linux or macOS, whose pseudo-terminals stand for a serial line"
            )
        import tty

        self._world = world
        self._byte_s = _BITS / baud_rate
        self._clock = clock
        self._parser = Parser()
        self._own, self._other = os.openpty()
        tty.setraw(self._other)
        self.port = os.ttyname(self._other)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self.streams = ""
        self._exposed_s: deque[float] = deque(maxlen=_EXPOSURES)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._own, selectors.EVENT_READ, self._answer_line)
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)

    def serve(self, until: Callable[[], bool], poll_s: float = 0.2) -> None:
        """Serve until something is true, which is looked at now and then."""
        while not until():
            for key, _ in self._selector.select(poll_s):
                key.data()

    def _answer_line(self) -> None:
        data = os.read(self._own, 4096)
        for packet in self._parser.feed(data):
            answer = self._world.line.answer(packet, self._clock())
            if answer:
                # question and answer take their time on the line
                time.sleep(self._byte_s * (len(data) + len(answer)))
                os.write(self._own, answer)

    def _accept(self) -> None:
        connection, _ = self._listener.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        lines = _Lines(connection, self._reply, self._selector)
        self._selector.register(connection, selectors.EVENT_READ, lines.read)

    def _reply(self, line: bytes) -> bytes:
        try:
            request = json.loads(line)
            answer = self._do(request)
        except _GARBAGE as error:
            answer = {"error": f"expected a request, got {line[:80]!r}: {error}"}
        return json.dumps(answer).encode() + b"\n"

    def _do(self, request: dict[str, Any]) -> dict[str, Any]:
        if "state" in request:
            return self._world.state(self._clock())
        if "expose" in request:
            state = self._world.state(self._clock())
            self._exposed_s.append(state["time"])
            return state
        if "exposures" in request:
            return {"times": list(self._exposed_s)}
        if "show" in request:
            self._world.show(request["show"])
        elif "begin" in request:
            self._world.begin(float(request["begin"]))
        elif "unplug" in request:
            self._unplug()
        elif "streams" in request:
            self.streams = str(request["streams"])
        else:
            raise ConfigurationError("no such request")
        return {}

    def _unplug(self) -> None:
        """Pull the cable: the line's other end hears nothing any more."""
        if self._own >= 0:
            self._selector.unregister(self._own)
            os.close(self._own)
            os.close(self._other)
            self._own = self._other = -1

    def close(self) -> None:
        """Close the line and all connections."""
        self._unplug()
        for key in list(self._selector.get_map().values()):
            if isinstance(key.fileobj, socket.socket):
                key.fileobj.close()
        self._selector.close()


class _Lines:
    """Requests of one connection, a line each."""

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


def desk(head: str, world: World, server: WorldServer, target: str) -> dict[str, Any]:
    """The plain values of a configuration of this emulated head, see `vergence.hardware.config`.

    Args:
        head: the head's preset or file.
        world: the world.
        server: serves it.
        target: what the cameras see, see `parse_target`.
    """
    return {
        "head": head,
        "head_digest": world.head.digest[:16],
        "target": target,
        "bus": {"port": server.port, "baud_rate": 1_000_000, "watchdog_s": 0.2},
        "servos": [
            {"name": name, "id": servo.id, "zero_ticks": table.CENTRE_TICKS, "sign": 1}
            for name, servo in world.servos.items()
        ],
        "cameras": {name: {"source": f"{server.streams}/{name}"} for name in ("left", "right")},
        "emulator": {"address": server.address},
    }
