"""Servers of an emulated head: the servos' serial line, its world over TCP, and image streams.

One thread serves line and world. A client of the world sends one JSON object per line and receives
one. The object's only key is

    state                       ground truth
    expose                      ground truth and camera faults, at the exposure of an image
    exposures                   times of the last exposures: {"times": [s, ...]}
    show, begin                 place a target, and start its time
    turn                        put joints at angles, see `WorldClient.turn`
    streams                     set the URL of the cameras' streams
    fault, clear                begin a fault (see `parse_fault`), and end all: {"time": s}
    rest                        {"since": s}, see `World.rest_report`

Times are those of the monotonic clock.

The views of both eyes are drawn, and streamed as MJPEG over HTTP, by a process of its own, so that
drawing does not delay the servos' answers. Both cameras expose at a constant rate; the right one
may be late by a constant time, as with two unsynchronised cameras. An image is sent a latency and a
random jitter after mid-exposure, in the order of exposure.
"""

import heapq
import json
import logging
import multiprocessing
import os
import re
import selectors
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from math import inf
from typing import Any, Final
from urllib.parse import parse_qs

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from vergence.envs.plants.cameras import BoardImageRenderer, RoomImageRenderer
from vergence.envs.reading import Image
from vergence.errors import ConfigurationError, HardwareError, HeadFileError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.packets import PacketParser
from vergence.hardware.emulator.client import WorldClient
from vergence.hardware.emulator.config import EmulatorConfig
from vergence.hardware.emulator.faults import CameraFaults, load_faults, parse_fault
from vergence.hardware.emulator.world import World
from vergence.models.head import HeadModel
from vergence.models.head_file import absolute_source, head_to_toml, load_head, parse_head
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.models.perturbation import ModelErrors
from vergence.models.toml_table import toml_text
from vergence.vision.objects.scenes import Scene, parse_scene
from vergence.vision.targets import PlanarTarget, TagFamily, make_planar_target, parse_target

_LOG: Final = logging.getLogger(__name__)
_MAX_READ_BYTES: Final = 4096
"""Most bytes of one read of the line (numerical)."""
_BITS_PER_BYTE: Final = 10
"""Bits of a byte on the line, with start and stop bit (physical: 8N1 serial)."""
_MAX_SEND_WAIT_S: Final = 0.005
"""Answers due sooner than this are sent before the next request is served, s (chosen)."""
_KEPT_EXPOSURES: Final = 1024
"""Number of exposure times that are kept (numerical)."""
_REQUEST_ERRORS: Final = (
    ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError,
    ConfigurationError,
)  # fmt: skip


def baud_rate_of(fd: int) -> int:
    """Baud rate set on a terminal, bit/s; 0 for one that servos or the system do not support."""
    import termios

    speed = termios.tcgetattr(fd)[5]
    return next((one for one in table.BAUD_RATES if getattr(termios, f"B{one}", -1) == speed), 0)


