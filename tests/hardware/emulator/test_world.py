"""The world of an emulated head: requests over TCP, what is true there, and its configuration."""

import socket
from contextlib import closing

import numpy as np
import pytest

from tests.commands.test_failures import call
from tests.hardware.emulator.served import POINT
from tests.naming import named
from vergence import load_head
from vergence.envs.targets.motion import motion_rows
from vergence.errors import ConfigurationError, HardwareError
from vergence.hardware.config import load_hardware
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.emulator.client import WorldClient
from vergence.hardware.emulator.server import (
    EmulatorServer,
    hardware_config_values,
    parse_sized_board,
    tilted_board_pose,
)
from vergence.hardware.emulator.world import MotorOptions, World
from vergence.models.head_file import head_to_toml
from vergence.models.toml_table import toml_text


def test_a_target_is_where_it_was_put_until_it_is_placed(served):
    truth = served.client.truth(served.world.head, 0.5)
    assert truth.time_s[0] == 0.5
    assert truth.target[0] == pytest.approx(POINT)
    head = served.world.head
    assert truth.pixels[0] == pytest.approx(head.project(head.rest(), POINT))


def test_a_moving_target_waits_for_the_beginning(served):
    velocity = np.array([0.2, 0.0, 0.0])
    served.client.place_target(motion_rows(POINT, before=POINT, velocity=velocity)[0])
    served.clock.sleep(5.0)
    assert served.client.ask({"state": None})["target"] == pytest.approx(POINT)
    served.client.start_target_motion(served.clock.now)
    served.clock.sleep(0.5)
    state = served.client.ask({"state": None})
    assert state["target"] == pytest.approx(POINT + 0.5 * velocity)
    assert state["target_velocity"] == pytest.approx(velocity, abs=1e-6)


def test_a_board_that_stands_stays_in_the_world_while_the_neck_turns():
    head = load_head("icub")
    board = parse_sized_board("checkerboard:9x6:24")
    world = World(head, POINT, T_0_T=tilted_board_pose(head, board, 0.7))
    seen = []
    for angle in (0.0, 0.3):
        next(iter(world.servos.values())).q = angle
        state = world.state(0.0)
        T_N_T = np.eye(4)
        T_N_T[:3, :3], T_N_T[:3, 3] = state["target_axes"], state["target"]
        seen.append(T_N_T)
    q = np.array(world.state(0.0)["positions"])
    assert np.abs(q[:3]).max() == pytest.approx(0.3)
    assert head.base_pose(q) @ seen[1] == pytest.approx(world.T_0_T)
    assert np.abs(seen[1] - seen[0]).max() > 0.1
    middle = seen[0] @ [*board.corners_m.mean(axis=0), 0.0, 1.0]
    assert middle[2] == pytest.approx(0.7, abs=0.01)
    with pytest.raises(ConfigurationError, match="expected one board of a known size"):
        parse_sized_board("checkerboard:9x6")
    with pytest.raises(ConfigurationError, match="the board stands still"):
        world.place_target(motion_rows(POINT, before=POINT)[0].tolist())


def test_a_hidden_target_is_nowhere(served):
    served.client.place_target(motion_rows(POINT, before=POINT, hidden_from=1.0)[0])
    served.client.start_target_motion(served.clock.now)
    served.clock.sleep(1.5)
    truth = served.client.truth(served.world.head, 1.5)
    assert np.isnan(truth.target).all()
    assert not truth.image_visible.any()


GARBAGE = [
    b"", b"{", b"5", b"[]", b"null", b"\xff\xfe", b'"word"', b"{}", b'{"stat": null}',
    b'{"show": null}', b'{"show": [1, 2]}', b'{"show": {}}', b'{"show": [[1]]}',
    b'{"begin": null}', b'{"begin": []}', b"[" * 20000,
    b'{"begin": 1' + b"0" * 400 + b"}", b'{"show": [1' + b"0" * 400 + b"]}",
]  # fmt: skip


