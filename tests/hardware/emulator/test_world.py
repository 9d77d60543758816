"""The world of an emulated head: requests over TCP, what is true there, and its configuration."""

import socket
from contextlib import closing

import numpy as np
import pytest

from tests.commands.test_failures import call
from tests.hardware.emulator.asking import POINT
from tests.naming import named
from vergence import load_head
from vergence.envs.targets.motion import motion_rows
from vergence.errors import ConfigurationError, HardwareError
from vergence.hardware.config import load_hardware
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.packets import (
    BROADCAST,
    Instruction,
    Packet,
    PacketParser,
    status_packet,
)
from vergence.hardware.emulator.client import WorldClient
from vergence.hardware.emulator.faults import parse_fault
from vergence.hardware.emulator.server import (
    EmulatorServer,
    hardware_config_values,
    parse_sized_board,
    tilted_board_pose,
)
from vergence.hardware.emulator.world import EmulatorConfig, TimedAnswer, World, apply_line_faults
from vergence.models.head_file import head_to_toml
from vergence.models.toml_table import toml_text

RATE = 1_000_000
TICKS = 20
LATENCY_S = 0.015


class Head:
    """A world whose servos are in velocity mode, in time that the test sets."""

    def __init__(self, torque=1, script=(), **config):
        self.world = World(load_head("turrets"), POINT, EmulatorConfig(**config))
        self.world.faults.schedule(self.fault(**one) for one in script)
        for servo in self.world.line.servos:
            servo.write(table.OPERATING_MODE.address, b"\1")
        self.world.advance_to(0.0)
        self.write(0.0, table.TORQUE_ENABLE, torque)

    def fault(self, **values):
        return parse_fault(values, self.world.ids, timed="at_s" in values)

    def begin(self, now_s, **values):
        self.world.begin_fault(self.fault(**values), now_s)

    def write(self, now_s, register, value):
        data = register.encode(value)
        params = register.address.to_bytes(2, "little") + len(data).to_bytes(2, "little")
        params += b"".join(bytes((id,)) + data for id in self.world.ids)
        self.world.answer(Packet(BROADCAST, Instruction.SYNC_WRITE, params), now_s, RATE)

    def turn(self, now_s, ticks=TICKS):
        self.write(now_s, table.GOAL_VELOCITY, ticks)

    def pings(self, now_s, rate=RATE):
        return self.world.answer(Packet(BROADCAST, Instruction.PING, b""), now_s, rate)

    def get(self, now_s, register, name="left_pan"):
        self.world.advance_to(now_s)
        return self.world.servos[name].get(register)

    @property
    def speeds(self):
        return self.world.line.velocities()


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


def test_a_client_puts_joints_at_angles_where_they_stay(served):
    served.client.turn({"left_pan": 0.2, "right_pan": -0.1})
    for _ in range(2):
        positions = served.client.ask({"state": None})["positions"]
        assert positions[3:] == pytest.approx([0.2, 0.0, -0.1, 0.0])
        served.clock.sleep(1.0)
    truth = served.client.truth(served.world.head, 0.0)
    assert truth.pixels[0] == pytest.approx(served.world.head.project(truth.positions[0], POINT))
    served.client.turn({"left_tilt": 1e3})
    assert served.world.servos["left_tilt"].joint == served.world.servos["left_tilt"].upper
    for angles in ({"left": 0.1}, {"left_pan": np.nan}):
        with pytest.raises(HardwareError, match=r"turn: expected finite angles of left_pan, "):
            served.client.turn(angles)


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
    servo = World(load_head("turrets"), POINT, EmulatorConfig(servo="XL330")).servos["left_pan"]
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


def test_return_delays_add_up_on_the_line():
    head = Head()
    for servo in head.world.line.servos:
        servo.set(table.RETURN_DELAY_TIME, 250)
    assert [delay_s for delay_s, _ in head.pings(0.0)] == [pytest.approx(4 * 500e-6)]


