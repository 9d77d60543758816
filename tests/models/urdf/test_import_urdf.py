"""A head out of a URDF or MJCF moves as the file says, and what cannot be one says why."""

import itertools
import re
import tomllib

import mujoco
import numpy as np
import pytest

from tests import naming
from tests.models.urdf.descriptions import (
    NECK,
    OPTICAL,
    UrdfKinematics,
    eye,
    joint,
    real_robot,
    urdf,
)
from tests.naming import named
from vergence.errors import ConfigurationError, HeadFileError, VergenceError
from vergence.models import HeadModel, load_head
from vergence.models.urdf.import_urdf import ImportedHead, UrdfSource, import_urdf

TURNS = ("yaw", "roll", "pitch")
CAMERAS = ("left_optical", "right_optical")
TURRETS = ("left_pan", "left_tilt", "right_pan", "right_tilt")
LEFT, RIGHT = eye("left"), eye("right")
ROBOT = urdf(NECK, LEFT, RIGHT)
FIXED_EYES = "".join(
    joint(f"{side}_mount", "head", f"{side}_optical", kind="fixed", xyz=xyz, rpy=OPTICAL)
    for side, xyz in (("left", "0.1 0.05 0"), ("right", "0.1 -0.05 0"))
)


def follows(text: str, name: str, mimic: str) -> str:
    """A description in which a joint follows another one."""
    end = text.index("</joint>", text.index(f'<joint name="{name}"'))
    return f"{text[:end]}<mimic {mimic}/>{text[end:]}"


@pytest.fixture
def head_of(tmp_path):
    def run(text: str, **options) -> ImportedHead:
        mjcf = "<mujoco" in text
        path = tmp_path / ("robot.xml" if mjcf else "robot.urdf")
        path.write_text(text, encoding="utf-8")
        usual = MJCF_OPTIONS if mjcf else {"cameras": CAMERAS, "neck": TURNS}
        return import_urdf(UrdfSource(**{"file": path, "base": "base"} | usual | options))

    return run


@pytest.fixture
def refused(head_of):
    """What a description is refused with, which a pattern fits."""

    def run(text: str, why: str, error=ConfigurationError, **options) -> str:
        return str(naming.refused(why, head_of, text, error=error, **options))

    return run


def random_angles(head: HeadModel, count: int) -> np.ndarray:
    """(count, 7) joint angles within limits, tied joints tied."""
    q = np.random.default_rng(0).uniform(head.limits.lower, head.limits.upper, (count, 7))
    for i, j in itertools.combinations(range(7), 2):
        if head.joints[i] and head.joints[i] == head.joints[j]:
            q[:, j] = q[:, i]
    return q


def by_name(head: HeadModel, q: np.ndarray) -> dict[str, float]:
    return {name: float(angle) for name, angle in zip(head.joints, q, strict=True) if name}


def assert_moves_as(head, cameras, kinematics, base, held):
    """`base_pose` and `camera_poses` are those of other kinematics, N fixed to the last link."""
    q = random_angles(head, 100)
    found = head.base_pose(q)[:, None] @ head.camera_poses(q)
    angles = [by_name(head, row) | held for row in q]
    wanted = [[kinematics.pose(name, base, each) for name in cameras] for each in angles]
    assert np.abs(found - np.array(wanted)).max() < 1e-9


