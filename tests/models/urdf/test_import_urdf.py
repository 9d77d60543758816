"""A head out of a URDF or MJCF moves as the file says, and what cannot be one says why."""

import itertools
import pickle
import re
import tomllib
from types import MappingProxyType

import mujoco
import numpy as np
import pytest

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
from vergence.models.head_file import load_head
from vergence.models.urdf.import_urdf import ImportedHead, UrdfSource, import_urdf

TURNS = ("yaw", "roll", "pitch")
CAMERAS = ("left_optical", "right_optical")
LEFT, RIGHT = eye("left"), eye("right")
ROBOT = urdf(NECK, LEFT, RIGHT)
FIXED_EYES = "".join(
    joint(f"{side}_mount", "head", f"{side}_optical", kind="fixed", xyz=xyz, rpy=OPTICAL)
    for side, xyz in (("left", "0.1 0.05 0"), ("right", "0.1 -0.05 0"))
)


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
    """The one line that a description is refused with, which a pattern fits."""

    def run(text: str, why: str, error=ConfigurationError, **options) -> str:
        with named(why, options), pytest.raises(error, match=why) as raised:
            head_of(text, **options)
        assert "\n" not in str(raised.value)
        assert str(pickle.loads(pickle.dumps(raised.value))) == str(raised.value)
        return str(raised.value)

    return run


def random_angles(imported: ImportedHead, count: int, seed: int = 0) -> np.ndarray:
    """(count, 7) joint angles within limits, tied joints tied."""
    rng, head = np.random.default_rng(seed), imported.head
    q = rng.uniform(head.limits.lower, head.limits.upper, (count, 7))
    for i, j in itertools.combinations(range(7), 2):
        if head.joints[i] and head.joints[i] == head.joints[j]:
            q[:, j] = q[:, i]
    return q


def by_name(imported: ImportedHead, q: np.ndarray) -> dict[str, float]:
    return {name: float(angle) for name, angle in zip(imported.head.joints, q, strict=True) if name}


def assert_moves_as(imported, cameras, kinematics, base, held=MappingProxyType({}), count=100):
    """`base_pose` and `camera_poses` are those of other kinematics, N fixed to the last link."""
    q = random_angles(imported, count)
    T_0_N = imported.head.base_pose(q)
    found = T_0_N[:, None] @ imported.head.camera_poses(q)
    wanted = np.array(
        [
            [kinematics.pose(name, base, by_name(imported, row) | held) for name in cameras]
            for row in q
        ]
    )  # fmt: skip
    assert np.abs(found - wanted).max() < 1e-9


def test_a_pan_first_turret_pair_moves_as_its_urdf(head_of):
    imported = head_of(ROBOT, neck=("pitch", "yaw", "roll"))  # in any order
    eyes = ("left_pan", "left_tilt", "right_pan", "right_tilt")
    assert imported.head.joints == (*TURNS, *eyes)
    assert_moves_as(imported, CAMERAS, UrdfKinematics(ROBOT), "base")