def test_a_fault_ends_at_its_own_instant():
    late, prompt = Head(), Head()
    for head in (late, prompt):
        head.begin(1.0, what="stuck", ids=[1], for_s=0.5)
        head.turn(1.0)
    late.world.advance_to(2.0)  # in one go, past the end
    prompt.world.advance_to(1.5)
    assert prompt.speeds[0] == 0.0
    assert prompt.speeds[1] > 0.1
    prompt.world.advance_to(2.0)
    assert late.world.line.positions() == pytest.approx(prompt.world.line.positions())
    assert late.speeds[0] > 0.1


def test_what_a_servo_measures_is_well_again_after_the_fault():
    head = Head()
    head.begin(0.0, what="voltage", ids=[1], value=10.5, for_s=1.0)
    head.begin(0.0, what="load", ids=[1], value=-45.0, for_s=1.0)
    head.begin(0.0, what="temperature", ids=[1], value=60, for_s=1.0)
    asked = (table.PRESENT_INPUT_VOLTAGE, table.PRESENT_LOAD, table.PRESENT_TEMPERATURE)
    assert [head.get(0.5, register) for register in asked] == [105, -450, 60]
    assert [head.get(1.5, register) for register in asked] == [120, 0, 31]


def test_a_servo_that_shuts_down_or_reboots_lets_go_at_that_instant():
    for fault in ({"what": "overload"}, {"what": "temperature", "value": 90}, {"what": "reboot"}):
        head = Head()
        head.turn(0.0)
        head.begin(0.5, ids=[1], **fault)
        with named(fault):
            assert [one.get(table.TORQUE_ENABLE) for one in head.world.line.servos] == [0, 1, 1, 1]
            head.world.advance_to(2.0)
            assert head.speeds[0] == pytest.approx(0.0, abs=1e-6)
            assert head.speeds[1] > 0.1


def test_a_silent_servo_does_not_answer_until_it_is_cleared():
    head = Head()
    (_, all_four), *_ = head.pings(0.0)
    head.begin(0.0, what="silent", ids=[3])
    (_, three), *_ = head.pings(0.1)
    assert len(three) == 0.75 * len(all_four)
    head.world.clear_faults(0.2)
    assert head.pings(0.2) == [(0.0, all_four)]


def test_a_script_counts_from_the_torque_on():
    head = Head(torque=0, script=[{"what": "stuck", "at_s": 1.0, "for_s": 0.5}])
    head.world.advance_to(5.0)
    head.write(5.0, table.TORQUE_ENABLE, 1)
    head.turn(5.0)
    stuck = []
    for now_s in (5.9, 6.1, 6.6):
        head.world.advance_to(now_s)
        stuck.append(head.world.servos["left_pan"].stuck)
    assert stuck == [False, True, False]


def test_a_client_is_told_when_its_fault_began(served):
    served.clock.now = 120.0
    assert served.client.begin_fault(what="stuck", ids=[1], for_s=0.4) == 120.0
    with pytest.raises(HardwareError, match=r"^emulator: fault\.what: expected one of bad-crc, "):
        served.client.begin_fault(what="broken")


def test_cameras_learn_of_their_faults_with_the_next_exposure_until_they_are_cleared(served):
    served.client.begin_fault(what="late", eye="right", value=0.5)
    served.client.begin_fault(what="stuck")
    exposure = served.client.ask({"expose": None})
    assert exposure["faults"] == [{"what": "late", "eye": "right", "value": 0.5}]
    served.client.clear_faults()
    assert served.client.ask({"expose": None})["faults"] == []


def test_a_client_is_told_from_when_on_the_joints_rest(served):
    start_s, servo = served.client.ask({"state": None})["time"], served.world.servos["left_pan"]
    servo.write(table.OPERATING_MODE.address, b"\1")
    servo.write(table.TORQUE_ENABLE.address, b"\1")
    servo.set(table.GOAL_VELOCITY, 50)
    served.clock.sleep(0.3)
    assert served.client.rest_start_s(start_s) is None
    began_s = served.client.begin_fault(what="overload", ids=[1])
    served.clock.sleep(1.0)
    assert began_s + 0.03 < served.client.rest_start_s(began_s) < began_s + 0.5


