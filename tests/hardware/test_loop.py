"""A measured loop: written into a robot's file, read strictly, and simulated."""

import dataclasses

import pytest

from tests.hardware.test_config import document, load
from tests.naming import named
from vergence.errors import HeadFileError
from vergence.hardware.config import LoopConfig, load_hardware, loop_variation, write_loop
from vergence.models.toml_table import toml_text

LOOP = LoopConfig(
    measured="2026-11-25", command_latency_s=0.0125, lag_s=0.045, speed_gain=0.9,
    backlash_rad=0.002, jitter_s=0.008, computing_s=0.003, acceleration_ratio=0.5,
    sigma={"lag_s": 1e-4, "latency_s": 2e-3},
)  # fmt: skip
LATENCIES_S = {"left": 0.07, "right": 0.09}


def table(**changes):
    """The plain values of the table [loop]; None takes a key away."""
    values = dataclasses.asdict(LOOP) | changes
    return {name: value for name, value in values.items() if value is not None}


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
        with named(changes):
            with pytest.raises(HeadFileError) as refused:
                load(tmp_path, document() | {"loop": table(**changes)})
            assert refused.value.key == key


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