def test_a_head_moves_as_its_urdf(head_of):
    lift = joint("lift", "foot", "base", kind="prismatic", xyz="0 0 0.2", lower="0", upper="0.4")
    shared = joint("eyes_tilt", "head", "tilted", xyz="0.04 0 0.1", axis="0 1 0") + "".join(
        joint(f"{side}_pan", "tilted", f"{side}_eye", xyz=f"0 {y} 0", axis=axis)
        + joint(f"{side}_fixed", f"{side}_eye", f"{side}_optical", kind="fixed", rpy=OPTICAL)
        for side, y, axis in (("left", 0.034, "0 0 -1"), ("right", -0.034, "0 0 1"))
    )
    tied = follows(NECK, "roll", 'joint="yaw" multiplier="0.5" offset="0.1"')
    twice = follows(tied, "pitch", 'joint="roll" multiplier="-2" offset="0.05"')
    off_the_way = [  # where a file may say anything
        joint("jaw", "head", "chin", lower="", velocity="").replace("<origin xyz", "<origin xzy"),
        joint("tail", "n1", "tip", rpy="0 0 180"),
        joint("stand", "floor", "base", kind="floating", rpy="0 0 360"),
        joint("tray", "n1", "plate", kind="planar"),
        joint("stuck", "head", "stuck_link", lower="0.2", upper="0.2"),
    ]
    turned = NECK.replace('rpy="0.1 -0.2 0.3"', 'rpy="0.1 -0.2 -6.2832"')
    lifted = {"base": "foot", "neck": ("yaw", "pitch"), "lock": ("lift=0.25m", "roll=-20")}
    yaw = np.deg2rad(20.0)
    for text, options, joints, motors, held in [
        (ROBOT, {"neck": ("pitch", "yaw", "roll")}, (*TURNS, *TURRETS), 4, {}),  # in any order
        (urdf(NECK, shared), {}, (*TURNS, "eyes_tilt", "left_pan", "eyes_tilt"), 3, {}),
        (urdf(lift, NECK, LEFT, RIGHT), lifted, ("yaw", "pitch", ""), 4,
         {"lift": 0.25, "roll": -yaw}),
        (urdf(NECK, FIXED_EYES), {}, TURNS, 0, {}),
        (urdf(tied, LEFT, RIGHT), {"neck": ("pitch",), "lock": ("yaw=20",)}, ("pitch", ""), 4,
         {"yaw": yaw, "roll": 0.5 * yaw + 0.1}),
        (urdf(twice, LEFT, RIGHT), {"neck": (), "lock": ("yaw=20",)}, ("", "", ""), 4,
         {"yaw": yaw, "roll": 0.5 * yaw + 0.1, "pitch": -yaw - 0.15}),
        (urdf(turned, LEFT, RIGHT, *off_the_way), {}, TURNS, 4, {}),
    ]:  # fmt: skip
        with named(options, joints):
            imported = head_of(text, **options)
            assert imported.head.joints[: len(joints)] == joints
            assert imported.head.actuation.count == motors
            assert imported.chains.fixed_values == pytest.approx(held)
            base = options.get("base", "base")
            assert_moves_as(imported.head, CAMERAS, UrdfKinematics(text), base, held)


def test_a_mimic_between_eye_joints_becomes_one_motor(head_of):
    tilt = {"xyz": "0.01 0 0", "axis": "0 -1 0", "lower": "-0.5", "upper": "0.7", "velocity": "3"}
    mimic = 'joint="left_tilt" multiplier="-1.5" offset="0.1"'
    follower = joint("right_tilt", "right_a", "right_b", mimic=mimic, **tilt)
    plain = joint("right_tilt", "right_a", "right_b", xyz="0.01 0 0", axis="0 1 0")
    text = urdf(NECK, LEFT, RIGHT.replace(plain, follower))
    imported = head_of(text)
    tilt = next(motor for motor in imported.motors if motor.name == "left_tilt")
    assert dict(tilt.joint_factors) == {"left_tilt": 1.0, "right_tilt": -1.5}
    # the right joint's -0.5 to 0.7 allow the left one -0.4 to 0.4, at 2 rad/s
    assert tilt.limits[:3] == pytest.approx([-0.4, 0.4, 2.0])
    head, kinematics = imported.head, UrdfKinematics(text)
    low, high = head.actuation.lower, head.actuation.upper
    for slots in np.random.default_rng(1).uniform(low, high, (50, 7)):
        q = head.actuation.joints_of(slots)
        angles = by_name(imported.head, q)
        angles.pop("right_tilt")  # the other kinematics follow the mimic themselves
        found = head.base_pose(q) @ head.camera_poses(q)
        wanted = [kinematics.pose(name, "base", angles) for name in CAMERAS]
        np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_a_refused_neck_or_eye_comes_with_options_that_work(head_of, refused):
    top, foot = joint("nod", "top", "base", lower="0.1", upper="0.3"), joint("turn", "foot", "top")
    for first, options in [
        ((top, foot), {"base": "foot", "neck": ()}), ((top,), {"base": "top"}),
        ((top,), {"base": "top", "neck": ("nod", *TURNS)}), ((top, foot), {"base": "foot"}),
        ((top,), {"base": "top", "neck": ("nod", "roll", "pitch")}),
    ]:  # fmt: skip
        text = urdf(*first, NECK, LEFT, RIGHT)
        words = refused(text, "neck: ", **options)
        neck = re.search(r"--neck ((?:\w+ ?)+)", words.rpartition(": ")[2])
        lock = re.search(r"--lock ((?:\w+=[-\d.]+ ?)+)", words)
        if neck:
            options = options | {"neck": tuple(neck[1].split())}
        head = head_of(text, **options, lock=tuple(lock[1].split()) if lock else ()).head
        assert head.joints[-1] == "right_tilt"
    third = joint("left_cyclo", "left_b", "left_c", axis="1 0 0")
    third += joint("left_last", "left_c", "left_third", kind="fixed", rpy=OPTICAL)
    text = urdf(NECK, LEFT, RIGHT, third)
    options = {"cameras": ("left_third", "right_optical")}
    refused(text, r"got 3 \(.*, left_cyclo\).*--lock left_cyclo=0", **options)
    assert head_of(text, **options, lock=("left_cyclo=0",)).head.joints[3] == "left_pan"


