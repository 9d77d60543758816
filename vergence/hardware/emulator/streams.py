"""The cameras of an emulated head: the views of both eyes, drawn and streamed as MJPEG over HTTP.

Both cameras expose at a constant rate, on their own clock; the right one may be late by a constant
time, as with two unsynchronised cameras. An image is sent a latency and a random jitter after
mid-exposure; images are sent in the order of exposure.

This is a separate process, so that drawing does not delay the answers of the servos.
"""

import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Final
from urllib.parse import parse_qs

import cv2
import numpy as np

from vergence.envs.plants.cameras import BoardImageRenderer, RoomImageRenderer
from vergence.envs.reading import Image
from vergence.errors import HardwareError
from vergence.hardware.emulator.board import parse_sized_board
from vergence.hardware.emulator.camera_faults import CameraFaults
from vergence.hardware.emulator.client import WorldClient
from vergence.hardware.emulator.fault import parse_fault
from vergence.models.head_file import parse_head
from vergence.models.parts import EYE_NAMES
from vergence.vision.objects.scenes import Scene
from vergence.vision.targets import make_planar_target

_JPEG_QUALITY: Final = 92
"""JPEG quality, as for webcams (chosen)."""
_NOISE_EDGE_PX: Final = 16
"""Edge of the square of noise in a corner of every image, px: two JPEG blocks (chosen)."""
_NOISE_AMPLITUDE: Final = 32
"""Amplitude of this noise, grey levels: enough to survive JPEG (chosen)."""
_BOUNDARY: Final = b"frame"


@dataclass(frozen=True, kw_only=True)
class StreamConfig:
    """Timing and noise of the cameras."""

    frame_rate_hz: float
    """Frame rate, Hz."""
    latency_s: float
    """Latency from mid-exposure to the sending of the image, s."""
    jitter_s: float = 0.0
    """Greatest random delay of an image beyond the latency, s; uniform."""
    right_late_s: float = 0.0
    """Delay of the right camera's exposures after the left one's, s."""
    seed: int = 0
    """Random seed of image noise, jitter and camera faults."""


class _Stream:
    """The newest image of one eye, for any number of clients."""

    def __init__(self) -> None:
        self._new = threading.Condition()
        self._jpeg, self._count = b"", 0
        self._exposure_s = 0.0
        self._ended = False

    def publish(self, jpeg: bytes, exposure_s: float) -> None:
        """Publish an image; one that a later exposure has overtaken is dropped."""
        with self._new:
            if exposure_s >= self._exposure_s:
                self._jpeg, self._count = jpeg, self._count + 1
                self._exposure_s = exposure_s
                self._new.notify_all()

    def end(self, ended: bool) -> None:
        """Close the stream to all readers, or allow new ones again."""
        with self._new:
            self._ended = ended
            self._new.notify_all()

    def next(self, seen: int) -> tuple[bytes, int] | None:
        """Wait for an image after number `seen`; return it with its number, None at the end."""
        with self._new:
            self._new.wait_for(lambda: self._ended or self._count != seen)
            return None if self._ended else (self._jpeg, self._count)

    @property
    def has_ended(self) -> bool:
        return self._ended

    @property
    def count(self) -> int:
        return self._count


