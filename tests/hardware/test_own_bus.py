"""A bus of somebody's own behind the seam: the template in docs/examples, in simulated time."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.hardware.fakes import FakeClock
from tests.hardware.test_config import document, load
from tests.hardware.virtual import VirtualRobot
from tests.naming import named
from vergence.errors import ConfigurationError, HardwareError, HeadFileError
from vergence.hardware.checks import check_servos
from vergence.hardware.config import load_hardware, write_servos
from vergence.hardware.jog import Jogger

TEMPLATE = Path(__file__).resolve().parents[2] / "docs" / "examples" / "own_bus.py"
SLOW = np.array([[0.0, 0.0, 0.0, 0.4, -0.4, 0.2, 0.2]])


def own(folder, source="", kind="OwnBus", **options):
    """The configuration of a robot on a bus beside it: that of the template, or made from it."""
    values = document()
    name = f"own_{abs(hash(source))}.py"
    (folder / name).write_text(f"{TEMPLATE.read_text()}\n\n{source}")
    values["bus"] = {"kind": f"{name}:{kind}", **options}
    for servo in values["servos"]:
        del servo["zero_ticks"]
    return load(folder, values)


@pytest.fixture
def robot(monkeypatch, tmp_path):
    def make(source="", kind="OwnBus", **options):
        return VirtualRobot(monkeypatch, config=own(tmp_path, source, kind, **options))

    return make


def test_a_trial_runs_on_it_and_ends_at_rest(robot):
    one = robot(lag_s=0.02)
    with pytest.warns(match="bus: expected servos that stop by themselves when nobody speaks"):
        one.plant.prepare()
    one.begin()
    for _ in range(30):
        reading = one.plant.step(SLOW)
    assert one.plant.fault == ""
    assert reading.command[0, 3:] == pytest.approx(SLOW[0, 3:])
    assert reading.velocities[0, 3:] == pytest.approx(SLOW[0, 3:], abs=0.03)
    assert reading.positions[0, 3:] == pytest.approx(0.48 * SLOW[0, 3:], abs=0.02)
    bus = one.plant.robot._servos
    one.plant.close()
    assert not bus._goals.any()
    assert bus._torque.all()


BREAKS = """
class Broken(OwnBus):
    def read(self):
        if self.how == "error":
            raise OSError("the plug is out")
        if self.how == "silent":
            return super().read()._replace(ages_s=np.array([np.inf, 0.0, 0.0, 0.0]))
        if self.how == "told":
            self.fault = "servos: left_pan: expected no smoke, got some"
        return super().read()

    def send(self, speeds):
        return super().send(speeds)[: 3 if self.how == "short" else 4]

    def _turn(self):
        before = self._angles.copy()
        super()._turn()
        if self.how == "stuck":
            self._angles = before

    how = ""