def test_what_cannot_be_a_head_says_why_in_one_line(refused):
    waist, jaw, far, depth = (
        urdf(NECK, LEFT, RIGHT, more)
        for more in (
            joint("w", "foot", "base"), joint("jaw", "head", "chin"),
            joint("far", "foot", "base", kind="fixed", xyz="0 0 4"),
            joint("depth_mount", "left_camera", "left_depth", kind="fixed"),
        )
    )  # fmt: skip
    planar = urdf(NECK, LEFT, RIGHT.replace('right_pan" type="revolute', 'right_pan" type="planar'))
    for text, options, why in [
        (urdf(NECK, LEFT.replace("revolute", "prismatic"), RIGHT), {},
         "left_pan: .* slides .*prismatic.* --lock left_pan="),
        (planar, {}, r"^joint right_pan: .*'planar'"),
        (planar, {"lock": ("right_pan=0",)}, r"^joint right_pan: .*'planar'"),
        (urdf(NECK, LEFT, eye("right", parent="base")), {},
         "neck: .* both cameras stand on .* got 'yaw', which moves one of them"),
        (urdf(NECK, eye("left", lower="0.1", upper="0.1"), RIGHT), {},
         "left_pan: .* --lock left_pan=5.72958"),
        (waist, {"base": "foot", "neck": ("w", *TURNS)}, "neck: .* up to three joints, got 4"),
        (waist, {"base": "base_link"}, r"base_link' \(the root of the file is foot\)$"),
        (PLAIN_MJCF, {"base": "base_link"}, r"the root of the file is world\)$"),
        (ROBOT, {"base": "left_b", "neck": ()}, "base: .* got one that left_pan moves"),
        (far, {"base": "foot"}, "yaw: expected to be less than 3 m .* --base"),
        (ROBOT, {"neck": ("ptch",)}, r"neck: .* joint of the file \(near: pitch\), got 'ptch'"),
        (jaw, {"lock": ("jaw=0",)}, "lock: .* on the way from the base to the .* got 'jaw'"),
        *((ROBOT, {"neck": ("yaw", "pitch"), "lock": (lock,)}, why) for lock, why in (
            ("roll=50", "roll within -34.3775 to 34.3775 deg, got"),
            ("roll=ten", "lock: .* roll=10, in degrees, got 'roll="),
        )),
        (ROBOT, {"lock": ("roll=0",)}, "lock: expected joints that are not of the neck"),
        (ROBOT, {"cameras": ("left_opt", "x")}, r"left-camera: .* file \(near: left_optical"),
        (ROBOT, {"cameras": ("left_optical",) * 2}, "vergence needs two cameras"),
        (ROBOT, {"cameras": CAMERAS[::-1]}, "exchanged"),
        (depth, {"cameras": ("left_optical", "left_depth")}, "a colour and a depth frame of one"),
        (urdf(NECK, FIXED_EYES), {"couplings": ("version-vergence",)},
         "version-vergence a joint that pans .* got none"),
        *((ROBOT, {"speed": words}, "^speed: expected") for words in (
            ("fast",), ("-2",), ("0",), ("500",), ("jaw=2",), ("2", "3"),
        )),
        *((ROBOT, {"camera_axes": (axes,)}, "^camera-axes: expected") for axes in (
            "x,y", "x,x,z", "a,b,c", "x,y,-z", "right,down,forward", "",
        )),
    ]:  # fmt: skip
        refused(text, why, **options)
    refused(ROBOT, r"^name: ", VergenceError, name="con")
    for name, mimic, why in [
        ("roll", 'joint="yaw"', "roll: .* neck .* follows yaw"),
        ("left_pan", 'joint="pitch"', "left_pan: .* follows pitch"),
        ("left_pan", 'joint="jaw"', "left_pan: .* follows jaw, .* not on the way"),
        ("left_pan", 'joint="rightpan"', r"left_pan: .*\(near: right_pan.*'rightpan', which is no"),
        ("left_pan", 'joint="left_pan"', "left_pan: .* circle"),
        ("roll", 'joint="pitch" multiplier="0"', "neck: .* 'roll', which is held"),
    ]:
        refused(follows(jaw, name, mimic), why)