IMPERFECT = {
    "lag_s": 0.02, "speed_gain": 0.5, "command_latency_s": LATENCY_S, "backlash_rad": 0.01,
    "acceleration_rad_s2": 1000.0,
}  # fmt: skip


def test_a_command_acts_when_its_latency_has_passed():
    head = Head(**IMPERFECT)
    head.world.advance_to(LATENCY_S)  # the torque is on
    head.turn(0.1)
    assert head.world.state(0.1 + LATENCY_S)["velocities"][3] == 0.0
    after = head.world.state(0.1 + LATENCY_S + 0.02)["velocities"][3]
    assert after == pytest.approx(0.5 * TICKS * table.TICK_RAD_S * (1.0 - np.exp(-1.0)), rel=1e-3)


def test_what_servos_report_is_as_old_as_their_feedback():
    late_s = 0.0125
    now, late = Head(), Head(feedback_latency_s=late_s)
    for head in (now, late):
        head.turn(0.1)

    def reported(head, at_s):
        head.world.advance_to(at_s)
        head.world.line.servos[0].read(table.PRESENT_POSITION.address, 4)
        return [head.get(at_s, one) for one in (table.PRESENT_POSITION, table.PRESENT_VELOCITY)]

    for at_s in (0.1, 0.13, 0.2, 1.0):  # at rest, gathering speed, steady
        assert reported(late, at_s + late_s) == pytest.approx(reported(now, at_s), abs=1)
    true = [head.world.state(1.1)["positions"] for head in (now, late)]
    assert true[1] == pytest.approx(true[0])


def test_play_lets_the_camera_stay_behind_and_the_encoder_sees_none():
    head = Head(**IMPERFECT)
    for now_s, side in ((0.1, 1), (1.0, -1)):
        head.turn(now_s, side * TICKS)
        state = head.world.state(now_s + 0.9)
        assert state["motors"][3] - state["positions"][3] == pytest.approx(side * 0.005)


ANSWERS = [TimedAnswer(id, 0.0, status_packet(id, b"abcd")) for id in (1, 2, 3)]


def sent(*faults, seed=0):
    made = [parse_fault(fault, (1, 2, 3), timed=False) for fault in faults]
    return apply_line_faults(ANSWERS, made, np.random.default_rng(seed))


def heard(data):
    return [packet.id for packet in PacketParser().feed(data)]


def test_without_faults_all_goes_out_in_one_piece():
    assert sent() == [(0.0, b"".join(answer.data for answer in ANSWERS))]


def test_a_fault_meets_the_answer_of_its_servo_alone():
    without, twice = [1, 3], [1, 2, 2, 3]
    for what, ids in (
        ("bad-crc", without), ("short", without), ("lost", without), ("doubled", twice),
    ):  # fmt: skip
        ((late_s, data),) = sent({"what": what, "ids": [2]})
        assert late_s == 0.0
        assert heard(data) == ids, what


def test_a_late_answer_holds_up_no_other():
    on_time, late = sent({"what": "late", "ids": [1], "value": 0.02})
    assert (on_time[0], heard(on_time[1])) == (0.0, [2, 3])
    assert (late[0], heard(late[1])) == (0.02, [1])
    assert [late_s for late_s, _ in sent({"what": "late"})] == [0.012]


def test_each_answer_is_met_with_the_faults_probability():
    fault = {"what": "lost", "probability": 0.25}
    answers = sum(len(heard(b"".join(data for _, data in sent(fault, seed=i)))) for i in range(400))
    # 1200 draws: 900 expected, with a standard deviation of 15
    assert 840 < answers < 960


def test_all_may_be_lost():
    assert sent({"what": "lost"}) == []
