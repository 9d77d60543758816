"""One joint moved by small steps: its motion, its faults, and the command with its words."""

import dataclasses
import io

import pytest

from tests.commands.test_failures import call
from tests.hardware.fakes import FakeClock
from tests.hardware.line import TimelessLine, desk_config, open_timeless, ready_servos
from tests.hardware.test_config import document
from tests.naming import refused
from vergence.errors import HardwareError, UnreadableFileError
from vergence.hardware.config import load_hardware, write_servos
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.emulator.servo import ENCODER_ERROR
from vergence.hardware.jog import Jogger
from vergence.models.toml_table import toml_text


class Desk:
    """Servos, a clock that passes as they move, and a jog of them."""

    def __init__(self, servos=None, **servo_values):
        self.clock, self.servos = FakeClock(), servos or ready_servos()
        self.goals, self.meanwhile = [], lambda: None
        config = desk_config(TimelessLine.port, **servo_values)
        opened = open_timeless(config, self.servos, self.clock)
        self.jog = Jogger(config, opened, clock=self.clock, sleep=self.sleep)

    def sleep(self, seconds):
        self.goals.append(self.registers(table.GOAL_VELOCITY))
        self.meanwhile()
        self.clock.sleep(seconds)

    def registers(self, register):
        return [servo.get(register) for servo in self.servos]


@pytest.fixture
def desk():
    return Desk()


@pytest.fixture
def pan(desk):
    """The servo of the left pan, which is the first one."""
    return desk.servos[0]


@pytest.mark.parametrize("way_rad", [0.05, -0.3])
def test_a_step_turns_one_joint_by_its_way_and_leaves_it_at_rest(desk, way_rad):
    moved = desk.jog.step("left_tilt", way_rad)
    tolerance_rad = max(0.1 * abs(way_rad), 2 * table.TICK_RAD)
    assert moved == pytest.approx(way_rad, abs=1.01 * tolerance_rad)
    desk.clock.sleep(1.0)
    # it coasts on by its last speed's lag, towards the goal
    assert desk.jog.angle("left_tilt") == pytest.approx(way_rad, abs=1.01 * tolerance_rad)
    assert [abs(servo.q) > 1e-3 for servo in desk.servos] == [False, True, False, False]
    assert desk.registers(table.TORQUE_ENABLE) == [0, 1, 0, 0]
    assert desk.registers(table.BUS_WATCHDOG) == [0, 0, 0, 0]
    assert desk.registers(table.GOAL_VELOCITY) == [0, 0, 0, 0]


def test_a_step_goes_at_a_tenth_of_the_joints_speed_with_the_watchdog_armed(desk, pan):
    armed = []
    desk.meanwhile = lambda: armed.append(pan.get(table.BUS_WATCHDOG))
    desk.jog.step("left_pan", 0.4)
    assert set(armed) == {10}
    fastest = max(abs(goals[0]) for goals in desk.goals)
    assert fastest * table.TICK_RAD_S == pytest.approx(0.597, rel=0.03)


def test_a_sign_and_a_gear_turn_the_servo_and_not_the_step():
    desk = Desk(sign=-1, gear_ratio=0.5)
    desk.jog.step("left_pan", 0.2)
    desk.clock.sleep(1.0)
    # the emulated servo has no gear and turns with its joint
    assert desk.servos[0].q == pytest.approx(-0.1, rel=0.15)


def test_a_stuck_joint_is_stopped(desk, pan):
    pan.lower = pan.upper = 0.0
    before_s = desk.clock.now
    refused(
        r"left_pan: .*0\.050 rad, got 0\.000 rad: it is st",
        desk.jog.step,
        "left_pan",
        0.05,
        error=HardwareError,
    )
    assert desk.clock.now - before_s < 0.6
    assert pan.get(table.GOAL_VELOCITY) == 0


@pytest.mark.parametrize("fault", ["blind", "inverted", "told"])
def test_a_joint_that_a_goal_of_zero_does_not_stop_loses_its_torque(fault):
    desk = Desk(ready_servos(lag_s=0.03, acceleration=80.0))
    pan = desk.servos[0]
    pan.frozen = pan.blind = fault != "inverted"
    pan.inverted = fault == "inverted"
    if fault == "told":
        pan.set(table.SHUTDOWN, 52)
        pan.set_hardware_errors(ENCODER_ERROR)
    refused(
        r"its torque is off|without a fault", desk.jog.step, "left_pan", 0.3, error=HardwareError
    )
    assert pan.get(table.TORQUE_ENABLE) == 0
    desk.clock.sleep(1.0)
    pan.advance_to(desk.clock.now)
    assert abs(pan.q) < 0.5
    assert pan.v == pytest.approx(0.0, abs=table.TICK_RAD_S)


@pytest.mark.parametrize(("by_rad", "said"), [(-0.03, "wrong way"), (0.3, "too far")])
def test_a_joint_that_is_pushed_is_stopped(desk, pan, by_rad, said):
    desk.meanwhile = lambda: setattr(pan, "q", pan.q + by_rad)
    refused(said, desk.jog.step, "left_pan", 0.1, error=HardwareError)
    assert pan.get(table.GOAL_VELOCITY) == 0


def test_a_servo_that_falls_silent_is_named(desk, pan):
    desk.meanwhile = lambda: setattr(pan, "silent", True)
    refused(
        "left_pan: expected an answer of the id 1, got none",
        desk.jog.step,
        "left_pan",
        0.1,
        error=HardwareError,
    )