"""


@pytest.mark.filterwarnings("ignore::vergence.errors.VergenceWarning")
@pytest.mark.parametrize(("how", "said"), [
    ("error", r"bus: .*own_\d+\.py:\d+ in read: OSError: the plug is out"),
    ("silent", r"left_pan: expected an answer of the id 1, got none for 0\.1 s; cure: check its c"),
    ("told", "servos: left_pan: expected no smoke, got some"),
    ("short", r"bus: expected arrays of 4 servos from send, got the shape \(3,\)"),
    ("stuck", "left_pan: expected the joint to follow its commands, got one that stands still"),
])  # fmt: skip
def test_what_fails_in_it_stops_the_head_with_a_line(robot, how, said):
    one = robot(BREAKS, "Broken")
    one.begin()
    one.plant.step(SLOW)
    bus = one.plant.robot._servos
    bus.how = how
    until_s = one.clock() + 1.0
    while not one.plant.fault and one.clock() < until_s:
        one.plant.step(SLOW)
    assert re.search(said, one.plant.fault)
    if how == "stuck":
        assert not bus._torque[:2].any()
    elif how != "error":
        assert not bus._goals.any()


MISTAKES = {
    "def read(self): return None": "expected a ServoReading from read, got None",
    "def read(self): return super().read()._replace(time_s=0.0)": "expected a time of the clock",
    "def read(self): return super().read()._replace(time_s=np.nan)": "expected a time of the clock",
    "def read(self): return super().read()._replace(ages_s=0.0)": "arrays of 4 servos from read",
    "def read(self): return super().read()._replace(ages_s=np.full(4, 0.2))":
        r"expected the joints' angles within 0\.15 s",
    "def read(self): return super().read()._replace(angles=np.full(4, 2.0), speeds=[np.nan] * 4)":
        "left_tilt: expected an angle of",
    "def send(self, speeds): return 0.0 * speeds + np.nan": "expected finite speeds from send",
    "def check(self): return ['too hot']": "expected a list of Finding from check",
    "def switch_on(self, which): raise ValueError('no torque')": "in switch_on: ValueError: no to",
    "def open(self): raise OSError('no such device')": "in open: OSError: no such device",
    "def must_let_go(self): return [True] * 7": "expected must_let_go of 4 servos",
    "stops_alone_after_s = '0.2'": "expected seconds or None in stops_alone_after_s, got '0.2'",
    "unit_rad = 0": "expected unit_rad above 0, got 0",
    "def __init__(self, servos, head, clock): pass": "cannot be made: .*has no attribute 'servos'",
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::vergence.errors.VergenceWarning")
def test_what_a_person_does_wrong_in_it_is_one_line(robot):
    def runs(source):
        prefix = "@property\n    " if "must_let_go" in source else ""
        one = robot(f"class Wrong(OwnBus):\n    {prefix}{source}\n", "Wrong")
        one.begin()
        for _ in range(10):
            one.plant.step(SLOW)
        return one.plant.fault

    for source, said in MISTAKES.items():
        with named(source), pytest.raises((HardwareError, ConfigurationError), match=said):
            runs(source)


@pytest.mark.filterwarnings("ignore::vergence.errors.VergenceWarning")
def test_what_may_be_left_out_may_be_left_out(robot):
    source = "class Short(OwnBus):\n    def check(self): pass\n    def describe(self): pass\n"
    one = robot(source + "    def switch_on(self, which): super().switch_on(which)\n", "Short")
    one.begin()
    one.plant.step(SLOW)
    assert one.plant.fault == ""
    one.plant.close()


@pytest.mark.filterwarnings("ignore::vergence.errors.VergenceWarning")
def test_a_bus_is_closed_once_for_each_time_that_it_was_opened(robot):
    source = (
        "class Once(OwnBus):\n    def close(self):\n        self._goals, gone = None, self._goals\n"
    )
    one = robot(source + "        assert gone is not None\n", "Once")
    one.begin()
    one.plant.close()
    one.plant.close()


@pytest.mark.filterwarnings("ignore::vergence.errors.VergenceWarning")
def test_a_trial_that_pauses_goes_on_as_nothing_has_stopped_it(robot):
    one = robot()
    one.begin()
    one.plant.step(SLOW)
    one.clock.stand_still(0.3)
    one.plant.step(0.0 * SLOW)
    assert one.plant.fault == ""


def test_a_joint_is_jogged_to_its_zero_and_the_zero_is_written(tmp_path):
    config, clock = own(tmp_path), FakeClock()
    bus = config.make_servos(clock)
    assert [one.part for one in check_servos(config, bus)] == ["bus"]
    jog = Jogger(config, bus, clock=clock, sleep=clock.sleep)
    assert jog.step("left_tilt", 0.1) == pytest.approx(0.1, rel=0.2)
    assert bus._torque.tolist() == [False, True, False, False]
    jog.set_zero("left_tilt")
    write_servos(config.path, jog.servos.values())
    zero = load_hardware(config.path).servos[1].zero
    assert zero == pytest.approx(bus._angles[1])
    assert 0.08 < zero < 0.12


WRONG = {
    "kind = 5": (HeadFileError, "bus.kind: expected dynamixel, or module:class of your own bus"),
    'kind = "feetech"': (HeadFileError, "bus.kind: expected dynamixel, or module:class"),
    'kind = "none.py:OwnBus"': (ConfigurationError, "bus.kind: expected module:class that exists"),
    'kind = "own.py:Half"': (ConfigurationError, "one without close, open, read"),
    'kind = "own.py:np"': (ConfigurationError, "bus.kind own.py:np: expected a class"),
    'kind = "own.py:OwnBus"\nlag = 0.1': (ConfigurationError, "lag"),
}


def test_another_kind_is_refused_with_the_file(tmp_path):
    own(tmp_path)
    half = "\n\nclass Half(Servos):\n    send = stop = release = switch_on = None\n"
    (tmp_path / "own.py").write_text(TEMPLATE.read_text() + half)
    text = (tmp_path / "robot.toml").read_text()
    for words, (kind, said) in WRONG.items():
        (tmp_path / "robot.toml").write_text(re.sub(r"kind = .*", words, text))
        with named(words), pytest.raises(kind, match=said):
            load_hardware(tmp_path / "robot.toml")