def test_a_speed_that_no_motor_has_is_refused_unless_overridden(head_of, refused):
    for speed in ["50000", "0", None, "293.2"]:
        text = urdf(NECK, eye("left", velocity=speed), RIGHT)
        refused(text, r"left_pan \(.*left_tilt \(.*--speed")
        head = head_of(text, speed=("4", "left_tilt=3", "yaw=2")).head
        assert head.limits.velocity.tolist() == [2.0, 5.0, 5.0, 4.0, 3.0, 5.0, 5.0]
        assert "--speed" in head.assumptions["joints.left_pan.velocity_rad_s"]
        assert "joints.right_pan.velocity_rad_s" not in head.assumptions


def test_what_the_file_lacks_is_marked_as_assumed(head_of, tmp_path):
    imported = head_of(ROBOT)
    head = imported.head
    assert {
        "timing.lag_s", "timing.latency_s", "image.width_px", "eyes.left.focal_px",
        "eyes.right.distortion", "joints.yaw.acceleration_rad_s2",
    } <= set(head.assumptions)  # fmt: skip
    assert head.cameras.size.tolist() == [[640, 480]] * 2
    across = 2.0 * np.arctan(320.0 / head.cameras.focal[:, 0])
    np.testing.assert_allclose(np.rad2deg(across), 60.0)
    np.testing.assert_allclose(head.cameras.principal, [[319.5, 239.5]] * 2)
    path = tmp_path / "head.toml"
    path.write_text(imported.text, encoding="utf-8")
    assert load_head(path) == head
    head = head_of(ROBOT, acceleration=("50", "yaw=20")).head
    assert head.limits.acceleration.tolist() == [20.0, *[50.0] * 6]
    assert not [key for key in head.assumptions if "acceleration" in key]
    # a joint without limits may turn once around
    free = eye("left", lower=None, upper=None)
    free = free.replace('pan" type="revolute', 'pan" type="continuous')
    free = free.replace("<limit ", '<limit lower="-1" upper="1" ', 1)  # of no meaning there
    imported = head_of(urdf(NECK, free, eye("right", upper="1000")))
    assert [one for one in imported.guesses if "right" not in one] == []
    assert "1000 rad in the file, no real limits (degrees?): one turn" in imported.guesses[0]
    head = imported.head
    assert head.limits.lower[3:].tolist() == [-np.pi] * 4
    assert head.limits.upper[3:].tolist() == [np.pi] * 4
    for name in head.joints[3:]:
        assert "one turn" in head.assumptions[f"joints.{name}.upper_rad"]


