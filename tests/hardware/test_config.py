"""A real head described in TOML: what a complete file says, and how anything else is refused."""

import dataclasses
import functools
import pickle
import re
from pathlib import Path

import numpy as np
import pytest

from tests.commands.test_failures import call
from tests.naming import refused
from vergence import load_head
from vergence.errors import (
    HeadFileError,
    MistakesError,
    UnreadableFileError,
    VergenceError,
)
from vergence.hardware import config as config_module
from vergence.hardware.config import (
    LoopConfig,
    actuator_slots,
    load_hardware,
    loop_variation,
    write_loop,
)
from vergence.models.head_file import save_head
from vergence.models.toml_table import toml_text
from vergence.vision.targets import AprilTag


@pytest.fixture(autouse=True)
def each_head_read_once(monkeypatch):
    monkeypatch.setattr(config_module, "load_head", functools.cache(load_head))


def document(head="turrets"):
    return {
        "head": head, "target": "tag:36h11:5:120",
        "bus": {"port": "/dev/ttyUSB0", "baud_rate": 1_000_000, "watchdog_s": 0.5},
        "servos": [
            {"name": name, "id": ident, "zero_ticks": 2048, "sign": 1}
            for ident, name in enumerate(actuator_slots(load_head(head)), 1)
        ],
        "cameras": {"left": {"source": 0}, "right": {"source": "http://127.0.0.1/right"}},
    }  # fmt: skip


def load(folder, values):
    path = Path(folder) / "robot.toml"
    path.write_text(toml_text(values), encoding="utf-8")
    return load_hardware(path)


def test_a_complete_file_says_it_all(tmp_path):
    values, head = document(), load_head("turrets")
    values["head_digest"] = head.digest[:12].upper()
    values["servos"].reverse()
    values["servos"][0] |= {"sign": -1, "gear_ratio": 1.5, "zero_ticks": 7}
    values["servos"][0] |= {"lower_rad": -0.5, "upper_rad": 0.75}
    values["cameras"] |= {"pairing_tolerance_s": 0.01}
    values["cameras"]["left"] |= {"pixel_format": "MJPG", "latency_s": 0.08, "exposure_s": 0.008}
    values["emulator"] = {"address": "127.0.0.1:4711"}
    tags = [f"tag:36h11:{ident}:90" for ident in (1, 2)]
    values["places"] = [{"target": tag, "point_mm": [10.0, -20.0, 900.0]} for tag in tags]
    config = load(tmp_path, values)
    assert [str(place.target) for place in config.measured_targets] == tags
    assert config.measured_targets[1].point.tolist() == [0.01, -0.02, 0.9]
    assert config.head.digest == head.digest
    assert config.target == AprilTag(family="36h11", id=5, edge_m=0.12, size_known=True)
    bus, last = config.bus, config.servos[-1]
    assert (bus.port, bus.baud_rate, bus.watchdog_s) == ("/dev/ttyUSB0", 1_000_000, 0.5)
    assert [servo.name for servo in config.servos] == list(actuator_slots(head))
    assert (last.id, last.sign, last.gear_ratio, last.zero) == (4, -1, 1.5, 7)
    assert (last.lower_rad, last.upper_rad) == (-0.5, 0.75)
    assert last.unit_rad == pytest.approx(2.0 * np.pi / 4096)
    left, right = config.cameras
    assert (left.source, left.pixel_format, left.latency_s) == ("0", "MJPG", 0.08)
    assert (right.source, right.pixel_format) == ("http://127.0.0.1/right", "")
    assert (left.exposure_s, right.exposure_s) == (0.008, None)
    assert config.pairing_tolerance_s == 0.01
    assert (config.emulator_address, config.places_targets) == ("127.0.0.1:4711", True)
    values["emulator"]["places_targets"] = False
    assert not load(tmp_path, values).places_targets


def test_what_a_file_leaves_out_is_the_heads(tmp_path):
    values = document()
    del values["bus"]["baud_rate"], values["bus"]["watchdog_s"], values["target"]
    config, head = load(tmp_path, values), load_head("turrets")
    assert {camera.latency_s for camera in config.cameras} == {head.timing.latency_s}
    assert [servo.lower_rad for servo in config.servos] == head.actuation.lower[3:].tolist()
    assert [servo.upper_rad for servo in config.servos] == head.actuation.upper[3:].tolist()
    # free-running cameras are up to half a frame apart, and jitter
    assert 0.5 < config.pairing_tolerance_s / head.timing.frame_s < 1.0
    assert not config.emulator_address
    assert not config.places_targets


