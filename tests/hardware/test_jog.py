"""One joint moved by small steps: its motion, its faults, and the command with its words."""

import dataclasses
import io

import pytest

from tests.commands.test_failures import call
from tests.hardware.fakes import FakeClock
from tests.hardware.line import TimelessLine, desk_config, open_timeless, ready_servos
from tests.hardware.test_config import document
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


def test_steps_go_on_past_the_end_of_a_turn(desk, pan):
    pan.zero_ticks = table.TICKS_PER_TURN - 10
    assert desk.jog.step("left_pan", 0.1) == pytest.approx(0.1, rel=0.15)


def test_a_stuck_joint_is_stopped(desk, pan):
    pan.lower = pan.upper = 0.0
    before_s = desk.clock.now
    with pytest.raises(HardwareError, match=r"left_pan: .*0\.050 rad, got 0\.000 rad: it is st"):
        desk.jog.step("left_pan", 0.05)
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
    with pytest.raises(HardwareError, match=r"its torque is off|without a fault"):
        desk.jog.step("left_pan", 0.3)
    assert pan.get(table.TORQUE_ENABLE) == 0
    desk.clock.sleep(1.0)
    pan.advance_to(desk.clock.now)
    assert abs(pan.q) < 0.5
    assert pan.v == pytest.approx(0.0, abs=table.TICK_RAD_S)


@pytest.mark.parametrize(("by_rad", "said"), [(-0.03, "wrong way"), (0.3, "too far")])
def test_a_joint_that_is_pushed_is_stopped(desk, pan, by_rad, said):
    desk.meanwhile = lambda: setattr(pan, "q", pan.q + by_rad)
    with pytest.raises(HardwareError, match=said):
        desk.jog.step("left_pan", 0.1)
    assert pan.get(table.GOAL_VELOCITY) == 0


def test_a_servo_that_falls_silent_is_named(desk, pan):
    desk.meanwhile = lambda: setattr(pan, "silent", True)
    with pytest.raises(HardwareError, match="left_pan: expected an answer of the id 1, got none"):
        desk.jog.step("left_pan", 0.1)


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
    with pytest.raises(HardwareError, match="hold the head"):
        desk.jog.step("left_pan", 0.05)
    assert pan.get(table.TORQUE_ENABLE) == 1


def test_a_watchdog_that_has_tripped_before_hinders_nothing(desk, pan):
    desk.jog.step("left_pan", 0.05)
    pan.set(table.BUS_WATCHDOG, 5)
    desk.clock.sleep(10.0)
    assert desk.jog.step("left_pan", 0.05) > 0.0


def test_a_zero_is_the_present_posture_within_a_turn(desk, pan):
    pan.q, pan.upper = 3.5, 4.0
    desk.jog.set_zero("left_pan")
    assert 0 <= desk.jog.servos["left_pan"].zero < table.TICKS_PER_TURN
    assert desk.jog.angle("left_pan") == pytest.approx(0.0, abs=1e-9)


CONFIG = (
    """\
# my robot
head = "turrets"    # two turrets
[bus]
port = "PORT"

[[servos]]          # the left one
name = "left_pan"
id = 1
zero_ticks = 2_048  # measured
sign = 1            # checked
"""
    + "".join(
        f"""
[[servos]]
name = "{name}"
id = {id}
zero_ticks = 0x800
sign = 1
"""
        for id, name in enumerate(("left_tilt", "right_pan", "right_tilt"), 2)
    )
    + """
[cameras]
left.source = 0
right.source = 2
"""
)


def test_signs_and_zeros_are_written_and_all_else_stays(tmp_path):
    path = tmp_path / "desk.toml"
    for text in (CONFIG, "\ufeff" + CONFIG, CONFIG.replace("\n", "\r\n")):
        path.write_bytes(text.encode())
        left = load_hardware(path).servos[0]
        write_servos(path, [dataclasses.replace(left, sign=-1, zero=100)])
        expected = text.replace("2_048  # m", "100  # m")
        expected = expected.replace("1            # c", "-1            # c")
        assert path.read_bytes().decode() == expected


