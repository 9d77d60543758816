"""An emulated head on the wire: the world in this process, the cameras in another."""

import multiprocessing
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np

from vergence.errors import HardwareError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.emulator.config import EmulatorConfig
from vergence.hardware.emulator.fault import load_faults
from vergence.hardware.emulator.server import WorldServer
from vergence.hardware.emulator.streams import StreamConfig, run_streams
from vergence.hardware.emulator.world import Motors, World
from vergence.models.boards import make_planar_target
from vergence.models.files.head_file import from_anywhere, load_head
from vergence.models.files.head_toml import head_to_toml
from vergence.models.files.toml_text import toml_text


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
        VergenceError: there is no such head, or the script of faults is none.
        HardwareError: the cameras' process has ended.
    """
    head = load_head(config.head)
    point = np.asarray(config.target_mm) / 1000.0
    motors = Motors(**{field.name: getattr(config, field.name) for field in fields(Motors)})
    world = World(head, point, motors, config.seed)
    if config.faults is not None:
        world.faults.schedule(load_faults(config.faults, world.ids))
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