def edited(place, value):
    """A document with another value at a dotted place; None takes the key away."""
    values = document()
    *path, last = place.split(".")
    table = values
    for step in path:
        table = table[int(step) if step.isdecimal() else step]
    if value is None:
        del table[last]
    else:
        table[last] = value
    return values


REFUSED = [
    ("bus.wachdog_s", 0.2, "bus.wachdog_s: expected no such key (is bus.watchdog_s meant?), got"),
    ("servos.1.gear", 2.0, "servos[1].gear: expected no such key"),
    ("cameras.left.format", "MJPG", "cameras.left.format: expected no such key"),
    ("cameras.middle", {"source": 3}, "cameras.middle: expected no such key"),
    ("head", "turret", "head: expected one of icub, physical, simulated, turrets, or the path of"),
    ("head_digest", "0" * 16, "head_digest: expected that of turrets, "),
    ("target", "tag:36h11:900", "900"), ("target", "circle:3", "target: expected"),
    ("bus.port", "", "bus.port: expected the device file of the serial line"),
    ("bus.baud_rate", 1e6, "bus.baud_rate: expected a baud rate, 9600 to 10500000, got 1000000.0"),
    ("bus.watchdog_s", 200, "0.02 to 2.54 (is it in milliseconds?), got 200"),
    ("bus.watchdog_s", 0.01, "bus.watchdog_s: expected seconds in steps of the servos' 20 ms"),
    ("servos.0.name", "left_pam", "servos[0].name: expected one of left_pan, left_tilt"),
    ("servos.1.name", "left_pan", "servos[1].name: expected each joint once, got 'left_pan'"),
    ("servos.1.id", 1, "servos[1].id: expected another id than that of left_pan, got 1"),
    ("servos.1.id", 253, "servos[1].id: expected a servo's id, 0 to 252, got 253"),
    ("servos.0.sign", 2, "servos[0].sign: expected 1 or -1, got 2"),
    ("servos.0.zero_ticks", 4096, "servos[0].zero_ticks: expected ticks of the servo's position"),
    ("servos.0.gear_ratio", 2.0, "servos[0].gear_ratio: expected a range of at most one turn"),
    ("servos.0.gear_ratio", -1.0, "servos[0].gear_ratio: expected turns of the servo per turn"),
    ("servos.1.upper_rad", 1.6, "servos[1].upper_rad: expected an angle within the head's limits"),
    ("servos.1.lower_rad", -90.0, "radians below 6.3 in size (is it in degrees?), got -90.0"),
    ("servos.1.upper_rad", -1.5707963267948966, "servos[1].upper_rad: expected "),
    ("cameras.left.latency_s", 66.7, "seconds, 0 to 2 (is it in milliseconds?), got 66.7"),
    ("cameras.left.exposure_s", 8.0, "seconds in steps of a camera's 100 us"),
    ("cameras.left.exposure_s", 0.04, "at most the time between two frames of turrets, 0.0333 s"),
    ("cameras.left.pixel_format", "MJPEG", "cameras.left.pixel_format: expected four letters"),
    ("cameras.right.source", "0", "cameras.right.source: expected another camera than the left"),
    ("cameras.right.source", True, "cameras.right.source: expected a camera's number"),
    ("cameras.right", None, "cameras.right: expected a table"),
    ("cameras.pairing_tolerance_s", 20, "seconds, 0 to 1 (is it in milliseconds?), got 20"),
    ("emulator", {"address": "localhost:65536"}, "emulator.address: expected HOST:PORT"),
    ("bus", 5, "bus: expected a table, got 5"),
    ("servos", {"name": "left_pan"}, "servos: expected tables [[servos]], got"),
]  # fmt: skip


@pytest.mark.slow
def test_a_value_that_cannot_be_is_named(tmp_path):
    for place, value, said in REFUSED:
        whole = f"^{re.escape(str(tmp_path / 'robot.toml'))}: .*{re.escape(said)}"
        refused(whole, load, tmp_path, edited(place, value), error=VergenceError)