def test_n_is_fixed_to_what_the_last_neck_joint_carries_midway_between_the_cameras(head_of):
    imported = head_of(ROBOT)
    kinematics = UrdfKinematics(ROBOT)
    T_head_N = np.eye(4)
    # x right, y down, z forward in a link with x forward, y left, z up
    T_head_N[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    T_head_N[:3, 3] = np.mean([kinematics.pose(c, "head", {})[:3, 3] for c in CAMERAS], axis=0)
    for q in random_angles(imported, 20):
        T_base_N = kinematics.pose("head", "base", by_name(imported, q)) @ T_head_N
        np.testing.assert_allclose(imported.head.base_pose(q), T_base_N, atol=1e-12)


def test_joints_that_both_eyes_stand_on_after_the_neck_are_theirs(head_of):
    pans = [
        joint(f"{side}_pan", "tilted", f"{side}_eye", xyz=f"0 {y} 0", axis=axis)
        + joint(f"{side}_fixed", f"{side}_eye", f"{side}_optical", kind="fixed", rpy=OPTICAL)
        for side, y, axis in (("left", 0.034, "0 0 -1"), ("right", -0.034, "0 0 1"))
    ]
    text = urdf(NECK, joint("eyes_tilt", "head", "tilted", xyz="0.04 0 0.1", axis="0 1 0"), *pans)
    imported = head_of(text)
    assert imported.head.joints[3:] == ("eyes_tilt", "left_pan", "eyes_tilt", "right_pan")
    assert imported.head.actuation.count == 3
    assert_moves_as(imported, CAMERAS, UrdfKinematics(text), "base")


def test_held_joints_are_folded_into_what_moves(head_of):
    lift = joint("lift", "foot", "base", kind="prismatic", xyz="0 0 0.2", lower="0", upper="0.4")
    text = urdf(lift, NECK, LEFT, RIGHT)
    neck = ("yaw", "pitch")
    imported = head_of(text, base="foot", neck=neck, lock=("lift=0.25m", "roll=-20"))
    assert imported.head.joints[:3] == (*neck, "")
    held = {"lift": 0.25, "roll": np.deg2rad(-20.0)}
    assert_moves_as(imported, CAMERAS, UrdfKinematics(text), "foot", held)


def test_eyes_that_do_not_move_on_a_neck_make_a_head(head_of):
    text = urdf(NECK, FIXED_EYES)
    imported = head_of(text)
    assert imported.head.actuation.count == 0
    assert_moves_as(imported, CAMERAS, UrdfKinematics(text), "base")


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
    kinematics = UrdfKinematics(text)
    head = imported.head
    low, high = head.actuation.lower, head.actuation.upper
    for slots in np.random.default_rng(1).uniform(low, high, (50, 7)):
        q = head.actuation.joints_of(slots)
        angles = by_name(imported, q)
        angles.pop("right_tilt")  # the other kinematics follow the mimic themselves
        found = head.base_pose(q) @ head.camera_poses(q)
        wanted = [kinematics.pose(name, "base", angles) for name in CAMERAS]
        np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_a_mimic_that_a_head_cannot_have_says_why(refused):
    text = urdf(NECK, LEFT, RIGHT, joint("jaw", "head", "chin"))
    for name, mimic, why in [
        ("roll", 'joint="yaw"', "roll: .* neck .* follows yaw"),
        ("left_pan", 'joint="pitch"', "left_pan: .* follows pitch"),
        ("left_pan", 'joint="jaw"', "left_pan: .* follows jaw, .* not on the way"),
        ("left_pan", 'joint="rightpan"', r"left_pan: .*\(near: right_pan.*'rightpan', which is no"),
        ("left_pan", 'joint="left_pan"', "left_pan: .* circle"),
        ("roll", 'joint="pitch" multiplier="0"', "neck: .* 'roll', which is held"),
    ]:
        end = text.index("</joint>", text.index(f'<joint name="{name}"'))
        refused(f"{text[:end]}<mimic {mimic}/>{text[end:]}", why)


def test_what_follows_a_held_joint_is_held_too(head_of):
    roll = joint("roll", "n1", "n2", xyz="0 0.01 0.05", axis="1 0 0")
    tied = roll.replace("</joint>", '<mimic joint="yaw" multiplier="0.5" offset="0.1"/></joint>')
    text = urdf(NECK.replace(roll, tied), LEFT, RIGHT)
    imported = head_of(text, neck=("pitch",), lock=("yaw=20",))
    held = {"yaw": np.deg2rad(20.0)}
    assert imported.chains.fixed_values == pytest.approx(held | {"roll": 0.5 * held["yaw"] + 0.1})
    assert_moves_as(imported, CAMERAS, UrdfKinematics(text), "base", held)


TOP = joint("nod", "top", "base", lower="0.1", upper="0.3")
FIRST = joint("turn", "foot", "top")


def test_a_refused_neck_comes_with_options_that_work(head_of, refused):
    for first, options in [
        ((TOP, FIRST), {"base": "foot", "neck": ()}), ((TOP,), {"base": "top"}),
        ((TOP,), {"base": "top", "neck": ("nod", *TURNS)}), ((TOP, FIRST), {"base": "foot"}),
        ((TOP,), {"base": "top", "neck": ("nod", "roll", "pitch")}),
    ]:  # fmt: skip
        text = urdf(*first, NECK, LEFT, RIGHT)
        words = refused(text, "neck: ", **options)
        neck = re.search(r"--neck ((?:\w+ ?)+)", words.rpartition(": ")[2])
        lock = re.search(r"--lock ((?:\w+=[-\d.]+ ?)+)", words)
        if neck:
            options = options | {"neck": tuple(neck[1].split())}
        head = head_of(text, **options, lock=tuple(lock[1].split()) if lock else ()).head
        assert head.joints[-1] == "right_tilt"


def test_a_third_joint_of_an_eye_is_refused_with_the_lock_that_works(head_of, refused):
    third = joint("left_cyclo", "left_b", "left_c", axis="1 0 0")
    last = joint("left_last", "left_c", "left_third", kind="fixed", rpy=OPTICAL)
    text = urdf(NECK, LEFT, RIGHT, third, last)
    options = {"cameras": ("left_third", "right_optical")}
    refused(text, r"got 3 \(.*, left_cyclo\).*--lock left_cyclo=0", **options)
    assert head_of(text, **options, lock=("left_cyclo=0",)).head.joints[3] == "left_pan"


def test_what_cannot_be_a_head_says_why_in_one_line(refused):
    def with_more(*more: str) -> str:
        return urdf(NECK, LEFT, RIGHT, *more)

    far = with_more(joint("far", "foot", "base", kind="fixed", xyz="0 0 4"))
    depth = with_more(joint("depth_mount", "left_camera", "left_depth", kind="fixed"))
    waist = with_more(joint("w", "foot", "base"))
    jaw = with_more(joint("jaw", "head", "chin"))
    short = ("yaw", "pitch")
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
        (ROBOT, {"neck": short, "lock": ("roll=50",)}, "roll within -34.3775 to 34.3775 deg, got"),
        (ROBOT, {"neck": short, "lock": ("roll=ten",)}, "lock: .* roll=10, in degrees, got 'roll="),
        (ROBOT, {"lock": ("roll=0",)}, "lock: expected joints that are not of the neck"),
        (ROBOT, {"cameras": ("left_opt", "x")}, r"left-camera: .* file \(near: left_optical"),
        (ROBOT, {"cameras": ("left_optical",) * 2}, "vergence needs two cameras"),
        (ROBOT, {"cameras": CAMERAS[::-1]}, "exchanged"),
        (depth, {"cameras": ("left_optical", "left_depth")}, "a colour and a depth frame of one"),
        (urdf(NECK, FIXED_EYES), {"couplings": ("version-vergence",)},
         "version-vergence a joint that pans .* got none"),
    ]:  # fmt: skip
        refused(text, why, **options)