def test_a_camera_frame_that_is_not_optical_is_refused_with_axes_that_fit(head_of, refused):
    optical = head_of(ROBOT)
    for rpy, triple in [
        ("0 0 0", "-y,-z,x"),  # ROS: x forward, y left, z up
        ("1.5707963267948966 0 -1.5707963267948966", "x,-y,-z"),  # OpenGL: y up, looks along -z
        ("-1.5707963267948966 0 1.5707963267948966", "-x,y,-z"),
        ("0 0 -1.5707963267948966", "x,-z,y"),
        ("0 1.5707963267948966 0", "-y,x,z"),  # the image turned on its side
    ]:
        turned = ROBOT.replace(OPTICAL, rpy)
        refused(turned, f"--camera-axes={triple} would fit")
        imported = head_of(turned, camera_axes=(triple,))
        q = random_angles(imported.head, 10)
        found, expected = (one.head.camera_poses(q) for one in (imported, optical))
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_version_and_vergence_are_given_to_two_pans_and_stay_within_them(head_of):
    mirrored = RIGHT.replace('<axis xyz="0 0 1"/>', '<axis xyz="0 0 -1"/>')
    couplings = ("common-tilt", "version-vergence")
    imported = head_of(urdf(NECK, LEFT, mirrored), couplings=couplings)
    version, vergence, _ = imported.motors
    assert [motor.name for motor in imported.motors] == ["version", "vergence", "tilt"]
    # the left pan turns left, the right one, its axis downwards, right
    assert dict(version.joint_factors) == {"left_pan": -1.0, "right_pan": 1.0}
    assert dict(vergence.joint_factors) == {"left_pan": -0.5, "right_pan": -0.5}
    own = imported.head.actuation
    assert own.count == 3
    converged = own.joints_of(np.array([0, 0, 0, 0, 0.2, 0, 0.0]))
    wanted = [[np.sin(0.1), 0.0, np.cos(0.1)], [-np.sin(0.1), 0.0, np.cos(0.1)]]
    np.testing.assert_allclose(imported.head.camera_poses(converged)[:, :3, 2], wanted, atol=1e-12)
    eyes = eye("left", lower="-0.5", upper="0.9"), eye("right", lower="-0.4", upper="0.5")
    imported = head_of(urdf(NECK, *eyes), couplings=("version-vergence",))
    version, vergence, *_ = imported.motors
    ends = [(motor.limits.lower, motor.limits.upper) for motor in (version, vergence)]
    for v, g in itertools.product(*ends):
        for name, low, high in (("left_pan", -0.5, 0.9), ("right_pan", -0.4, 0.5)):
            angle = version.joint_factors[name] * v + vergence.joint_factors[name] * g
            assert low - 1e-12 <= angle <= high + 1e-12
    assert version.limits.velocity + 0.5 * vergence.limits.velocity <= 5.0
    # what is assumed of motors is marked by their names
    text = urdf(NECK, eye("left", velocity="0"), RIGHT)
    imported = head_of(text, speed=("4",), couplings=("version-vergence",))
    written = tomllib.loads(imported.text)
    for key in imported.head.assumptions:
        table, _, rest = key.partition(".")
        if table in ("joints", "actuators"):
            name, _, field = rest.rpartition(".")
            assert field in next(each for each in written[table] if each["name"] == name)
    for key in ("version.upper_rad", "left_tilt.velocity_rad_s", "vergence.acceleration_rad_s2"):
        assert f"actuators.{key}" in imported.head.assumptions


def mjcf_eye(side: str, place: str) -> str:
    return (
        f'<body name="{side[0]}e" pos="{place}" childclass="eye">'
        f'<joint name="{side[0]}p"/><joint name="{side[0]}t" axis="0 1 0" ref="2"/>'
        f'<camera name="{side}" pos="0.02 0 0" xyaxes="0 -1 0 0 0 1" fovy="50"'
        ' resolution="800 600"/>'
        f'<site name="{side}_site" pos="0.02 0 0" xyaxes="0 -1 0 0 0 -1"/></body>'
    )