def wrong_everywhere():
    """A document with a mistake in each of its tables, and what each is told by."""
    values = document()
    values["target"] = "circle:3"
    values["bus"]["baud_rate"] = 5
    values["servos"][0]["sign"] = 2
    values["servos"][1]["name"] = "left_tild"
    values["servos"][3]["id"] = 3
    values["cameras"]["left"]["pixel_format"] = "MJPEG"
    del values["cameras"]["right"]["source"]
    values["emulator"] = {"address": "here"}
    values["tarqet"] = "tag:36h11"
    return values, [
        "target: ", "bus.baud_rate: ", "servos[0].sign: ", "servos[1].name: ", "servos[3].id: ",
        "cameras.left.pixel_format: ", "cameras.right.source: ", "emulator.address: ", "tarqet: ",
    ]  # fmt: skip


def test_the_mistakes_of_all_tables_are_told_at_once(tmp_path):
    values, told = wrong_everywhere()
    with pytest.raises(MistakesError) as caught:
        load(tmp_path, values)
    lines = str(caught.value).splitlines()
    assert len(lines) == len(told) == len(caught.value.mistakes)
    for line, key in zip(lines, told, strict=True):
        assert line.startswith(f"{tmp_path / 'robot.toml'}: {key}")
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


def test_a_wrong_head_hides_no_mistake_that_does_not_depend_on_it(tmp_path):
    values, told = wrong_everywhere()
    values["head"] = "turret"
    with pytest.raises(MistakesError) as caught:
        load(tmp_path, values)
    keys = [line.split(": ")[1] for line in caught.value.lines]
    # without the head nobody knows the names of its joints
    assert keys == ["head", *(key[:-2] for key in told if key != "servos[1].name: ")]


def test_the_command_line_tells_each_mistake_in_a_line_of_its_own(tmp_path, capsys):
    values, told = wrong_everywhere()
    path = tmp_path / "robot.toml"
    path.write_text(toml_text(values), encoding="utf-8")
    assert call("check-cameras", "--config", str(path)) == 2
    assert capsys.readouterr().err.count("vergence: error: ") == len(told)


def test_each_joint_needs_a_servo(tmp_path):
    values = document()
    del values["servos"][2]
    said = r"servos: expected a servo for each of .*, got \['left_pan', 'left_tilt', 'right_til"
    refused(said, load, tmp_path, values, error=HeadFileError)


def test_a_path_with_no_file_of_toml_is_refused(tmp_path):
    path = tmp_path / "robot.toml"
    for content, said in ((b"head = ", "no TOML"), (b'"t\xfcrrets"', "not text in UTF-8")):
        path.write_bytes(content)
        refused(rf"robot\.toml: {said}", load_hardware, path, error=UnreadableFileError)
    said = "the TOML file of a robot's configuration"
    refused(said, load_hardware, tmp_path, error=UnreadableFileError)
    none = tmp_path / "none.toml"
    refused(r"none\.toml: No such file", load_hardware, none, error=UnreadableFileError)
    refused("config: expected the path of a TOML file, got 5", load_hardware, 5)


def test_a_head_file_is_looked_for_beside_the_configuration(tmp_path, monkeypatch):
    save_head(load_head("turrets"), tmp_path / "own.toml")
    (tmp_path / "robot.toml").write_text(toml_text(edited("head", "own.toml")), encoding="utf-8")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert load_hardware("../robot.toml").head.digest == load_head("turrets").digest


def test_a_fault_in_the_head_file_names_that_file(tmp_path):
    (tmp_path / "own.toml").write_text("name = 'own'\nsize = 3\n", encoding="utf-8")
    refused(r"own\.toml: ", load, tmp_path, edited("head", "own.toml"), error=HeadFileError)


def test_a_misspelt_preset_is_refused_by_its_whole_place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = rf"robot\.toml: head: expected .*{re.escape(str(tmp_path / 'turret'))}.*'turret'"
    refused(said, load, "", edited("head", "turret"), error=HeadFileError)