def test_options_that_say_nothing_are_refused(refused):
    for word in [("fast",), ("-2",), ("0",), ("500",), ("jaw=2",), ("2", "3")]:
        refused(ROBOT, r"^speed: expected", speed=word)
    for axes in ["x,y", "x,x,z", "a,b,c", "x,y,-z", "right,down,forward", ""]:
        refused(ROBOT, r"^camera-axes: expected", camera_axes=(axes,))


def test_a_speed_that_no_motor_has_is_refused_unless_overridden(head_of, refused):
    for speed in ["50000", "0", None, "293.2"]:
        text = urdf(NECK, eye("left", velocity=speed), RIGHT)
        refused(text, r"left_pan \(.*left_tilt \(.*--speed")
        head = head_of(text, speed=("4", "left_tilt=3", "yaw=2")).head
        assert head.limits.velocity.tolist() == [2.0, 5.0, 5.0, 4.0, 3.0, 5.0, 5.0]
        assert "--speed" in head.assumptions["joints.left_pan.velocity_rad_s"]
        assert "joints.right_pan.velocity_rad_s" not in head.assumptions


def test_a_joint_without_limits_may_turn_once_around_and_says_so(head_of):
    free = eye("left", lower=None, upper=None)
    free = free.replace('pan" type="revolute', 'pan" type="continuous')
    head = head_of(urdf(NECK, free, eye("right", upper="1000"))).head
    assert head.limits.lower[3:].tolist() == [-np.pi] * 4
    assert head.limits.upper[3:].tolist() == [np.pi] * 4
    for name in head.joints[3:]:
        assert "one turn" in head.assumptions[f"joints.{name}.upper_rad"]


