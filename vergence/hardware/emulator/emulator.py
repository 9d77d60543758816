"""An emulated head: servos and world in this process, cameras in another."""

import multiprocessing
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np

from vergence.errors import HardwareError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.emulator.board import parse_sized_board, tilted_board_pose
from vergence.hardware.emulator.config import EmulatorConfig
from vergence.hardware.emulator.fault import load_faults
from vergence.hardware.emulator.server import EmulatorServer
from vergence.hardware.emulator.streams import StreamConfig, run_streams
from vergence.hardware.emulator.world import MotorOptions, World
from vergence.models.head_file import absolute_source, head_to_toml, load_head
from vergence.models.perturbation import ModelErrors
from vergence.models.toml_table import toml_text
from vergence.vision.objects.scenes import parse_scene
from vergence.vision.targets import make_planar_target


def emulate(
    config: EmulatorConfig,
    on_config_ready: Callable[[str], None],
    should_stop: Callable[[], bool] = lambda: False,
    model_errors: ModelErrors | None = None,
) -> None:
    """Emulate a head until `should_stop` returns True, or Ctrl-C.

    Args:
        config: its configuration.
        on_config_ready: called once when servos and streams answer, with the text of the hardware
            configuration that a controller needs, see `vergence.hardware.config`.
        should_stop: polled several times a second.
        model_errors: model errors of the head that really moves and sees, against that of `config`.

    Raises:
        VergenceError: there is no such head or board, or the script of faults is invalid.
        HardwareError: the cameras' process has ended.
    """
    head = load_head(config.head)
    # the same draw as `GazeTask`'s with this seed for its model's
    true = (
        head.perturbed(np.random.default_rng(config.seed), model_errors) if model_errors else head
    )
    board = None if config.board is None else parse_sized_board(config.board)
    scene = None
    if config.scene is not None or config.wall is not None:
        scene = parse_scene(config.scene or "ball", str(config.wall) if config.wall else None)
    T_0_T = None if board is None else tilted_board_pose(head, board, config.board_distance_m)
    point = np.asarray(config.target_mm) / 1000.0
    motors = MotorOptions(
        **{field.name: getattr(config, field.name) for field in fields(MotorOptions)}
    )
    world = World(true, point, motors, config.seed, T_0_T)
    if config.faults is not None:
        world.faults.schedule(load_faults(config.faults, world.ids))
    server = EmulatorServer(world)
    streams = StreamConfig(
        frame_rate_hz=head.timing.frame_rate_hz,
        latency_s=head.timing.latency_s if config.latency_s is None else config.latency_s,
        jitter_s=config.jitter_s,
        right_late_s=config.right_late_s,
        seed=config.seed,
    )
    process = multiprocessing.get_context("spawn").Process(
        target=run_streams,
        args=(head_to_toml(true), streams, server.address, config.port, config.board, scene),
        daemon=True,
    )
    process.start()
    try:
        server.serve(lambda: bool(server.streams) or not process.is_alive())
        if server.streams:
            target = str(board or make_planar_target("tag"))
            if scene is not None:
                target = scene.target
            values = hardware_config_values(
                absolute_source(config.head), head.digest, world, server, target
            )
            on_config_ready(toml_text(values))
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
    """The plain values of a configuration of this emulated head, see `vergence.hardware.config`.

    Args:
        head_source: the head's preset or file.
        head_digest: digest of that head.
        world: the world.
        server: the server of that world.
        target: the target before the cameras, see `parse_target`.
    """
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