class EmulatorServer:
    """Serves an emulated head: servos on a pseudo-terminal, and its world over TCP.

    `port` is the device file of the line's other end, `address` HOST:PORT for connections, and
    `streams` the URL of the streams, which the cameras' process sets.

    Raises:
        ConfigurationError: the system has no pseudo-terminals.
    """

    def __init__(self, world: World, clock: Callable[[], float] = time.monotonic) -> None:
        if sys.platform == "win32":
            raise ConfigurationError(
                "emulate: expected Linux or macOS, whose pseudo-terminals stand for a serial line"
            )
        import tty

        self._world, self._clock = world, clock
        self._parser = PacketParser()
        self._line, self._other_end = os.openpty()
        tty.setraw(self._other_end)
        self.port = os.ttyname(self._other_end)
        self._due: list[tuple[float, int, bytes]] = []  # answers with their times and numbers
        self._answers = 0  # their number keeps the order of those with equal times
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self.streams = ""
        self._exposed_s: deque[float] = deque(maxlen=_KEPT_EXPOSURES)
        # not epoll, whose timeout has a resolution of 1 ms
        self._selector = selectors.SelectSelector()
        self._selector.register(self._line, selectors.EVENT_READ, self._answer_line)
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)

    def serve(self, until: Callable[[], bool], poll_s: float = 0.2) -> None:
        """Serve until `until`, which is polled at least every `poll_s`, returns True."""
        while not until():
            due_s = min(self._due_s, self._world.faults.due_s)
            wait_s = min(max(due_s - self._clock(), 0.0), poll_s)
            for key, _ in self._selector.select(wait_s):
                key.data()
            self._keep_up()

    @property
    def _due_s(self) -> float:
        """Time at which the next answer is due, s; inf for none."""
        return self._due[0][0] if self._due else inf

    def _keep_up(self) -> None:
        """Advance due faults and send due answers."""
        now_s = self._clock()
        if self._world.faults.due_s <= now_s:
            self._world.advance_to(now_s)
        if self._world.faults.unplugged:
            self._unplug()
        # answers due soon are sent before the next request is served, which may take longer
        left_s = self._due_s - now_s
        if 0.0 < left_s < _MAX_SEND_WAIT_S:
            time.sleep(left_s)
        now_s = self._clock()
        while self._due_s <= now_s:
            os.write(self._line, heapq.heappop(self._due)[2])

    def _answer_line(self) -> None:
        data, rate = os.read(self._line, _MAX_READ_BYTES), baud_rate_of(self._line)
        for packet in self._parser.feed(data):
            now_s = self._clock()
            sent = self._world.answer(packet, now_s, rate)
            # request and answer take time on the line
            count = len(data) + sum(len(answer) for _, answer in sent)
            for delay_s, answer in sent:
                self._answers += 1
                at_s = now_s + delay_s + _BITS_PER_BYTE * count / rate
                heapq.heappush(self._due, (at_s, self._answers, answer))

    def _accept(self) -> None:
        connection, (host, port) = self._listener.accept()
        _LOG.info("client connected from %s:%d", host, port)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        rest = b""

        def answer_lines() -> None:
            nonlocal rest
            try:
                data = connection.recv(65536)
                *lines, rest = (rest + data).split(b"\n")
                for line in lines:
                    connection.sendall(self._reply(line))
            except OSError:
                data = b""
            if not data:
                self._selector.unregister(connection)
                connection.close()

        self._selector.register(connection, selectors.EVENT_READ, answer_lines)

    def _reply(self, line: bytes) -> bytes:
        try:
            answer = self._do(json.loads(line))
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
        elif "turn" in request:
            world.turn(request["turn"], now_s)
        elif "streams" in request:
            self.streams = str(request["streams"])
        else:
            raise ConfigurationError("no such request")
        return {}

    def _unplug(self) -> None:
        """Pull the cable of the line; a second call does nothing."""
        if self._line >= 0:
            self._selector.unregister(self._line)
            self._due.clear()
            os.close(self._line)
            os.close(self._other_end)
            self._line = -1

    def close(self) -> None:
        """Close the line and all connections."""
        self._unplug()
        for key in list(self._selector.get_map().values()):
            if isinstance(key.fileobj, socket.socket):
                key.fileobj.close()
        self._selector.close()


_JPEG_QUALITY: Final = 92
"""JPEG quality, as for webcams (chosen)."""
_NOISE_EDGE_PX: Final = 16
"""Edge of the square of noise in a corner of every image, px: two JPEG blocks (chosen)."""
_NOISE_AMPLITUDE: Final = 32
"""Amplitude of this noise, grey levels: enough to survive JPEG (chosen)."""


class _Stream:
    """The newest image of one eye, for any number of clients."""

    def __init__(self) -> None:
        self._new = threading.Condition()
        self._jpeg, self.count = b"", 0
        self._exposure_s = 0.0
        self.ended = False

    def publish(self, jpeg: bytes, exposure_s: float) -> None:
        """Publish an image; one that a later exposure has overtaken is dropped."""
        with self._new:
            if exposure_s >= self._exposure_s:
                self._jpeg, self.count = jpeg, self.count + 1
                self._exposure_s = exposure_s
                self._new.notify_all()

    def end(self, ended: bool) -> None:
        """Close the stream to all readers, or allow new ones again."""
        with self._new:
            self.ended = ended
            self._new.notify_all()

    def next(self, seen: int) -> tuple[bytes, int] | None:
        """Wait for an image after number `seen`; return it with its number, None at the end."""
        with self._new:
            self._new.wait_for(lambda: self.ended or self.count != seen)
            return None if self.ended else (self._jpeg, self.count)