def test_what_the_file_lacks_is_marked_as_assumed(head_of):
    head = head_of(ROBOT).head
    for key in (
        "timing.lag_s", "timing.latency_s", "image.width_px", "eyes.left.focal_px",
        "eyes.right.distortion", "joints.yaw.acceleration_rad_s2",
    ):  # fmt: skip
        assert key in head.assumptions
    assert head.cameras.size.tolist() == [[640, 480]] * 2
    across = 2.0 * np.arctan(320.0 / head.cameras.focal[:, 0])
    np.testing.assert_allclose(np.rad2deg(across), 60.0)
    np.testing.assert_allclose(head.cameras.principal, [[319.5, 239.5]] * 2)
    head = head_of(ROBOT, acceleration=("50", "yaw=20")).head
    assert head.limits.acceleration.tolist() == [20.0, *[50.0] * 6]
    assert not [key for key in head.assumptions if "acceleration" in key]


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
        q = random_angles(imported, 10)
        found, expected = (one.head.camera_poses(q) for one in (imported, optical))
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_version_and_vergence_are_given_to_two_pans(head_of):
    mirrored = RIGHT.replace('<axis xyz="0 0 1"/>', '<axis xyz="0 0 -1"/>')
    couplings = ("common-tilt", "version-vergence")
    imported = head_of(urdf(NECK, LEFT, mirrored), couplings=couplings)
    assert [motor.name for motor in imported.motors] == ["version", "vergence", "tilt"]
    version, vergence, _ = imported.motors
    # the left pan turns left, the right one, its axis downwards, right
    assert dict(version.joint_factors) == {"left_pan": -1.0, "right_pan": 1.0}
    assert dict(vergence.joint_factors) == {"left_pan": -0.5, "right_pan": -0.5}
    head = imported.head
    assert head.actuation.count == 3
    converged = head.actuation.joints_of(np.array([0, 0, 0, 0, 0.2, 0, 0.0]))
    left, right = head.camera_poses(converged)
    np.testing.assert_allclose(left[:3, 2], [np.sin(0.1), 0.0, np.cos(0.1)], atol=1e-12)
    np.testing.assert_allclose(right[:3, 2], [-np.sin(0.1), 0.0, np.cos(0.1)], atol=1e-12)


def test_version_and_vergence_stay_within_the_pans(head_of):
    eyes = eye("left", lower="-0.5", upper="0.9"), eye("right", lower="-0.4", upper="0.5")
    imported = head_of(urdf(NECK, *eyes), couplings=("version-vergence",))
    version, vergence, *_ = imported.motors
    ends = [(motor.limits.lower, motor.limits.upper) for motor in (version, vergence)]
    for v, g in itertools.product(*ends):
        for name, low, high in (("left_pan", -0.5, 0.9), ("right_pan", -0.4, 0.5)):
            angle = version.joint_factors[name] * v + vergence.joint_factors[name] * g
            assert low - 1e-12 <= angle <= high + 1e-12
    assert version.limits.velocity + 0.5 * vergence.limits.velocity <= 5.0


def test_what_is_assumed_of_motors_is_marked_by_their_names(head_of):
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