def test_an_interrupted_step_leaves_the_joint_at_rest_with_torque(desk, pan):
    def interrupt():
        if len(desk.goals) == 3:
            raise KeyboardInterrupt

    desk.meanwhile = interrupt
    with pytest.raises(KeyboardInterrupt):
        desk.jog.step("left_pan", 0.4)
    assert desk.goals[2][0] > 0
    assert pan.get(table.GOAL_VELOCITY) == 0
    assert pan.get(table.TORQUE_ENABLE) == 1


def test_torque_in_another_mode_is_not_dropped(desk, pan):
    pan.set(table.TORQUE_ENABLE, 1)
    refused("hold the head", desk.jog.step, "left_pan", 0.05, error=HardwareError)
    assert pan.get(table.TORQUE_ENABLE) == 1


def test_a_zero_is_the_present_posture_within_a_turn(desk, pan):
    pan.q, pan.upper = 3.5, 4.0
    desk.jog.set_zero("left_pan")
    assert 0 <= desk.jog.servos["left_pan"].zero < table.TICKS_PER_TURN
    assert desk.jog.angle("left_pan") == pytest.approx(0.0, abs=1e-9)


# ---- the file ----

SERVO = """
[[servos]] # mine
name = "{name}"
id = {id}
zero_ticks = 2_048  # measured
sign    = 1 # seen
"""
VALUES = document()
SERVOS = VALUES.pop("servos")
CONFIG = f"# mine\n{toml_text(VALUES)}{''.join(SERVO.format(**one) for one in SERVOS)}"


@pytest.fixture
def path(tmp_path):
    place = tmp_path / "desk.toml"
    place.write_text(CONFIG)
    return place


def test_signs_and_zeros_are_written_and_all_else_stays(path):
    for text in (CONFIG, "\ufeff" + CONFIG, CONFIG.replace("\n", "\r\n")):
        path.write_bytes(text.encode())
        left = load_hardware(path).servos[0]
        write_servos(path, [dataclasses.replace(left, sign=-1, zero=100)])
        expected = text.replace("2_048  # m", "100  # m", 1).replace("= 1 # s", "= -1 # s", 1)
        assert path.read_bytes().decode() == expected


def test_servos_in_one_line_are_written_too(path):
    path.write_text(toml_text(document()))
    write_servos(path, [dataclasses.replace(load_hardware(path).servos[1], zero=7)])
    assert [one.zero for one in load_hardware(path).servos] == [2048, 7, 2048, 2048]


def test_a_file_that_has_lost_the_servo_is_left_alone(path):
    servo = load_hardware(path).servos[0]
    path.write_text("head = 1\n")
    refused(
        r"desk\.toml: changed meanwhile", write_servos, path, [servo], error=UnreadableFileError
    )
    assert path.read_text() == "head = 1\n"


# ---- the command ----


@pytest.fixture
def run(serve, path, monkeypatch, capsys):
    """Run the command with some lines on servos; its exit code, output and errors."""

    def of(own, *lines):
        path.write_text(CONFIG.replace("/dev/ttyUSB0", serve(own).port))
        monkeypatch.setattr("sys.stdin", io.StringIO("".join(f"{line}\n" for line in lines)))
        return call("jog", "--config", path), *capsys.readouterr()

    return of


def test_words_find_signs_and_zeros_and_write_them(run, own, path):
    own[2].q = 0.3
    code, out, _ = run(own, "right_pan", "flip", "zero", "write", "quit", "flip")
    assert code == 0
    assert f"written to {path}" in out
    servo = load_hardware(path).servos[2]
    assert (servo.sign, servo.zero) == (-1, 2048 + round(0.3 / table.TICK_RAD))


def test_joints_are_listed_and_what_is_not_written_is_told_in_the_end(run, own, path):
    code, out, _ = run(own, "flip")
    assert code == 0
    for servo in load_hardware(path).servos:
        assert f"{servo.name}: 0.000 rad of -" in out
        assert servo.sign == 1
    assert "left without write" in out
    assert [servo.get(table.TORQUE_ENABLE) for servo in own] == [0] * 4


def test_words_that_cannot_be_are_told_and_fail_a_script(run, own):
    words = ["left_pam", "step", "step 3", "step nan", "+ 5", "zero left_pan"]
    code, out, _ = run(own, *words, "help")
    assert (code, out.count("error: ")) == (1, len(words))
    assert "turn it by a step" in out


@pytest.mark.slow
def test_plus_and_minus_turn_the_joint_by_the_step(run, own):
    _, out, _ = run(own, "step 0.06", "+", "+", "-", "off")
    assert own[0].q == pytest.approx(0.06, rel=0.3)
    assert "left_pan: torque is off" in out
    assert own[0].get(table.TORQUE_ENABLE) == 0


def test_what_is_wrong_is_told_before_anything_moves_but_not_postures(run, own):
    own[0].q = 3.2
    own[1].set(table.DRIVE_MODE, 1)
    own[2].set(table.HOMING_OFFSET, 8)
    code, out, said = run(own, "+")
    assert (code, out) == (1, "")
    assert [line.split(":")[3].strip() for line in said.splitlines()] == ["left_tilt", "right_pan"]
    assert [servo.get(table.TORQUE_ENABLE) for servo in own] == [0] * 4
