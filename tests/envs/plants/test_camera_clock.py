"""The cameras' own clock: any rate, phase and drift, and the exact posture at each exposure."""

import numpy as np
import pytest

from tests.envs.plants.trajectory import motion_of, swing
from tests.envs.trials import AHEAD, pixels_of, start_of, steps
from tests.naming import named
from vergence import HeadModel
from vergence.envs.plant import make_plant

STAMPED = {"exposure_stamps": True, "exposure_s": 0.0}
LATENCY_S = 0.0437
RATES = [(120, 15.0), (120, 47.3), (120, 60.0), (50, 120.0), (250, 60.0)]
CLOCK = {"frame_phase": 0.37, "clock_drift": 0.003}


def looped(head: HeadModel, control_hz: float, frame_hz: float, **timing) -> HeadModel:
    """The head in a loop of other rates, its exposures stamped."""
    own = {"control_rate_hz": control_hz, "frame_rate_hz": frame_hz, "latency_s": LATENCY_S}
    return head.replace(timing={**STAMPED, **own, **timing})


def frame_at(step: int, head: HeadModel, phase: float, drift: float) -> tuple[int, float]:
    """The newest frame that can be read at a step, and when it was exposed."""
    frame_s = (1.0 + drift) / head.timing.frame_rate_hz
    age_s = step * head.timing.period_s - head.timing.latency_s
    frame = int(np.floor(age_s / frame_s - phase + 1e-9))
    return frame, (phase + frame) * frame_s


def test_a_reading_has_the_newest_frame_of_a_clock_of_its_own(exact) -> None:
    for control_hz, frame_hz in RATES:
        with named(control_hz, frame_hz):
            head = looped(exact, control_hz, frame_hz)
            plant = make_plant("kinematic", head, 1, **CLOCK)
            readings, _q, _v = steps(plant, start_of(), int(1.5 * control_hz))
            first, _time_s = frame_at(0, head, 0.37, 0.003)
            for step, reading in enumerate(readings):
                frame, exposed_s = frame_at(step, head, 0.37, 0.003)
                assert reading.exposure_s == pytest.approx([exposed_s], abs=1e-12)
                assert reading.received_s == pytest.approx([exposed_s + LATENCY_S], abs=1e-12)
                assert reading.visible.all() == (exposed_s >= 0.0)
                assert reading.frame[0] == frame - first


@pytest.mark.parametrize(
    ("plant_name", "within_px", "control_hz", "frame_hz"),
    [("kinematic", 1e-6, 120, 47.3), ("kinematic", 1e-6, 250, 60.0), ("mujoco", 0.02, 50, 120.0)],
)
def test_an_image_shows_the_posture_of_its_own_instant(
    exact, control_hz, frame_hz, plant_name, within_px
) -> None:
    head, count = looped(exact, control_hz, frame_hz), int(0.6 * control_hz)
    commands = swing(count, head.timing.period_s, 0.8)
    own = {"neck": "welded"} if plant_name == "mujoco" else {}
    plant = make_plant(plant_name, head, 1, **CLOCK, **own)
    readings, _q, _v = steps(plant, start_of(), count, lambda k: commands[k])
    motion, seen = motion_of(head, commands), 0
    if plant_name == "mujoco":  # whose time step is a quarter of the control period
        within_px *= max(1.0, 100.0 / control_hz)
    for step, reading in enumerate(readings):
        _frame, exposed_s = frame_at(step, head, 0.37, 0.003)
        if exposed_s < 0.0:
            continue
        expected = pixels_of(head, motion(exposed_s)[0], np.zeros(7))
        assert reading.pixels[0] == pytest.approx(expected, abs=within_px)
        seen += 1
    assert seen > 20
    # the eyes move by so much within a period that another instant would show
    moved = head.project(motion(0.3)[0], AHEAD) - head.project(motion(0.3 + 1e-3)[0], AHEAD)
    assert np.abs(moved).max() > 0.2


def test_cameras_run_from_before_the_trial(exact) -> None:
    # a late image of a slow camera: what is read at time zero was exposed long before it
    head = looped(exact, 120, 10.0, latency_s=0.25)
    plant = make_plant("kinematic", head, 1, frame_phase=0.5)
    before = (0.05, -0.1, 1.0)
    reading = plant.begin(start_of(before=before))
    assert reading.exposure_s == pytest.approx([-0.25], abs=1e-12)
    assert reading.visible.all()
    assert reading.pixels == pytest.approx(head.project(np.zeros((1, 7)), before), abs=1e-9)


def test_heads_of_a_batch_have_clocks_of_their_own(exact) -> None:
    head = looped(exact, 120, 60.0)
    hz, phase, drift = [20.0, 63.0, 110.0], [0.1, 0.5, 0.9], [0.0, -0.002, 0.01]
    options = {"frame_rate_hz": hz, "frame_phase": phase, "clock_drift": drift}
    readings, _q, _v = steps(make_plant("kinematic", head, 3, **options), start_of(3), 100)
    for i in range(3):
        alone = head.replace(timing={"frame_rate_hz": hz[i]})
        for step, reading in enumerate(readings):
            _frame, exposed_s = frame_at(step, alone, phase[i], drift[i])
            assert reading.exposure_s[i] == pytest.approx(exposed_s, abs=1e-12)


@pytest.mark.parametrize(
    ("plant_name", "within_px", "frame_hz", "share"),
    [("kinematic", 1e-6, 47.3, 0.99), ("mujoco", 0.02, 200.0, 0.5)],
)
def test_the_right_eye_sees_what_is_there_one_skew_later(
    exact, plant_name, within_px, frame_hz, share
) -> None:
    head, count = looped(exact, 120, frame_hz), 70
    skew_s, commands = share / frame_hz, swing(count, 1 / 120)
    own = {"neck": "welded"} if plant_name == "mujoco" else {}
    plant = make_plant(plant_name, head, 1, skew_s=skew_s, **CLOCK, **own)
    readings, _q, _v = steps(plant, start_of(before=AHEAD), count, lambda k: commands[k])
    motion, start = motion_of(head, commands), np.zeros(7)
    apart = []
    for reading in readings:
        left_s = float(reading.exposure_s[0])
        assert reading.received_s == pytest.approx([left_s + skew_s + LATENCY_S], abs=1e-12)
        left, right = (pixels_of(head, motion(t)[0], start) for t in (left_s, left_s + skew_s))
        assert reading.pixels[0, 0] == pytest.approx(left[0], abs=within_px)
        assert reading.pixels[0, 1] == pytest.approx(right[1], abs=within_px)
        apart.append(np.abs(left[1] - right[1]).max())
        # the newest pair that can have come
        frame_s = (1.0 + CLOCK["clock_drift"]) / frame_hz
        assert reading.time_s[0] - reading.received_s[0] < frame_s
    assert max(apart) > 1.0