def test_servos_in_one_line_are_written_too(tmp_path):
    values, path = document(), tmp_path / "desk.toml"
    row = '{{name = "{name}", id = {id}, zero_ticks = 5, sign = 1}}'
    rows = ", ".join(row.format(**one) for one in values.pop("servos"))
    path.write_text(f"servos = [{rows}]\n{toml_text(values)}")
    write_servos(path, [dataclasses.replace(load_hardware(path).servos[1], zero=7)])
    assert [one.zero for one in load_hardware(path).servos] == [5, 7, 5, 5]


def test_a_file_that_has_lost_the_servo_is_left_alone(tmp_path):
    path = tmp_path / "desk.toml"
    path.write_text(CONFIG)
    servo = load_hardware(path).servos[0]
    path.write_text("head = 1\n")
    with pytest.raises(UnreadableFileError, match=r"desk\.toml: changed meanwhile"):
        write_servos(path, [servo])
    assert path.read_text() == "head = 1\n"


@pytest.fixture
def jog(serve, tmp_path, monkeypatch, capsys):
    """Run the command with some lines; its exit code, output, errors, file and servos."""

    def run(lines, own=None):
        served = serve(own or ready_servos())
        path = tmp_path / "desk.toml"
        path.write_text(CONFIG.replace("PORT", served.port))
        monkeypatch.setattr("sys.stdin", io.StringIO("".join(f"{line}\n" for line in lines)))
        code, said = call("jog", "--config", path), capsys.readouterr()
        return code, said.out, said.err, path, served.line.servos

    return run


def test_words_find_signs_and_zeros_and_write_them(jog):
    own = ready_servos()
    own[2].q = 0.3
    words = ["right_pan", "flip", "zero", "write", "quit", "flip"]
    code, out, _err, path, _servos = jog(words, own)
    assert code == 0
    assert f"written to {path}" in out
    servo = load_hardware(path).servos[2]
    assert (servo.sign, servo.zero) == (-1, 2048 + round(0.3 / table.TICK_RAD))


def test_joints_are_listed_and_what_is_not_written_is_told_in_the_end(jog):
    code, out, _err, path, servos = jog(["flip"])
    assert code == 0
    for name in ("left_pan", "left_tilt", "right_pan", "right_tilt"):
        assert f"{name}: 0.000 rad of -" in out
    assert "left without write" in out
    assert all(servo.get(table.TORQUE_ENABLE) == 0 for servo in servos)
    assert load_hardware(path).servos[0].sign == 1


def test_words_that_cannot_be_are_told_and_fail_a_script(jog):
    words = ["left_pam", "step", "step 3", "step nan", "+ 5", "zero left_pan"]
    code, out, *_ = jog([*words, "help"])
    assert code == 1
    assert out.count("error: ") == len(words)
    assert "turn it by a step" in out


@pytest.mark.slow
def test_plus_and_minus_turn_the_joint_by_the_step(jog):
    _code, out, _err, _path, servos = jog(["step 0.06", "+", "+", "-", "off"])
    assert servos[0].q == pytest.approx(0.06, rel=0.3)
    assert "left_pan: torque is off" in out
    assert servos[0].get(table.TORQUE_ENABLE) == 0


def test_what_is_wrong_is_told_before_anything_moves_but_not_postures(jog):
    own = ready_servos()
    own[0].q = 3.2
    own[1].set(table.DRIVE_MODE, 1)
    own[2].set(table.HOMING_OFFSET, 8)
    code, out, err, _path, servos = jog(["+"], own)
    assert (code, out) == (1, "")
    assert [line.split(":")[3].strip() for line in err.splitlines()] == ["left_tilt", "right_pan"]
    assert all(servo.get(table.TORQUE_ENABLE) == 0 for servo in servos)