MJCF = """
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
        <joint name="yaw" axis="0 0 1" ref="4"/>
        <joint name="pitch" axis="0 1 0" pos="0 0 -0.02"/>
        <frame pos="0.05 0 0.02" euler="0 0 3">
          <body name="le" pos="0 0.03 0" childclass="eye">
            <joint name="lp"/><joint name="lt" axis="0 1 0" ref="2"/>
            <camera name="left" pos="0.02 0 0" xyaxes="0 -1 0 0 0 1" fovy="50"
                    resolution="800 600"/>
            <site name="left_site" pos="0.02 0 0" xyaxes="0 -1 0 0 0 -1"/>
          </body>
        </frame>
        <body name="re" pos="0.05 -0.03 0.02" childclass="eye">
          <joint name="rp"/><joint name="rt" axis="0 1 0" ref="2"/>
          <camera name="right" pos="0.02 0 0" xyaxes="0 -1 0 0 0 1" fovy="50" resolution="800 600"/>
          <site name="right_site" pos="0.02 0 0" xyaxes="0 -1 0 0 0 -1"/>
        </body>
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


def compiled(text: str) -> mujoco.MjModel:
    """Model by MuJoCo itself, of the file without its mesh."""
    bare = text.replace('<mesh name="shell" file="nowhere.stl"/>', "").replace(
        '<geom type="mesh" mesh="shell"/>', '<geom size="0.1"/>'
    )
    return mujoco.MjModel.from_xml_string(bare.replace("<site ", '<geom size="0.01"/><site '))


def compiled_pose(text: str, kind: str, name: str, angles: dict[str, float]) -> np.ndarray:
    model = compiled(text)
    data = mujoco.MjData(model)
    for joint_name, angle in angles.items():
        data.joint(joint_name).qpos = angle
    mujoco.mj_forward(model, data)

    def world(part) -> np.ndarray:
        pose = np.eye(4)
        pose[:3, :3] = np.reshape(part.xmat, (3, 3))
        pose[:3, 3] = part.xpos
        return pose

    return np.linalg.inv(world(data.body("base"))) @ world(getattr(data, kind)(name))


@pytest.mark.slow
def test_an_mjcf_moves_as_mujoco_moves_it(head_of):
    in_frame = PLAIN_MJCF.replace(
        '<joint name="pitch" axis="0 1 0" pos="0 0 -0.02"/>',
        '<frame pos="0.1 0 0" euler="0 0 20">'
        '<joint name="pitch" axis="0 1 0" pos="0 0 -1"/></frame>',
    )
    optical = np.diag([1.0, -1.0, -1.0, 1.0])
    for text, cameras, kind, turn in [
        (PLAIN_MJCF, ("left", "right"), "cam", optical),
        (in_frame, ("left", "right"), "cam", optical),
        (PLAIN_MJCF, ("left_site", "right_site"), "site", np.eye(4)),
    ]:
        with named(cameras, text):
            imported = head_of(text, cameras=cameras)
            for q in random_angles(imported, 20):
                angles = by_name(imported, q)
                found = imported.head.base_pose(q) @ imported.head.camera_poses(q)
                wanted = [compiled_pose(text, kind, name, angles) @ turn for name in cameras]
                np.testing.assert_allclose(found, wanted, atol=1e-9)
            np.testing.assert_allclose(imported.head.limits.upper[:2], np.deg2rad(30.0))


def test_a_camera_of_an_mjcf_brings_its_image(head_of):
    head = head_of(PLAIN_MJCF).head
    assert head.cameras.size.tolist() == [[800, 600]] * 2
    np.testing.assert_allclose(2 * np.rad2deg(np.arctan(300 / head.cameras.focal[:, 1])), 50.0)
    assert "eyes.left.focal_px" not in head.assumptions
    lens = 'focalpixel="500 510" principalpixel="3 4" sensorsize="0.008 0.006"'
    given = PLAIN_MJCF.replace('fovy="50"', lens)
    head = head_of(given).head
    np.testing.assert_allclose(head.cameras.focal, [[500.0, 510.0]] * 2)
    np.testing.assert_allclose(head.cameras.principal, [[396.5, 295.5]] * 2)


def test_a_velocity_servo_of_an_mjcf_says_how_fast_its_joint_is(head_of):
    head = head_of(PLAIN_MJCF).head
    assert head.limits.velocity[3] == 1.5  # 3 rad/s through a gear of 2


def test_an_equality_of_an_mjcf_ties_joints_while_it_is_active(head_of):
    tie = '<joint joint1="rt" joint2="lt" polycoef="0.01 1 0 0 0" active="ACTIVE"/>'
    tied = head_of(with_tie(tie.replace("ACTIVE", "true")))
    assert tied.head.actuation.count == 3
    # MuJoCo counts both from their references, which are alike here
    assert tied.motors[1].joint_offsets == pytest.approx({"rt": 0.01})
    assert head_of(with_tie(tie.replace("ACTIVE", "false"))).head.actuation.count == 4


def test_an_equality_of_tendons_ties_joints_as_in_mujoco(head_of):
    for tendons, equality in [
        (
            '<fixed name="t"><joint joint="lt" coef="2"/><joint joint="rt" coef="-1.5"/></fixed>',
            '<tendon tendon1="t" polycoef="0.02 1 0 0 0"/>',
        ),
        (
            '<fixed name="a"><joint joint="lp" coef="1"/></fixed>'
            '<fixed name="b"><joint joint="rp" coef="0.8"/></fixed>',
            '<tendon tendon1="b" tendon2="a" polycoef="0.02 -0.5 0 0 0"/>',
        ),
    ]:
        with named(tendons, equality):
            text = with_tie(equality, tendons)
            imported = head_of(text)
            assert imported.head.actuation.count == 3
            model = compiled(text)
            data = mujoco.MjData(model)
            for motors in np.random.default_rng(1).uniform(0.0, 0.2, (5, 3)):
                angles = by_name(imported, imported.head.rest()) | dict(
                    imported.chains.fixed_values
                )
                for motor, value in zip(imported.motors, motors, strict=True):
                    for name, factor in motor.joint_factors.items():
                        angles[name] = factor * value + motor.joint_offsets.get(name, 0.0)
                for name, value in angles.items():
                    data.joint(name).qpos = value
                mujoco.mj_forward(model, data)
                tied = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
                np.testing.assert_allclose(data.efc_pos[tied], 0.0, atol=1e-12)


def test_what_ties_joints_and_no_head_has_is_said_to_be_left_out(head_of):
    tendons = '<fixed name="t"><joint joint="lt" coef="1"/><joint joint="rt" coef="1"/></fixed>'
    said = "; ".join(head_of(with_tie('<weld body1="le" body2="re"/>', tendons)).ignored)
    assert "tendon t (ties lt, rt: see --actuators)" in said
    assert "weld of le, which may tie bodies" in said


def test_what_a_urdf_says_and_nothing_reads_is_refused(refused):
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


def test_what_stands_off_the_way_to_the_cameras_may_say_anything(head_of):
    others = [
        joint("jaw", "head", "chin", lower="", velocity="").replace("<origin xyz", "<origin xzy"),
        joint("tail", "n1", "tip", rpy="0 0 180"),
        joint("stand", "floor", "base", kind="floating", rpy="0 0 360"),
        joint("tray", "n1", "plate", kind="planar"),
        joint("stuck", "head", "stuck_link", lower="0.2", upper="0.2"),
    ]
    text = urdf(NECK.replace('rpy="0.1 -0.2 0.3"', 'rpy="0.1 -0.2 -6.2832"'), LEFT, RIGHT, *others)
    assert_moves_as(head_of(text), CAMERAS, UrdfKinematics(text), "base")


def test_what_an_mjcf_has_that_no_head_can_have_says_why(refused):
    for was, becomes, why in [
        ('name="left" ', 'name="left" mode="targetbody" target="head" ', "left-camera: .* fixed"),
        ('name="right" ', 'name="right" projection="orthographic" ', "right-camera: .* persp"),
        ('name="lp"', 'name="lp" type="ball"', "lp: .* ball joint"),
        ('axis="0 0 1" ref="4"', 'type="slide"', "yaw: .* slides"),
    ]:
        refused(PLAIN_MJCF.replace(was, becomes, 1), why)
    three = "".join(f'<joint joint="{name}" coef="1"/>' for name in ("lp", "rp", "lt"))
    tendon = f'<fixed name="t">{three}</fixed>'
    tie = '<tendon tendon1="t"/>'
    refused(with_tie(tie, tendon), "joint lt: .* follows lp and rp otherwise")
    gone = tendon.replace('"lp"', '"lips"')
    refused(with_tie(tie, gone), "tendon t with a joint that is not in", HeadFileError)
    square = '<joint joint1="rt" joint2="lt" polycoef="0 1 0.5 0 0"/>'
    refused(with_tie(square), "rt: .* straight line")


def test_a_file_that_is_no_description_is_refused(refused):
    for text, why in [
        ("<robot><link", "no well-formed XML"), ("<sdf version='1.7'/>", "got '<sdf>'"),
        ('<robot xmlns:xacro="http://x/xacro"><xacro:macro name="m"/></robot>', "xacro FILE > h"),
        ('<robot name="a"><link name="l"/><joint name="j" type="fixed"/></robot>', "MuJoCo can"),
    ]:  # fmt: skip
        refused(text, why, HeadFileError)


def test_names_that_fit_no_other_or_several_are_refused(refused, tmp_path):
    path = tmp_path / "robot.urdf"
    for tag, end in (("joint", "pan"), ("link", "a")):
        text = ROBOT.replace(f'{tag} name="right_{end}"', f'{tag} name="left_{end}"')
        said = f"{path}: expected {tag}s with different names, got two called 'left_{end}'"
        assert refused(text, "different", HeadFileError) == said
    for end, link in (("parent", "left_a"), ("child", "left_b")):
        text = ROBOT.replace(f'<{end} link="{link}"/>', f'<{end} link="{link}x"/>')
        expected = rf"expected a {end} that is a link of the file \(near: .*{link}"
        refused(text, rf"joint left_tilt: {expected}.*, got '{link}x'$", HeadFileError)


def test_an_expanded_xacro_is_read_though_its_namespace_stays(head_of):
    text = ROBOT.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ')
    assert head_of(text).head.joints[:3] == TURNS


def test_nothing_is_left_in_the_working_directory(head_of, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    equal = joint("stuck", "head", "stuck_link", lower="0.2", upper="0.2")  # MuJoCo warns of it
    head_of(urdf(NECK, LEFT, RIGHT, equal))
    assert [path.name for path in tmp_path.iterdir()] == ["robot.urdf"]


def test_the_name_is_that_of_the_robot_as_a_file_may_have_it(head_of, refused):
    text = urdf(NECK, LEFT, RIGHT, name="my robot/2 ")
    assert head_of(text).head.name == "my_robot_2"
    assert head_of(text, name="desk").head.name == "desk"
    refused(text, r"^name: ", VergenceError, name="con")


REAL = {
    "icub_visuomanip.urdf": {
        "base": "chest", "cameras": ("l_eye", "r_eye"),
        "neck": ("neck_pitch", "neck_roll", "neck_yaw"),
    },
    "romeo.urdf": {
        "base": "torso", "cameras": ("CameraLeftEye_optical_frame", "CameraRightEye_optical_frame"),
        "neck": ("NeckYaw", "NeckPitch", "HeadPitch"), "lock": ("HeadRoll=10",),
    },
}  # fmt: skip


@pytest.mark.parametrize("name", REAL)
def test_a_real_head_moves_as_its_urdf(name):
    path = real_robot(name)
    imported = import_urdf(UrdfSource(file=path, speed=("6",), **REAL[name]))
    held = dict(imported.chains.fixed_values)
    kinematics = UrdfKinematics(path.read_text(encoding="utf-8"))
    assert_moves_as(imported, REAL[name]["cameras"], kinematics, REAL[name]["base"], held)


def test_the_text_is_that_of_a_head_file(head_of, tmp_path):
    imported = head_of(ROBOT)
    path = tmp_path / "head.toml"
    path.write_text(imported.text, encoding="utf-8")
    assert load_head(path) == imported.head