PITCH = '<joint name="pitch" axis="0 1 0" pos="0 0 -0.02"/>'
MJCF = f"""
<mujoco model="toy">
  <compiler angle="degree" eulerseq="zyx"/>
  <default>
    <joint range="-30 30"/>
    <default class="eye"><joint axis="0 0 1" pos="0.01 0.002 0" damping="1"/></default>
  </default>
  <asset><mesh name="shell" file="nowhere.stl"/></asset>
  <worldbody>
    <body name="base" pos="0.1 0.2 0.9" euler="5 10 15">
      <body name="head" pos="0 0 0.1" euler="10 -5 0">
        <geom type="mesh" mesh="shell"/>
        <joint name="yaw" axis="0 0 1" ref="4"/>{PITCH}
        <frame pos="0.05 0 0.02" euler="0 0 3">{mjcf_eye("left", "0 0.03 0")}</frame>
        {mjcf_eye("right", "0.05 -0.03 0.02")}
      </body>
    </body>
  </worldbody>
  <equality>EQUALITY</equality>
  <actuator><velocity joint="lp" kv="2" ctrlrange="-3 3" gear="2"/></actuator>
</mujoco>
"""


PLAIN_MJCF = MJCF.replace("EQUALITY", "")
MJCF_OPTIONS = {"cameras": ("left", "right"), "neck": ("yaw", "pitch"), "speed": ("5",)}


def with_tie(equality: str, tendons: str = "") -> str:
    more = f"<tendon>{tendons}</tendon>" if tendons else ""
    return MJCF.replace("EQUALITY", equality).replace("</mujoco>", f"{more}</mujoco>")


def posed(text: str, angles: dict[str, float]) -> mujoco.MjData:
    """What MuJoCo itself makes of the file without its mesh, at joint angles."""
    bare = text.replace('<mesh name="shell" file="nowhere.stl"/>', "").replace(
        '<geom type="mesh" mesh="shell"/>', '<geom size="0.1"/>'
    )
    model = mujoco.MjModel.from_xml_string(bare.replace("<site ", '<geom size="0.01"/><site '))
    data = mujoco.MjData(model)
    for name, angle in angles.items():
        data.joint(name).qpos = angle
    mujoco.mj_forward(model, data)
    return data


def pose_of(part) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.reshape(part.xmat, (3, 3)), part.xpos
    return pose


@pytest.mark.slow
def test_an_mjcf_moves_as_mujoco_moves_it(head_of):
    in_frame = PLAIN_MJCF.replace(
        PITCH, f'<frame pos="0.1 0 0" euler="0 0 20">{PITCH.replace("-0.02", "-1")}</frame>'
    )
    optical = np.diag([1.0, -1.0, -1.0, 1.0])
    for text, cameras, kind, turn in [
        (PLAIN_MJCF, ("left", "right"), "cam", optical),
        (in_frame, ("left", "right"), "cam", optical),
        (PLAIN_MJCF, ("left_site", "right_site"), "site", np.eye(4)),
    ]:
        with named(cameras, text):
            imported = head_of(text, cameras=cameras)
            for q in random_angles(imported.head, 20):
                found = imported.head.base_pose(q) @ imported.head.camera_poses(q)
                data = posed(text, by_name(imported.head, q))
                wanted = [pose_of(getattr(data, kind)(name)) @ turn for name in cameras]
                base = np.linalg.inv(pose_of(data.body("base")))
                np.testing.assert_allclose(found, base @ wanted, atol=1e-9)
            np.testing.assert_allclose(imported.head.limits.upper[:2], np.deg2rad(30.0))


def test_a_camera_of_an_mjcf_brings_its_image_and_a_velocity_servo_its_speed(head_of):
    head = head_of(PLAIN_MJCF).head
    assert head.limits.velocity[3] == 1.5  # 3 rad/s through a gear of 2
    assert head.cameras.size.tolist() == [[800, 600]] * 2
    np.testing.assert_allclose(2 * np.rad2deg(np.arctan(300 / head.cameras.focal[:, 1])), 50.0)
    assert "eyes.left.focal_px" not in head.assumptions
    lens = 'focalpixel="500 510" principalpixel="3 4" sensorsize="0.008 0.006"'
    head = head_of(PLAIN_MJCF.replace('fovy="50"', lens)).head
    np.testing.assert_allclose(head.cameras.focal, [[500.0, 510.0]] * 2)
    np.testing.assert_allclose(head.cameras.principal, [[396.5, 295.5]] * 2)