class EmulatedCameras:
    """Draws the images of both eyes at a frame rate, Hz, and publishes them a latency later, s."""

    def __init__(
        self,
        world: WorldClient,
        views: BoardImageRenderer,
        config: EmulatorConfig,
        frame_rate_hz: float,
        latency_s: float,
    ) -> None:
        self.streams = (_Stream(), _Stream())
        self._world, self._views, self._config = world, views, config
        self._frame_rate_hz, self._latency_s = frame_rate_hz, latency_s
        self._rng = np.random.default_rng(config.seed)
        self._faults = CameraFaults(np.random.default_rng(config.seed))

    def draw(self) -> tuple[Image, Image]:
        """Draw both eyes' present images, without faults; fetch the active faults."""
        state = self._world.ask({"expose": None})
        self._faults.set_active(parse_fault(plain, (), timed=False) for plain in state["faults"])
        keys = ("positions", "velocities", "target", "target_velocity")
        q, v, target, moves = (np.array(state[key]) for key in keys)
        images = self._views.draw(q, v, target, self._rng, moves, state["target_axes"])
        for image in images:
            # a plain background would make successive images identical, as no sensor does
            corner = image[-_NOISE_EDGE_PX:, :_NOISE_EDGE_PX]
            corner ^= self._rng.integers(_NOISE_AMPLITUDE, size=corner.shape, dtype=np.uint8)
        return images

    def run(self) -> None:
        """Expose, draw and publish until the world ends."""
        config, period_s = self._config, 1.0 / self._frame_rate_hz
        begun_s, sent_s = time.monotonic(), [0.0, 0.0]
        frame = 0
        while True:
            right_late_s = config.right_late_s + self._faults.right_exposure_delay_s % period_s
            together = right_late_s == 0.0
            for eye in (0,) if together else (0, 1):
                due_s = begun_s + frame * period_s + eye * right_late_s
                time.sleep(max(due_s - time.monotonic(), 0.0))
                exposed_s = time.monotonic()
                images = self.draw()
                for one in (0, 1) if together else (eye,):
                    late_s = self._latency_s + config.jitter_s * float(self._rng.random())
                    late_s += self._faults.send_delay_s(one)
                    sent_s[one] = max(sent_s[one], exposed_s + late_s)
                    self._send(one, images[one], exposed_s, sent_s[one])
            # frames whose time has passed are skipped
            frame = max(frame + 1, int((time.monotonic() - begun_s) * self._frame_rate_hz))

    def _send(self, eye: int, new: Image, exposed_s: float, at_s: float) -> None:
        """Publish an image exposed at one time at another, after applying the faults."""
        stream = self.streams[eye]
        stream.end(self._faults.has_ended(eye))
        image = self._faults.apply_to_image(eye, new)
        if image is None:
            return
        quality = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
        jpeg = cv2.imencode(".jpg", image, quality)[1].tobytes()
        delay_s = max(at_s - time.monotonic(), 0.0)
        timer = threading.Timer(delay_s, stream.publish, (jpeg, exposed_s))
        timer.daemon = True
        timer.start()


def make_stream_server(cameras: EmulatedCameras, port: int) -> ThreadingHTTPServer:
    """Make a server of the streams /left and /right on the loopback; port 0 for any free port.

    A request may limit the number of images: /left?images=90.
    """
    streams = dict(zip((f"/{name}" for name in EYE_NAMES), cameras.streams, strict=True))

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.0"

        def log_message(self, format: str, *args: object) -> None:
            pass

        def do_GET(self) -> None:
            path, _, query = self.path.partition("?")
            images = parse_qs(query).get("images", ["-1"])[0]
            stream = streams.get(path)
            if stream is None or re.fullmatch(r"-1|[0-9]{1,9}", images) is None:
                self.send_error(404, "expected /left or /right, or /left?images=90")
                return
            if stream.ended:
                self.send_error(503, "the stream has ended")
                return
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            seen, left = stream.count, int(images)
            try:
                self.wfile.write(b"--frame\r\n")
                while left != 0 and (newest := stream.next(seen)) is not None:
                    left -= 1
                    jpeg, seen = newest
                    head = b"Content-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(jpeg)
                    # the boundary follows the image at once: else a reader waits for the next image
                    self.wfile.write(head + jpeg + b"\r\n--frame\r\n")
            except OSError:  # the reader has disconnected
                pass

    server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
    server.daemon_threads = True
    return server


def run_streams(
    head_toml: str,
    config: EmulatorConfig,
    frame_rate_hz: float,
    latency_s: float,
    scene: Scene | None,
    world_address: str,
) -> None:
    """Draw and stream until the world ends: the main function of the cameras' process."""
    cv2.setNumThreads(1)
    model = parse_head(head_toml)
    client = WorldClient(world_address)
    if scene is not None:
        views: BoardImageRenderer = RoomImageRenderer(model, scene)
    elif config.board is not None:
        views = BoardImageRenderer(model, parse_sized_board(config.board))
    else:  # a tag whose size in the image does not depend on its distance
        views = BoardImageRenderer(model, make_planar_target("tag"), width_rad="fit")
    cameras = EmulatedCameras(client, views, config, frame_rate_hz, latency_s)
    cameras.draw()  # compiles everything before the first reader
    server = make_stream_server(cameras, config.port)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    client.ask({"streams": f"http://127.0.0.1:{server.server_address[1]}"})
    try:
        cameras.run()
    except (HardwareError, KeyboardInterrupt):
        pass
    finally:
        server.shutdown()


