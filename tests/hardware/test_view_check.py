"""Wrong configurations, named by what the images do while single joints turn."""

import dataclasses

import numpy as np
import pytest

from tests.hardware.fakes import HEAD, TAG, blank, with_tag
from tests.hardware.virtual import VirtualRobot, WatchedWorld, virtual_config
from tests.naming import named
from vergence import load_head
from vergence.errors import ChecksFailedError, HardwareError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.emulator.config import EmulatorConfig
from vergence.hardware.view_check import Posture, Turn, ViewCheck, range_by_size
from vergence.models.camera import Camera
from vergence.vision.tracking import make_detector

ICUB = load_head("icub")
SLOTS = {name: 3 + i for i, name in enumerate(HEAD.actuation.names)}
POINT = np.array([0.05, -0.04, 0.8])
NOTHING = Posture(np.zeros(7), np.full((2, 2), np.nan), np.full(2, np.nan))


def seen(head=HEAD, angles=lambda q: q, pixels=lambda uv: uv, ranges=False, noise_px=0.3):
    """The check of a head whose true angles and pixels differ from the reported ones."""
    config, rng = virtual_config(head), np.random.default_rng(1)
    check = ViewCheck(config)
    told = head.actuation.actuators_of(head.rest())
    for servo in (None, *config.servos):
        if servo is not None:
            told = told + np.where(np.arange(7) == servo.slot, 0.1, 0.0)
            check.turns.append(Turn(servo, 0.1, 0.1, 0.1))
        q = head.actuation.joints_of(angles(told))
        T_N_0 = np.linalg.inv(head.base_pose(q)) @ head.base_pose(head.rest())
        point = T_N_0[:3, :3] @ POINT + T_N_0[:3, 3]
        shown = head.project(q, point) + rng.normal(0.0, noise_px, (2, 2))
        away = np.linalg.norm(point - head.camera_poses(q)[:, :3, 3], axis=-1)
        away = away if ranges else np.full(2, np.nan)
        check.postures.append(Posture(told.copy(), pixels(shown), away))
    return check.findings(TAG, None)


def with_sign(slot):
    return lambda angles: np.where(np.arange(7) == slot, -angles, angles)


def exchanged(one, other):
    order = np.arange(7)
    order[[one, other]] = other, one
    return lambda angles: angles[order]


def offset(slot, by_rad):
    return lambda angles: angles + by_rad * (np.arange(7) == slot)


@pytest.mark.parametrize("head", [HEAD, ICUB], ids=["turrets", "icub"])
def test_a_right_head_passes_and_exchanged_cameras_are_named(head):
    assert seen(head) == []
    (finding,) = seen(head, pixels=lambda pixels: pixels[::-1])
    assert finding.part == "cameras"
    assert "the cameras are exchanged" in finding.problem
    assert not finding.warning


@pytest.mark.slow
def test_a_wrong_sign_is_named_with_its_joint():
    for name, slot in SLOTS.items():
        with named(name):
            (finding,) = seen(angles=with_sign(slot))
            assert finding.part == f"servos: {name}"
            assert "its sign is wrong" in finding.problem
            assert finding.cure.startswith("sign = -1")


def test_exchanged_ids_are_named():
    (finding,) = seen(angles=exchanged(3, 5))
    assert finding.part == "servos: left_pan, right_pan"
    assert "their ids are exchanged" in finding.problem


def test_an_image_that_is_upside_down_is_named():
    size = HEAD.cameras.size[0]
    (finding,) = seen(pixels=lambda pixels: np.stack([size - 1 - pixels[0], pixels[1]]))
    assert finding.part == "cameras.left"
    assert "upside down" in finding.problem


def test_a_wrong_gear_is_named():
    (finding,) = seen(angles=lambda angles: np.where(np.arange(7) == 5, 2.0 * angles, angles))
    assert finding.part == "servos: right_pan"
    assert "gear_ratio = 0.5" in finding.cure


def test_two_mistakes_at_once_are_told_with_what_was_seen():
    both = with_sign(3), exchanged(4, 6)
    (finding,) = seen(angles=lambda angles: both[1](both[0](angles)))
    assert "no single mistake explains it" in finding.problem
    assert "left_pan (left eye)" in finding.problem


def test_a_zero_of_a_tilt_is_told_by_lines_of_sight_that_miss_each_other():
    (finding,) = seen(angles=offset(SLOTS["left_tilt"], 0.18))
    assert "left_tilt" in finding.part
    assert "off by about 0.18 rad" in finding.problem
    assert not finding.warning


