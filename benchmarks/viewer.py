"""Measure the viewer: pictures a second while the target is dragged, and what bad browsers cost.

Run ``python -m benchmarks.viewer``; ``--minutes 10`` for the memory. A simulated head with
rendered images and a detector runs in real time; its target is moved 60 times a second, as by a
hand. Browsers are stood for by processes that receive what a browser receives and count the
images, but draw nothing. In the second half, one of them is killed, and one reads a message a
second.
"""

import argparse
import multiprocessing
import os
import signal
import threading
import time
from multiprocessing.sharedctypes import Synchronized
from typing import Any

import msgspec
import numpy as np
import psutil
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from vergence.models.head_file import load_head
from vergence.viewer.browser import address_of, serving
from vergence.viewer.playground import Playground
from vergence.viewer.simulated import Setup

DRAGS_HZ = 60.0
MINUTE_S = 60.0


def read(url: str, images: "Synchronized[int]", pause_s: float) -> None:
    """Receive what a browser receives, and count the left eye's images."""
    protocol: Any = f"viser-v{viser.__version__}"
    with connect(url, subprotocols=[protocol], max_size=None, compression=None) as socket:
        seen: dict[str, int] = {}
        while True:
            try:
                data = socket.recv()
            except ConnectionClosed:
                return
            assert isinstance(data, bytes)
            size = int.from_bytes(data[8:16], "little")
            inner = zstandard.ZstdDecompressor().decompress(data[16 : 16 + size])
            for message in msgspec.msgpack.decode(inner)["messages"]:
                if message.get("type") == "GuiUpdateMessage" and "_data" in message["updates"]:
                    seen[message["uuid"]] = seen.get(message["uuid"], 0) + 1
            images.value = min(seen.values()) if len(seen) == 2 else 0
            time.sleep(pause_s)


class Reader:
    """A process that reads as a browser does.

    Args:
        address: address of the page.
        pause_s: pause after each message, s.
    """

    def __init__(self, address: str, pause_s: float = 0.0) -> None:
        url = address.replace("http", "ws")
        context = multiprocessing.get_context("spawn")
        self.images = context.Value("q", 0)
        self.process = context.Process(target=read, args=(url, self.images, pause_s), daemon=True)
        self.process.start()

    def kill(self) -> None:
        """End the process at once; the server is told nothing."""
        assert self.process.pid is not None
        os.kill(self.process.pid, signal.SIGKILL)
        self.process.join()


def drag(playground: Playground, ended: threading.Event) -> None:
    """Move the target around a point as a hand does."""
    at = playground.simulated.target
    while not ended.wait(1.0 / DRAGS_HZ):
        turn = 2.0 * np.pi * 0.4 * time.monotonic()
        point = at + 0.15 * np.array([np.sin(turn), 0.5 * np.sin(2.0 * turn), np.cos(turn) - 1.0])
        playground.ask(lambda point=point: playground.simulated.move_target(point))


def measure(playground: Playground, reader: Reader, seconds: float, what: str) -> None:
    """Print rates over some seconds."""
    process = psutil.Process()
    before = (
        playground.view.shown, reader.images.value, playground.simulated.time_s,
        sum(process.cpu_times()[:2]), time.monotonic(),
    )  # fmt: skip
    time.sleep(seconds)
    after = (
        playground.view.shown, reader.images.value, playground.simulated.time_s,
        sum(process.cpu_times()[:2]), time.monotonic(),
    )  # fmt: skip
    shown, images, simulated, cpu, wall = np.subtract(after, before)
    print(
        f"{what:34s} {shown / wall:5.1f} {images / wall:9.1f} {simulated / wall:9.2f} "
        f"{cpu / wall:6.2f} {process.memory_info().rss / 2**20:7.0f}",
        flush=True,
    )


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--head", default="simulated")
    options = parser.parse_args()
    ended = threading.Event()
    print(f"{'':34s} shown  received  simulated   CPU     RSS")
    print(f"{'':34s}    Hz        Hz    by real  cores      MB")
    with serving("127.0.0.1", 0) as server:
        playground = Playground(server, Setup(head=load_head(options.head)), mode="by hand")
        threads = [
            threading.Thread(target=playground.run, args=(ended.is_set,)),
            threading.Thread(target=drag, args=(playground, ended)),
        ]
        for thread in threads:
            thread.start()
        first = Reader(address_of(server))
        time.sleep(5.0)
        measure(playground, first, 10.0, "dragged, one browser")
        slow, rude = Reader(address_of(server), pause_s=1.0), Reader(address_of(server))
        time.sleep(5.0)
        measure(playground, first, 10.0, "and a second, and a slow one")
        rude.kill()
        rounds = max(1, round(options.minutes * MINUTE_S / 30.0))
        for number in range(rounds):
            measure(playground, first, 30.0, f"one killed, {0.5 * (number + 1):.1f} min later")
        slow.kill()
        ended.set()
        for thread in threads:
            thread.join()
        first.kill()


if __name__ == "__main__":
    main()
