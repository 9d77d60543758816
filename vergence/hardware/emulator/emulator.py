"""An emulated head on the wire: the world in this process, the cameras in another."""

import math
import multiprocessing
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vergence.errors import ConfigurationError, HardwareError
from vergence.hardware.emulator.streams import StreamConfig, run_streams
from vergence.hardware.emulator.world import World, WorldServer, desk
from vergence.models.boards import make_planar_target
from vergence.models.files.head_file import from_anywhere, load_head
from vergence.models.files.head_toml import head_to_toml
from vergence.models.files.toml_text import toml_text


@dataclass(frozen=True, kw_only=True)
class EmulatorConfig:
    """What an emulated head is like."""

    head: str = "turrets"
    """Preset or path of a head file."""
    target_mm: tuple[float, float, float] = (0.0, -100.0, 1000.0)
    """Where the target is until it is placed, in N, mm."""
    latency_s: float | None = None
    """From the middle of an exposure to its image being sent, s; None for the head's."""
    jitter_s: float = 0.0
    """The most by which an image is sent later, s."""
    right_late_s: float = 0.0
    """By how much the right camera exposes later, s."""
    speed_filter_s: float = 0.0
    """Time constant of the filter through which servos report speeds, s."""
    port: int = 0
    """Of the streams; 0 for any that is free."""
    seed: int = 0
    """Of the noise of images and the jitter."""


def emulate(
    config: EmulatorConfig,
    ready: Callable[[str], None],
    stop: Callable[[], bool] = lambda: False,
) -> None:
    """Emulate a head until something is true, or Ctrl-C.

    Args:
        config: what it is like.
        ready: called once with the text of the configuration that a controller needs, see
            `vergence.hardware.config`, when servos and streams answer.
        stop: looked at now and then.

    Raises:
        VergenceError: there is no such head, or a value cannot be.
        HardwareError: the cameras' process has ended.
    """
    head = load_head(config.head)
    for name in ("jitter_s", "right_late_s", "speed_filter_s", "latency_s"):
        value = getattr(config, name)
        if value is not None and not (math.isfinite(value) and 0.0 <= value < 10.0):
            raise ConfigurationError(
                f"{name.removesuffix('_s').replace('_', '-')}: expected seconds, 0 to 10, got "
                f"{value}"
            )
    if not 0 <= config.port <= 65535:
        raise ConfigurationError(f"port: expected 0 to 65535, got {config.port}")
    point = np.asarray(config.target_mm) / 1000.0
    if not np.isfinite(point).all():
        raise ConfigurationError(f"target: expected three finite numbers, got {config.target_mm}")
    world = World(head, point, config.speed_filter_s)
    server = WorldServer(world)
    streams = StreamConfig(
        frame_rate_hz=head.timing.frame_rate_hz,
        latency_s=head.timing.latency_s if config.latency_s is None else config.latency_s,
        jitter_s=config.jitter_s,
        right_late_s=config.right_late_s,
        seed=config.seed,
    )
    process = multiprocessing.get_context("spawn").Process(
        target=run_streams,
        args=(head_to_toml(head), streams, server.address, config.port),
        daemon=True,
    )
    process.start()
    try:
        server.serve(lambda: bool(server.streams) or not process.is_alive())
        if server.streams:
            target = str(make_planar_target("tag"))
            ready(toml_text(desk(from_anywhere(config.head), world, server, target)))
            server.serve(lambda: stop() or not process.is_alive())
        if not stop() and not process.is_alive():
            raise HardwareError("emulate: the process of the cameras has ended")
    except KeyboardInterrupt:
        pass
    finally:
        server.close()
        process.terminate()
        process.join()