def test_active_equalities_tie_joints_as_in_mujoco(head_of):
    tie = '<joint joint1="rt" joint2="lt" polycoef="0.01 1 0 0 0" active="true"/>'
    assert head_of(with_tie(tie.replace("true", "false"))).head.actuation.count == 4
    for tendons, equality in [
        ("", tie),
        ('<fixed name="t"><joint joint="lt" coef="2"/><joint joint="rt" coef="-1.5"/></fixed>',
         '<tendon tendon1="t" polycoef="0.02 1 0 0 0"/>'),
        ('<fixed name="a"><joint joint="lp" coef="1"/></fixed>'
         '<fixed name="b"><joint joint="rp" coef="0.8"/></fixed>',
         '<tendon tendon1="b" tendon2="a" polycoef="0.02 -0.5 0 0 0"/>'),
    ]:  # fmt: skip
        with named(tendons, equality):
            text = with_tie(equality, tendons)
            imported = head_of(text)
            assert imported.head.actuation.count == 3
            rest = by_name(imported.head, imported.head.rest()) | dict(imported.chains.fixed_values)
            for motors in np.random.default_rng(1).uniform(0.0, 0.2, (5, 3)):
                angles = rest | {
                    name: factor * value + motor.joint_offsets.get(name, 0.0)
                    for motor, value in zip(imported.motors, motors, strict=True)
                    for name, factor in motor.joint_factors.items()
                }
                data = posed(text, angles)
                tied = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
                assert tied.any()
                np.testing.assert_allclose(data.efc_pos[tied], 0.0, atol=1e-12)
    tendons = '<fixed name="t"><joint joint="lt" coef="1"/><joint joint="rt" coef="1"/></fixed>'
    said = "; ".join(head_of(with_tie('<weld body1="le" body2="re"/>', tendons)).ignored)
    assert "tendon t (ties lt, rt: see --actuators)" in said
    assert "weld of le, which may tie bodies" in said


def test_what_a_file_says_and_nothing_reads_or_no_head_can_have_is_refused(refused):
    place = '<origin xyz="0 0.01 0.05" rpy="0 0 0"/>'
    for becomes, why in [
        ('<origin xyz="" rpy="0 0 0"/>', "joint roll: .* 3 numbers in xyz of <origin>, got ''"),
        ('<origin xzy="0 0 0.3"/>', "got the attribute 'xzy'"),
        ("<origin><xyz>0 0 0.3</xyz></origin>", "<origin> with attributes, got <xyz> in it"),
        ("<pose>0 0 0.3 0 0 0</pose>", "a pose as <origin xyz rpy>, got <pose>"),
        ('<origin xyz="0 0 inf"/>', "3 numbers in xyz of <origin>"),
        ("<origin>0 0 0.3 0 0 0</origin>", "got the text '0 0 0.3 0 0 0'"),
        ('<Origin xyz="0 0 0.3"/>', "no element <Origin>.*is <origin> meant"),
        (f'{place}<mimic joint="pitch" ratio="2"/>', "got the attribute 'ratio'"),
    ]:
        refused(ROBOT.replace(place, becomes, 1), why)
    refused(urdf(NECK, eye("left", velocity=""), RIGHT), "1 numbers in velocity of <limit>")
    text = ROBOT.replace('<joint name="pitch"', '<Joint name="pitch"')
    text = text.replace('/></joint><joint name="left_pan', '/></Joint><joint name="left_pan')
    refused(text, "<Joint>", HeadFileError)
    why = r"^joint right_optical_joint: .* radians within one turn, got '-90 0 -90' \(.*degrees\?"
    refused(urdf(NECK, LEFT, RIGHT.replace(OPTICAL, "-90 0 -90")), why)
    for was, becomes, why in [
        ('name="left" ', 'name="left" mode="targetbody" target="head" ', "left-camera: .* fixed"),
        ('name="right" ', 'name="right" projection="orthographic" ', "right-camera: .* persp"),
        ('name="lp"', 'name="lp" type="ball"', "lp: .* ball joint"),
        ('axis="0 0 1" ref="4"', 'type="slide"', "yaw: .* slides"),
    ]:
        refused(PLAIN_MJCF.replace(was, becomes, 1), why)
    three = "".join(f'<joint joint="{name}" coef="1"/>' for name in ("lp", "rp", "lt"))
    tie, tendon = '<tendon tendon1="t"/>', f'<fixed name="t">{three}</fixed>'
    refused(with_tie(tie, tendon), "joint lt: .* follows lp and rp otherwise")
    gone = with_tie(tie, tendon.replace('"lp"', '"lips"'))
    refused(gone, "tendon t with a joint that is not in", HeadFileError)
    square = '<joint joint1="rt" joint2="lt" polycoef="0 1 0.5 0 0"/>'
    refused(with_tie(square), "rt: .* straight line")