def test_a_zero_of_a_pan_is_told_by_the_size_of_the_target():
    assert seen(angles=offset(SLOTS["left_pan"], -0.15)) == []
    (finding,) = seen(angles=offset(SLOTS["left_pan"], -0.15), ranges=True)
    assert "left_pan" in finding.part
    assert not finding.warning


def test_a_small_error_of_a_zero_is_a_warning_and_zeros_set_by_eye_pass():
    assert seen(angles=lambda angles: angles + 0.015 * np.array([0, 0, 0, 1, -1, -1, 1])) == []
    (finding,) = seen(angles=offset(SLOTS["left_tilt"], 0.1))
    assert finding.warning


def test_speeds_of_another_unit_are_named():
    servo = virtual_config().servos[0]
    check = ViewCheck(virtual_config(), turns=[Turn(servo, 0.05, 0.1, 0.1)])
    (finding,) = check.findings(TAG, None)
    assert "the unit or scale in which the bus sends speeds" in finding.problem
    assert "GOAL_VELOCITY" in finding.cure
    check.turns[:] = [Turn(servo, 0.1, -0.1, 0.1)]
    (finding,) = check.findings(TAG, None)
    assert "got -1 times that: the sign in which the bus reads speeds" in finding.problem


def test_a_target_that_no_eye_sees_offers_to_go_without_the_check():
    images = blank(HEAD), blank(HEAD, 1)
    (finding,) = ViewCheck(virtual_config(), [NOTHING]).findings(TAG, images)
    assert "got images without it from both cameras" in finding.problem
    assert "--no-view-check" in finding.cure


def test_mirrored_images_are_named_as_such():
    images = tuple(with_tag(HEAD, eye)[0][:, ::-1].copy() for eye in range(2))
    findings = ViewCheck(virtual_config(), [NOTHING]).findings(TAG, images)
    assert [one.part for one in findings] == ["cameras.left", "cameras.right"]
    assert "mirrored" in findings[0].problem


def test_the_size_of_a_tag_gives_its_distance():
    image, _ = with_tag(HEAD, corner=(280, 200), edge=97)
    found = make_detector(TAG, Camera.of(HEAD, 0)).detect(image)
    # 97 px between the edges of a tag of 150 mm, at 651 px of focal length
    assert range_by_size(HEAD, 0, found) == pytest.approx(0.15 * 651.0 / 97.0, rel=0.03)


def robot_before_a_target(monkeypatch, head=HEAD, motors=None, config=None, **options):
    world = WatchedWorld(head, POINT, motors, latency_s=head.timing.latency_s)
    config = config or virtual_config(head, head.timing.latency_s)
    return VirtualRobot(monkeypatch, world, config, **options)


@pytest.mark.slow
@pytest.mark.parametrize("head", [HEAD, pytest.param(ICUB, marks=pytest.mark.nightly)])
def test_a_right_robot_with_friction_and_play_begins(monkeypatch, head):
    motors = EmulatorConfig(friction=0.06, gravity=0.1, backlash_rad=0.004, speed_gain=0.87)
    robot = robot_before_a_target(monkeypatch, head, motors)
    robot.begin()
    assert robot.plant.fault == ""


@pytest.mark.slow
def test_exchanged_cameras_are_refused_before_a_trial_and_the_head_rests(monkeypatch):
    robot = robot_before_a_target(monkeypatch, eyes=(1, 0))
    with pytest.raises(ChecksFailedError, match="the cameras are exchanged"):
        robot.begin()
    assert robot.rested_s(robot.clock() - 0.1) == 0.0
    with pytest.raises(HardwareError, match="release it first"):
        robot.begin()


@pytest.mark.slow
def test_speeds_of_half_the_unit_are_refused_before_a_trial(monkeypatch):
    robot = robot_before_a_target(monkeypatch)
    robot.plant.prepare()
    robot.fault(what="speed-scale", ids=[2], value=0.5)
    with pytest.raises(ChecksFailedError, match=r"left_tilt: .*got 0\.\d+ times that: the unit"):
        robot.begin()


@pytest.mark.slow
def test_the_check_can_be_left_out(monkeypatch):
    config = virtual_config(view_check=False)
    servos = (dataclasses.replace(config.servos[0], sign=-1), *config.servos[1:])
    robot = robot_before_a_target(monkeypatch, config=dataclasses.replace(config, servos=servos))
    robot.begin()
    assert robot.world.servos["left_pan"].get(table.TORQUE_ENABLE) == 1
