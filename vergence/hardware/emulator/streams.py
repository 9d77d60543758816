"""The cameras of an emulated head: what each eye sees, drawn and streamed as MJPEG over HTTP.

Both cameras expose on a clock of their own, at a constant rate; the right one may be late by a
constant time, as two cameras are that nothing synchronises. An image is sent a latency and a jitter
after the middle of its exposure, in the order of exposure.

This is a process of its own, so that drawing does not delay what the servos answer.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Final
from urllib.parse import parse_qs

import cv2
import numpy as np

from vergence.envs.plants.eye_views import EyeViews
from vergence.envs.reading import Image
from vergence.errors import HardwareError
from vergence.hardware.emulator.board import parse_standing
from vergence.hardware.emulator.camera_faults import CameraFaults
from vergence.hardware.emulator.client import EmulatedWorld
from vergence.hardware.emulator.fault import parse_fault
from vergence.models.boards import make_planar_target
from vergence.models.files.head_toml import parse_head
from vergence.models.joints import EYE_NAMES

_QUALITY: Final = 92
"""Of JPEG, as webcams have it."""
_NOISY_PX: Final = 16
"""Edge of the corner of each image that has noise whatever the eye sees: two blocks of JPEG."""
_NOISY_GREY: Final = 32
"""Its noise, that JPEG leaves something of."""
_BOUNDARY: Final = b"frame"


@dataclass(frozen=True, kw_only=True)
class StreamConfig:
    """What the cameras are like."""

    frame_rate_hz: float
    """Images a second."""
    latency_s: float
    """From the middle of an exposure to its being sent, s."""
    jitter_s: float = 0.0
    """The most by which an image is sent later than that, s; uniform."""
    right_late_s: float = 0.0
    """By how much the right camera exposes later than the left one, s."""
    seed: int = 0
    """Of the noise of images and the jitter."""


class _Stream:
    """The newest image of one eye, for any number of clients."""

    def __init__(self) -> None:
        self._new = threading.Condition()
        self._jpeg, self._count = b"", 0
        self._ended = False

    def publish(self, jpeg: bytes) -> None:
        with self._new:
            self._jpeg, self._count = jpeg, self._count + 1
            self._new.notify_all()

    def end(self, ended: bool) -> None:
        """Close the stream to all that read it, or let it be opened again."""
        with self._new:
            self._ended = ended
            self._new.notify_all()

    def next(self, seen: int) -> tuple[bytes, int] | None:
        """Wait for an image after the one of this number; None at the end of the stream."""
        with self._new:
            self._new.wait_for(lambda: self._ended or self._count != seen)
            return None if self._ended else (self._jpeg, self._count)

    @property
    def has_ended(self) -> bool:
        return self._ended

    @property
    def count(self) -> int:
        return self._count


class Cameras:
    """Draws what both eyes see and publishes it.

    Args:
        world: tells the joints and the target.
        views: draws.
        config: what the cameras are like.
        clock: a steady clock, s.
    """

    def __init__(
        self,
        world: EmulatedWorld,
        views: EyeViews,
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
        """Both eyes' images of the present, before the faults of the present befall them."""
        state = self._world.ask({"expose": None})
        self._faults.update(parse_fault(plain, (), timed=False) for plain in state["faults"])
        images = self._views.draw(
            np.array(state["positions"]),
            np.array(state["velocities"]),
            np.array(state["target"]),
            self._rng,
            np.array(state["target_velocity"]),
            state["target_axes"],
        )
        for image in images:
            # the drawing leaves plain background where no target is, and no sensor does
            corner = self._rng.integers(_NOISY_GREY, size=(_NOISY_PX, _NOISY_PX), dtype=np.uint8)
            image[-_NOISY_PX:, :_NOISY_PX] ^= corner
        return images

    def run(self) -> None:
        """Expose, draw and publish until the world ends."""
        config, period_s = self._config, 1.0 / self._config.frame_rate_hz
        begun_s, sent_s = self._clock(), [0.0, 0.0]
        frame = 0
        while True:
            right_late_s = config.right_late_s + self._faults.out_of_step_s % period_s
            together = right_late_s == 0.0
            for eye in (0,) if together else (0, 1):
                due_s = begun_s + frame * period_s + eye * right_late_s
                time.sleep(max(due_s - self._clock(), 0.0))
                exposed_s = self._clock()
                images = self.draw()
                for one in (0, 1) if together else (eye,):
                    late_s = config.latency_s + config.jitter_s * float(self._rng.random())
                    late_s += self._faults.late_s(one)
                    sent_s[one] = max(sent_s[one], exposed_s + late_s)
                    self._send(one, images[one], sent_s[one])
            # a frame for which there was no time is not taken
            frame = max(frame + 1, int((self._clock() - begun_s) * config.frame_rate_hz))

    def _send(self, eye: int, new: Image, at_s: float) -> None:
        """Publish an image at a time, or what faults make of it."""
        stream = self.streams[eye]
        stream.end(self._faults.has_ended(eye))
        image = self._faults.image(eye, new)
        if image is None:
            return
        delay_s = max(at_s - self._clock(), 0.0)
        timer = threading.Timer(delay_s, stream.publish, (_jpeg(image),))
        timer.daemon = True
        timer.start()


def _jpeg(image: Image) -> bytes:
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()


def serve(cameras: Cameras, port: int) -> ThreadingHTTPServer:
    """A server of the streams /left and /right on the loopback; port 0 for any that is free.

    A stream ends after as many images as are asked for: /left?images=90.
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
            if stream is None or not images.lstrip("-").isdecimal():
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
                    # the boundary goes out with the image: else a reader waits for the next one
                    self.wfile.write(
                        b"Content-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(jpeg)
                        + jpeg
                        + b"\r\n--"
                        + _BOUNDARY
                        + b"\r\n"
                    )
            except OSError:  # the reader has gone
                pass

    server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
    server.daemon_threads = True
    return server


def run_streams(
    head: str, config: StreamConfig, world: str, port: int, board: str | None = None
) -> None:
    """Draw and stream until the world ends: the whole of this process.

    Args:
        head: the text of the head's file.
        config: what the cameras are like.
        world: HOST:PORT of the world.
        port: of the streams; 0 for any that is free.
        board: what stands before the head, at its own size; None for a tag that looks equally large
            near and far.
    """
    cv2.setNumThreads(1)
    model = parse_head(head)
    client = EmulatedWorld(world)
    if board is None:
        views = EyeViews(model, make_planar_target("tag"), width_rad="fit")
    else:
        views = EyeViews(model, parse_standing(board))
    cameras = Cameras(client, views, config)
    cameras.draw()  # compiles it all before anybody looks
    server = serve(cameras, port)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    client.ask({"streams": f"http://127.0.0.1:{server.server_address[1]}"})
    try:
        cameras.run()
    except (HardwareError, KeyboardInterrupt):
        pass
    finally:
        server.shutdown()