def test_a_file_that_is_no_description_of_different_links_and_joints_is_refused(refused, tmp_path):
    for text, why in [
        ("<robot><link", "no well-formed XML"), ("<sdf version='1.7'/>", "got '<sdf>'"),
        ('<robot xmlns:xacro="http://x/xacro"><xacro:macro name="m"/></robot>', "xacro FILE > h"),
        ('<robot name="a"><link name="l"/><joint name="j" type="fixed"/></robot>', "MuJoCo can"),
    ]:  # fmt: skip
        refused(text, why, HeadFileError)
    path = tmp_path / "robot.urdf"
    for tag, end in (("joint", "pan"), ("link", "a")):
        text = ROBOT.replace(f'{tag} name="right_{end}"', f'{tag} name="left_{end}"')
        said = f"{path}: expected {tag}s with different names, got two called 'left_{end}'"
        assert refused(text, "different", HeadFileError) == said
    for end, link in (("parent", "left_a"), ("child", "left_b")):
        text = ROBOT.replace(f'<{end} link="{link}"/>', f'<{end} link="{link}x"/>')
        expected = rf"expected a {end} that is a link of the file \(near: .*{link}"
        refused(text, rf"joint left_tilt: {expected}.*, got '{link}x'$", HeadFileError)


def test_a_head_has_the_name_of_its_robot_and_leaves_no_file_behind(head_of, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    equal = joint("stuck", "head", "stuck_link", lower="0.2", upper="0.2")  # MuJoCo warns of it
    text = urdf(NECK, LEFT, RIGHT, equal, name="my robot/2 ")
    # the namespace of an expanded xacro stays
    text = text.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ')
    assert head_of(text).head.name == "my_robot_2"
    assert head_of(text, name="desk").head.name == "desk"
    assert [path.name for path in tmp_path.iterdir()] == ["robot.urdf"]


@pytest.mark.parametrize(("name", "base", "cameras", "neck", "lock"), [
    ("icub_visuomanip.urdf", "chest", "{}_eye", ("neck_pitch", "neck_roll", "neck_yaw"), ()),
    ("romeo.urdf", "torso", "Camera{}Eye_optical_frame", ("NeckYaw", "NeckPitch", "HeadPitch"),
     ("HeadRoll=10",)),
])  # fmt: skip
def test_a_real_head_moves_as_its_urdf(name, base, cameras, neck, lock):
    path, sides = real_robot(name), ("Left", "Right") if "Eye" in cameras else "lr"
    cameras = tuple(cameras.format(side) for side in sides)
    imported = import_urdf(
        UrdfSource(file=path, base=base, cameras=cameras, neck=neck, lock=lock, speed=("6",))
    )
    kinematics = UrdfKinematics(path.read_text(encoding="utf-8"))
    assert_moves_as(imported.head, cameras, kinematics, base, dict(imported.chains.fixed_values))


def test_the_preset_of_the_icub_moves_as_its_urdf():
    kinematics = UrdfKinematics(real_robot("icub_visuomanip.urdf").read_text(encoding="utf-8"))
    assert_moves_as(load_head("icub"), ("l_eye", "r_eye"), kinematics, "chest", {})