def test_a_tied_head_has_servos_for_its_neck_and_actuators(tmp_path):
    values, head = document("icub"), load_head("icub")
    for servo in values["servos"]:
        servo["gear_ratio"] = 0.5
    config = load(tmp_path, values)
    assert [one.upper_rad for one in config.servos] == head.actuation.upper[:6].tolist()
    assert {one.name: one.slot for one in config.servos} == {
        "neck_pitch": 0, "neck_roll": 1, "neck_yaw": 2,
        "eyes_tilt": 3, "eyes_version": 4, "eyes_vergence": 5,
    }  # fmt: skip


# ---- a measured loop ----

LOOP = LoopConfig(
    measured="2026-11-25", command_latency_s=0.0125, lag_s=0.045, speed_gain=0.9,
    backlash_rad=0.002, jitter_s=0.008, computing_s=0.003, acceleration_ratio=0.5,
    sigma={"lag_s": 1e-4, "latency_s": 2e-3},
)  # fmt: skip
LATENCIES_S = {"left": 0.07, "right": 0.09}


@pytest.fixture
def desk(tmp_path):
    path = tmp_path / "desk.toml"
    path.write_text(
        f"# mine\n{toml_text(document())}\n[safety] # bounds\nspeed_rad_s = 2.0 # low\n"
    )
    return path


def test_a_loop_is_written_over_an_older_one_and_all_else_stays(desk):
    before = desk.read_text()
    older = dataclasses.replace(LOOP, lag_s=0.02, sigma={"speed_gain": 0.1})
    write_loop(desk, older, {"left": 0.5, "right": 0.5})
    write_loop(desk, LOOP, LATENCIES_S)
    config, after = load_hardware(desk), desk.read_text()
    assert config.loop == LOOP
    assert [camera.latency_s for camera in config.cameras] == list(LATENCIES_S.values())
    assert [line for line in before.splitlines() if line not in after.splitlines()] == []


def test_an_eye_that_was_not_measured_and_what_was_not_reached_are_not_written(desk):
    weak = dataclasses.replace(LOOP, acceleration_ratio=None, jitter_s=0.0)
    right_s = load_hardware(desk).cameras[1].latency_s
    write_loop(desk, weak, {"left": 0.07})
    config = load_hardware(desk)
    assert config.loop == weak
    assert [camera.latency_s for camera in config.cameras] == [0.07, right_s]


def test_a_loop_that_cannot_be_is_refused_by_its_key(tmp_path):
    for changes, key in (
        ({"lag": 0.03}, "loop.lag"), ({"lag_s": 45.0}, "loop.lag_s"),
        ({"lag_s": None}, "loop.lag_s"), ({"jitter_s": -0.001}, "loop.jitter_s"),
        ({"speed_gain": 2.5}, "loop.speed_gain"), ({"backlash_rad": 0.3}, "loop.backlash_rad"),
        ({"acceleration_ratio": 0.0}, "loop.acceleration_ratio"),
        ({"measured": None}, "loop.measured"), ({"sigma": {"lag_s": -1.0}}, "loop.sigma.lag_s"),
        ({"sigma": {"play": 1.0}}, "loop.sigma.play"),
    ):  # fmt: skip
        values = dataclasses.asdict(LOOP) | changes
        values = {name: value for name, value in values.items() if value is not None}
        error = refused("loop", load, tmp_path, document() | {"loop": values}, error=HeadFileError)
        assert error.key == key


def test_simulation_has_what_was_measured_and_the_rest_from_the_head(desk):
    unmeasured = loop_variation(load_hardware(desk))
    assert unmeasured.frame_phase == (0.0, 1.0)
    assert unmeasured.lag_s is unmeasured.command_latency_s is unmeasured.jitter_s is None
    write_loop(desk, LOOP, LATENCIES_S)
    config = load_hardware(desk)
    found = loop_variation(config)
    for name, value in {
        "latency_s": 0.08 + LOOP.computing_s, "jitter_s": 0.008, "command_latency_s": 0.0125,
        "feedback_latency_s": 0.0, "lag_s": 0.045, "speed_gain": 0.9, "backlash_rad": 0.002,
        "acceleration_ratio": 0.5,
    }.items():  # fmt: skip
        assert getattr(found, name) == pytest.approx((value, value)), name