def test_a_request_that_is_none_is_answered_with_an_error(served):
    host, port = served.server.address.split(":")
    for request_line in GARBAGE:
        address = host, int(port)
        with named(request_line), socket.create_connection(address, timeout=5.0) as connection:
            connection.sendall(request_line + b"\n")
            assert b"error" in connection.makefile("rb").readline()
    with pytest.raises(HardwareError, match=r"emulator: expected a request, got .*25 numbers or"):
        served.client.place_target(np.zeros(3))
    assert served.client.ask({"state": None})["target"] == pytest.approx(POINT)


def test_a_client_that_has_gone_takes_nobody_with_it(served):
    host, port = served.server.address.split(":")
    socket.create_connection((host, int(port))).close()
    assert served.client.ask({"state": None})["trips"] == 0


def test_nobody_at_an_address_is_said_in_one_line():
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"127.0.0.1:{free.getsockname()[1]}"
    for nowhere in (address, f"{'x' * 70}:80"):
        with pytest.raises(HardwareError, match=r"expected an emulated head at .* still run"):
            WorldClient(nowhere)


def test_a_tied_heads_joints_are_its_actuators():
    head = load_head("icub")
    world = World(head, POINT)
    actuators = np.zeros(7)
    for i, (name, servo) in enumerate(world.servos.items()):
        servo.q = 0.05 * (i + 1)
        actuators[world._slots[name]] = servo.q
    state = world.state(0.0)
    q = head.actuation.joints_of(actuators)
    assert state["positions"] == pytest.approx(q)
    assert state["motors"] == pytest.approx(actuators)
    assert state["pixels"] == [pytest.approx(eye) for eye in head.project(q, state["target"])]


def test_a_servo_model_moves_and_answers_as_itself():
    servo = World(load_head("turrets"), POINT, MotorOptions(servo="XL330")).servos["left_pan"]
    assert table.MODELS[servo.get(table.MODEL_NUMBER)] == "XL330-M288"
    assert servo.get(table.VELOCITY_LIMIT) * 0.229 == pytest.approx(103.0, abs=0.229)  # rev/min
    assert servo.acceleration == 144.0
    assert servo.get(table.PRESENT_INPUT_VOLTAGE) == 50


def test_the_command_keeps_the_head_file(tmp_path, capsys):
    path = tmp_path / "desk.toml"
    path.write_text(head_to_toml(load_head("turrets")), encoding="utf-8")
    assert call("emulate", "--head", path, "--out", path) == 2
    assert "expected another file than the head" in capsys.readouterr().err
    assert load_head(path).name == "turrets"


def test_a_controller_reads_the_configuration(tmp_path):
    name = "icub"
    world = World(load_head(name), POINT)
    with closing(EmulatorServer(world)) as server:
        server.streams = "http://127.0.0.1:1"
        path = tmp_path / "desk.toml"
        values = hardware_config_values(name, world.head.digest, world, server, "tag:36h11:0:150")
        path.write_text(toml_text(values), encoding="utf-8")
        config = load_hardware(path)
        assert config.head.digest == world.head.digest
        assert [one.id for one in config.servos] == [one.id for one in world.servos.values()]
        assert (config.bus.port, config.emulator_address) == (server.port, server.address)
        sources = [f"{server.streams}/{eye}" for eye in ("left", "right")]
        assert [one.source for one in config.cameras] == sources


def test_the_command_refuses_wrong_numbers_in_a_line(capsys):
    for words, said in (
        (("--jitter", "-0.1"), "jitter: expected seconds, 0 to 10, got -0.1"),
        (("--port", "70000"), "port: expected 0 to 65535, got 70000"),
        (("--point", "0", "nan", "1"), "point: expected three finite numbers"),
        (("--head", "turret"), "did you mean turrets?"),
        (("--servo", "STS3215"), "servo: expected one of Dynamixel's X series"),
    ):
        with named(words):
            assert call("emulate", *words) == 2
            (line,) = capsys.readouterr().err.splitlines()
            assert said in line