class EmulatedCameras:
    """Draws the images of both eyes and publishes them.

    Args:
        world: source of the joint angles and the target position.
        views: renderer of the images.
        config: timing and noise of the cameras.
        clock: a monotonic clock, s.
    """

    def __init__(
        self,
        world: WorldClient,
        views: BoardImageRenderer,
        config: StreamConfig,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.streams = (_Stream(), _Stream())
        self._world = world
        self._views = views
        self._config = config
        self._clock = clock
        self._rng = np.random.default_rng(config.seed)
        self._faults = CameraFaults(np.random.default_rng(config.seed))

    def draw(self) -> tuple[Image, Image]:
        """Draw both eyes' present images, without faults; fetch the active faults."""
        state = self._world.ask({"expose": None})
        self._faults.set_active(parse_fault(plain, (), timed=False) for plain in state["faults"])
        images = self._views.draw(
            np.array(state["positions"]),
            np.array(state["velocities"]),
            np.array(state["target"]),
            self._rng,
            np.array(state["target_velocity"]),
            state["target_axes"],
        )
        for image in images:
            # a plain background would make successive images identical, as no sensor does
            corner = image[-_NOISE_EDGE_PX:, :_NOISE_EDGE_PX]
            corner ^= self._rng.integers(_NOISE_AMPLITUDE, size=corner.shape, dtype=np.uint8)
        return images

    def run(self) -> None:
        """Expose, draw and publish until the world ends."""
        config, period_s = self._config, 1.0 / self._config.frame_rate_hz
        begun_s, sent_s = self._clock(), [0.0, 0.0]
        frame = 0
        while True:
            right_late_s = config.right_late_s + self._faults.right_exposure_delay_s % period_s
            together = right_late_s == 0.0
            for eye in (0,) if together else (0, 1):
                due_s = begun_s + frame * period_s + eye * right_late_s
                time.sleep(max(due_s - self._clock(), 0.0))
                exposed_s = self._clock()
                images = self.draw()
                for one in (0, 1) if together else (eye,):
                    late_s = config.latency_s + config.jitter_s * float(self._rng.random())
                    late_s += self._faults.send_delay_s(one)
                    sent_s[one] = max(sent_s[one], exposed_s + late_s)
                    self._send(one, images[one], exposed_s, sent_s[one])
            # frames whose time has passed are skipped
            frame = max(frame + 1, int((self._clock() - begun_s) * config.frame_rate_hz))

    def _send(self, eye: int, new: Image, exposed_s: float, at_s: float) -> None:
        """Publish an image exposed at one time at another, after applying the faults."""
        stream = self.streams[eye]
        stream.end(self._faults.has_ended(eye))
        image = self._faults.apply_to_image(eye, new)
        if image is None:
            return
        jpeg = _jpeg(image)
        delay_s = max(at_s - self._clock(), 0.0)
        timer = threading.Timer(delay_s, stream.publish, (jpeg, exposed_s))
        timer.daemon = True
        timer.start()


def _jpeg(image: Image) -> bytes:
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


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
            if stream.has_ended:
                self.send_error(503, "the stream has ended")
                return
            self.send_response(200)
            self.send_header(
                "Content-Type", f"multipart/x-mixed-replace; boundary={_BOUNDARY.decode()}"
            )
            self.end_headers()
            seen = stream.count
            try:
                self.wfile.write(b"--" + _BOUNDARY + b"\r\n")
                left = int(images)
                while left != 0:
                    left -= 1
                    newest = stream.next(seen)
                    if newest is None:
                        return
                    jpeg, seen = newest
                    # the boundary follows the image at once: else a reader waits for the next image
                    self.wfile.write(
                        b"Content-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(jpeg)
                        + jpeg
                        + b"\r\n--"
                        + _BOUNDARY
                        + b"\r\n"
                    )
            except OSError:  # the reader has disconnected
                pass

    server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
    server.daemon_threads = True
    return server


def run_streams(
    head_toml: str,
    config: StreamConfig,
    world_address: str,
    port: int,
    board_text: str | None = None,
    scene: Scene | None = None,
) -> None:
    """Draw and stream until the world ends: the main function of the cameras' process.

    Args:
        head_toml: the text of the head's file.
        config: timing and noise of the cameras.
        world_address: HOST:PORT of the world.
        port: port of the streams; 0 for any free port.
        board_text: the board before the head, at its own size; None for a tag whose size in the
            image does not depend on its distance.
        scene: the room, and the object in it; None for a board before plain grey.
    """
    cv2.setNumThreads(1)
    model = parse_head(head_toml)
    client = WorldClient(world_address)
    if scene is not None:
        views: BoardImageRenderer = RoomImageRenderer(model, scene)
    elif board_text is None:
        views = BoardImageRenderer(model, make_planar_target("tag"), width_rad="fit")
    else:
        views = BoardImageRenderer(model, parse_sized_board(board_text))
    cameras = EmulatedCameras(client, views, config)
    cameras.draw()  # compiles everything before the first reader
    server = make_stream_server(cameras, port)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    client.ask({"streams": f"http://127.0.0.1:{server.server_address[1]}"})
    try:
        cameras.run()
    except (HardwareError, KeyboardInterrupt):
        pass
    finally:
        server.shutdown()