_BOARD_OFFSET_M: Final = (0.03, -0.02)
"""Offset of a board's centre from the line straight ahead, right and down, m (chosen)."""
_TILT_RAD: Final = (0.25, -0.3, 0.05)
"""Rotation vector of a board away from facing the head, rad: a tilted board makes focal lengths
observable (chosen)."""


def parse_sized_board(text: str) -> PlanarTarget:
    """Parse the description of a board of known size, see `parse_target`."""
    target = parse_target(text)
    if isinstance(target, TagFamily) or not target.size_known:
        raise ConfigurationError(
            "board: expected one board of a known size, such as checkerboard:9x6:24 (inner "
            f"corners, square in mm), got {text}"
        )
    return target


def tilted_board_pose(head: HeadModel, target: PlanarTarget, distance_m: float) -> FloatArray:
    """(4, 4) pose T_0_T of a board at a distance ahead of a head at rest, slightly tilted, m."""
    T_N_T = np.eye(4)
    T_N_T[:3, :3] = Rotation.from_rotvec(_TILT_RAD).as_matrix()
    middle = T_N_T[:3, :2] @ target.corners_m.mean(axis=0)
    T_N_T[:3, 3] = np.array([*_BOARD_OFFSET_M, distance_m]) - middle
    return np.asarray(head.base_pose(head.rest()) @ T_N_T)


def emulate(
    config: EmulatorConfig,
    on_config_ready: Callable[[str], None],
    should_stop: Callable[[], bool] = lambda: False,
    model_errors: ModelErrors | None = None,
) -> None:
    """Emulate a head until `should_stop`, which is polled, returns True, or Ctrl-C.

    When servos and streams answer, `on_config_ready` is called with the text of a configuration for
    controllers, see `vergence.hardware.config`. The head that really moves and sees differs from
    that of `config` by `model_errors`.

    Raises:
        VergenceError: there is no such head or board, or the script of faults is invalid.
        HardwareError: the cameras' process has ended.
    """
    head = true = load_head(config.head)
    if model_errors:
        # the same draw as `GazeTask`'s with this seed for its model's
        true = head.perturbed(np.random.default_rng(config.seed), model_errors)
    board = T_0_T = scene = None
    if config.board is not None:
        board = parse_sized_board(config.board)
        T_0_T = tilted_board_pose(head, board, config.board_distance_m)
    if config.scene is not None or config.wall is not None:
        scene = parse_scene(config.scene or "ball", str(config.wall) if config.wall else None)
    world = World(true, np.asarray(config.target_mm) / 1000.0, config, config.seed, T_0_T)
    if config.faults is not None:
        world.faults.schedule(load_faults(config.faults, world.ids))
    server = EmulatorServer(world)
    latency_s = head.timing.latency_s if config.latency_s is None else config.latency_s
    shown = (head_to_toml(true), config, head.timing.frame_rate_hz, latency_s, scene)
    spawn = multiprocessing.get_context("spawn")
    process = spawn.Process(target=run_streams, args=(*shown, server.address), daemon=True)
    process.start()
    try:
        server.serve(lambda: bool(server.streams) or not process.is_alive())
        if server.streams:
            target = str(board or make_planar_target("tag")) if scene is None else scene.target
            source = absolute_source(config.head)
            on_config_ready(
                toml_text(hardware_config_values(source, head.digest, world, server, target))
            )
            server.serve(lambda: should_stop() or not process.is_alive())
        if not should_stop() and not process.is_alive():
            raise HardwareError("emulate: the process of the cameras has ended")
    except KeyboardInterrupt:
        pass
    finally:
        server.close()
        process.terminate()
        process.join()


def hardware_config_values(
    head_source: str, head_digest: str, world: World, server: EmulatorServer, target: str
) -> dict[str, Any]:
    """The plain values of a configuration of this emulated head, see `vergence.hardware.config`."""
    return {
        "head": head_source,
        "head_digest": head_digest[:16],
        "target": target,
        "bus": {"port": server.port, "baud_rate": 1_000_000, "watchdog_s": 0.2},
        "servos": [
            {"name": name, "id": servo.id, "zero_ticks": table.CENTRE_TICKS, "sign": 1}
            for name, servo in world.servos.items()
        ],
        "cameras": {name: {"source": f"{server.streams}/{name}"} for name in ("left", "right")},
        "emulator": {"address": server.address, "places_targets": world.places_targets},
    }
