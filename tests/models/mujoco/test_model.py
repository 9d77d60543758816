"""The MuJoCo model: the head's own tree, cameras and actuators, and nothing that disturbs them."""

import importlib
import importlib.metadata
import re
import subprocess
import sys
from functools import cache
from unittest.mock import Mock

import mujoco
import numpy as np
import pytest

from tests.heads import TEXTS, actuator, head_of, text_of
from tests.joint_motion import respond
from tests.naming import named, refused
from vergence.errors import MujocoUnavailableError
from vergence.models import load_head, parse_head
from vergence.models.mujoco.model import (
    build_spec,
    compile_model,
    couplings_of,
    find_model_indices,
    load_inertias,
)

BARE = {"visuals": False}
MADE = {
    # no division of rotors keeps a pan of both eyes and a vergence of one apart
    "vergence_of_one": text_of("tied").replace(
        "left_pan = 0.5, right_pan = -0.5", "right_pan = -1"
    ),
    # joints that follow two others
    "three_from_two": text_of("panfirst")
    + actuator("first", "left_pan = 1.0, left_tilt = 0.5, right_tilt = 0.5")
    + actuator("second", "right_pan = 1.0, left_tilt = 0.5, right_tilt = -0.5")
    + "[joint_offsets_rad]\nleft_tilt = 0.1\n",
}
ALL = (*TEXTS, *MADE, "turrets", "physical")


@cache
def any_head(name):
    if name in MADE:
        return parse_head(MADE[name])
    return head_of(name) if name in TEXTS else load_head(name)


@cache
def bare_model(name):
    return compile_model(any_head(name), **BARE)


def postures(head, rng, count=6):
    own = head.actuation
    return own.joints_of(rng.uniform(own.lower, own.upper, (count, 7)))


def placed(model, head, q):
    data = mujoco.MjData(model)
    places = find_model_indices(model, head).joint_of_qpos
    data.qpos[: len(places)] = q[places]
    mujoco.mj_forward(model, data)
    return data


def mujoco_pixel(model, data, name, point):
    """Pixel at which MuJoCo draws a world point, by the frustum of its source code.

    Its image has edges at integers and its principal point counts from the centre, towards the
    left and up; half a pixel less gives OpenCV's pixels.
    """
    camera = model.camera(name).id
    size, sensor = model.cam_resolution[camera], model.cam_sensorsize[camera].astype(float)
    focal, principal = np.split(model.cam_intrinsic[camera] / np.tile(sensor / size, 2), 2)
    rotation, origin = data.camera(name).xmat.reshape(3, 3), data.camera(name).xpos
    x, y, z = rotation.T @ (point - origin)
    edges = size / 2.0 - principal + focal * np.array([x, -y]) / -z
    return edges - 0.5


def follow(model, commands, lag_s, acceleration):
    """Greatest degrees between a model's joints, read half a step back, and the exact response."""
    data = mujoco.MjData(model)
    (q, v), worst = np.zeros((2, model.nv)), 0.0
    for command in commands:
        data.ctrl[:] = command
        mujoco.mj_step(model, data, nstep=4)
        q, v = respond(q, v, command, lag_s, acceleration, 4 * model.opt.timestep)
        reading = data.qpos - 0.5 * model.opt.timestep * data.qvel
        worst = max(worst, np.degrees(np.abs(reading - q).max()))
    return worst


class TestActuators:
    """The joints follow `v' = clip((u - v) / tau, +-a_max)`, whose lag is the preset's."""

    def test_bang_bang_of_all_joints(self, simulated, rng):
        # the neck at its full acceleration is what disturbs the eyes most
        limits, lag_s = simulated.limits, simulated.timing.lag_s
        for _ in range(4):
            # full speed for two seconds, switched at random control periods, away from the limits
            (q, v), sign, commands = np.zeros((2, 7)), rng.choice([-1.0, 1.0], 7), []
            for _ in range(240):
                sign = np.where(rng.random(7) < 0.06, -sign, sign)
                sign = np.where(q > limits.upper - 0.45, -1.0, sign)
                sign = np.where(q < limits.lower + 0.45, 1.0, sign)
                commands.append(sign * limits.velocity)
                q, v = respond(q, v, commands[-1], lag_s, limits.acceleration, 1 / 120)
            assert follow(bare_model("simulated"), commands, lag_s, limits.acceleration) < 0.1

    def test_no_acceleration_limit_leaves_the_lag_alone(self, simulated):
        free = simulated.replace(limits={"acceleration": np.full(7, np.inf)})
        model = compile_model(free, neck="welded", **BARE)
        assert not model.actuator_forcelimited.any()
        commands = np.tile([6.0, -6.0, -6.0, 6.0], (12, 1))
        assert follow(model, commands, free.timing.lag_s, np.inf) < 0.02

    def test_nothing_sags(self, simulated):
        for gravity in (False, True):
            model = compile_model(simulated, gravity=gravity, **BARE)
            start = np.array([0.3, 0.2, -0.4, 0.5, -0.5, -0.5, 0.5])
            data = placed(model, simulated, start)
            mujoco.mj_step(model, data, nstep=960)
            assert np.abs(data.qpos - start).max() < 1e-9

    def test_rotors_dominate_the_inertia(self, head):
        # what lets constant gains serve in every pose, and joints move undisturbed
        model = compile_model(head, **BARE)
        for pose in (head.rest(), 0.9 * head.limits.upper, 0.9 * head.limits.lower):
            inertia = np.zeros((7, 7))
            mujoco.mj_fullM(model, placed(model, head, pose), inertia)
            own = np.diag(inertia)
            assert (model.dof_armature / own).min() > 0.95
            assert (np.abs(inertia - np.diag(own)) / own).max() < 0.005
        # servos of a wide head are stronger
        wide = parse_head(text_of("common").replace("0.05, 0.0, 0.0", "0.5, 0.0, 0.0"))
        stronger, own = (load_inertias(h).joint_armature for h in (wide, head_of("common")))
        assert (stronger >= own).all()


class TestTree:
    @pytest.mark.slow
    def test_cameras_and_n_are_where_the_head_has_them(self, rng):
        for kind in ALL:
            with named(kind):
                head, model = any_head(kind), bare_model(kind)
                for q in postures(head, rng):
                    data, base = placed(model, head, q), head.base_pose(q)
                    np.testing.assert_allclose(data.site("N").xpos, base[:3, 3], atol=1e-12)
                    expected = base @ head.camera_poses(q)
                    point = base[:3] @ [0.05, 0.02, 0.9, 1.0]
                    pixels = head.project(q, [0.05, 0.02, 0.9], distorted=False)
                    for eye, name in enumerate(("left", "right")):
                        camera = data.camera(name)
                        np.testing.assert_allclose(camera.xpos, expected[eye, :3, 3], atol=1e-12)
                        optical = camera.xmat.reshape(3, 3) * [1.0, -1.0, -1.0]
                        np.testing.assert_allclose(optical, expected[eye, :3, :3], atol=1e-12)
                        if expected[eye, :3, 2] @ (point - camera.xpos) > 0.2:
                            # MuJoCo keeps intrinsics in single precision
                            pixel = mujoco_pixel(model, data, name, point)
                            np.testing.assert_allclose(pixel, pixels[eye], atol=2e-3)

    @pytest.mark.slow
    def test_joints_are_the_heads_and_actuators_its_actuators(self):
        for name in ALL:
            with named(name):
                head, model = any_head(name), bare_model(name)
                names = [model.joint(i).name for i in range(model.njnt)]
                kept = [name for name in names if not name.endswith("_rotor")]
                assert kept == [name for name in dict.fromkeys(head.joints) if name]
                places = [head.joints.index(name) for name in kept]
                ends = np.transpose([head.limits.lower, head.limits.upper])[places]
                np.testing.assert_array_equal(model.jnt_range[: len(kept)], ends)
                expected = [name for name in head.joints[:3] if name] + list(head.actuation.names)
                assert [model.actuator(i).name for i in range(model.nu)] == expected
                *_, rotors, slots = find_model_indices(model, head)
                ends = [head.actuation.lower[rotors], head.actuation.upper[rotors]]
                np.testing.assert_array_equal(model.jnt_range[len(kept) :].T, ends)
                fastest = head.actuation.velocity[slots]
                np.testing.assert_array_equal(model.actuator_ctrlrange[:, 1], fastest)
                # equality constraints are computed only where joints follow others
                off = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EQUALITY)
                assert bool(off) == (model.neq == 0)

    def test_a_welded_neck_leaves_the_eyes_and_four_steps_are_a_control_period(self, head):
        model = compile_model(head, neck="welded")
        indices = find_model_indices(model, head)
        np.testing.assert_array_equal(indices.qpos_of_joint, [-1, -1, -1, 0, 1, 2, 3])
        np.testing.assert_array_equal(indices.joint_of_qpos, [3, 4, 5, 6])
        assert 4 * model.opt.timestep == pytest.approx(head.timing.period_s)
        assert compile_model(head, timestep_s=0.001).opt.timestep == 0.001

    def test_an_actuator_may_have_the_name_of_a_neck_joint_and_each_eye_its_size(self):
        head = parse_head(text_of("tied").replace('name = "tilt"', 'name = "neck_yaw"'))
        model = compile_model(head.replace(cameras={"size": [[320, 240], [640, 400]]}))
        assert model.actuator("eyes_neck_yaw").id == 3
        np.testing.assert_array_equal(model.cam_resolution, [[320, 240], [640, 400]])
        assert (model.vis.global_.offwidth, model.vis.global_.offheight) == (640, 400)


def test_joints_that_follow_others_do_so_under_full_commands(rng):
    for name in ("mis", "vergence_of_one", "three_from_two"):
        with named(name):
            head = any_head(name)
            own, model = head.actuation, bare_model(name)
            qpos_of_joint, joints, rotors, slots = find_model_indices(model, head)
            middle, worst = 0.5 * (own.lower + own.upper), 0.0
            data = placed(model, head, own.joints_of(middle))
            data.qpos[len(joints) :] = middle[rotors]
            for step in range(400):
                if step % 20 == 0:
                    data.ctrl[:] = rng.choice([-1.0, 1.0], model.nu) * own.velocity[slots]
                mujoco.mj_step(model, data)
                q = np.where(qpos_of_joint >= 0, data.qpos[qpos_of_joint], 0.0)
                worst = max(worst, np.abs(own.joints_of(own.actuators_of(q)) - q).max())
            assert np.abs(data.qpos).max() > 0.1
            # within what an encoder of 0.01 degrees tells
            assert worst < 1e-4
    assert couplings_of(head)  # to two others, from an offset
    for q in postures(head, rng):
        angles = dict(zip(head.joints, q, strict=True))
        for joint, others, offset in couplings_of(head):
            follows = offset + sum(factor * angles[name] for name, factor in others)
            assert angles[joint] == pytest.approx(follows, abs=1e-12)


class TestAppearance:
    def test_heads_stand_above_the_floor_whatever_their_base_frame(self, simulated):
        wider = [text_of("pair").replace("0.05, 0.0", f"{0.05 * s}, 0.0") for s in (0.6, 1.0, 10.0)]
        for head in (simulated, *map(parse_head, wider)):
            with named(head):
                model = compile_model(head)
                data = placed(model, head, head.rest())
                floor, up = data.geom("floor"), -head.base_pose(head.rest())[:3, 1]
                np.testing.assert_allclose(floor.xmat.reshape(3, 3)[:, 2], up, atol=1e-12)
                assert ((data.cam_xpos - floor.xpos) @ up > 0.2).all()
                np.testing.assert_allclose(model.opt.gravity, -9.81 * up, atol=1e-12)

    @pytest.mark.slow
    def test_shapes_weigh_and_touch_nothing_and_eyeballs_are_about_the_cameras(self):
        for name in ALL:
            with named(name):
                head, plain = any_head(name), bare_model(name)
                model = compile_model(head)
                data = placed(model, head, head.rest())
                np.testing.assert_array_equal(model.body_mass, plain.body_mass)
                np.testing.assert_array_equal(model.body_inertia, plain.body_inertia)
                assert not (model.geom_contype | model.geom_conaffinity).any()
                balls = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE)
                assert len(balls) == 2
                np.testing.assert_allclose(data.geom_xpos[balls], data.cam_xpos, atol=0.004)
                apart = np.linalg.norm(np.diff(data.geom_xpos[balls], axis=0))
                assert model.geom_size[balls, 0].sum() < apart


def test_what_no_model_can_be_made_of_is_refused(simulated, physical, errors, rng):
    for head, options, said in [
        (physical.perturbed(rng, errors, 3), {}, r"one head.*\(3,\)"),
        (simulated.replace(timing={"lag_s": 0.0}), {}, r"lag_s > 0, got 0\.0.*kinematic"),
        (simulated, {"neck": "rubber"}, "'servo' or 'welded', got 'rubber'"),
        (simulated, {"timestep_s": 0.0}, "timestep_s"),
        (simulated, {"timestep_s": np.nan}, "timestep_s"),
    ]:
        refused(said, build_spec, head, **options)
    other = "<mujoco><worldbody><body><joint name='elbow'/><geom size='1'/></body></worldbody>"
    model = mujoco.MjModel.from_xml_string(f"{other}</mujoco>")
    refused(r"neck_yaw.*elbow", find_model_indices, model, simulated)


WITHOUT = """
import sys
sys.modules["mujoco"] = None
import gymnasium, numpy as np, vergence
from vergence.cli import main
env = gymnasium.make("vergence/Gaze-v0", plant="kinematic")
env.reset(seed=1)
env.step(np.zeros_like(env.action_space.sample()))
head = vergence.load_head("simulated")
point = [0.1, 0.0, 1.0]
assert np.allclose(vergence.triangulate_gaze(head, head.fixate(point)).point, point)
sys.exit(main(["export", "mjcf", "--head", "icub", "--out", sys.argv[1]]))
"""


def test_a_mujoco_that_cannot_be_imported_is_told_with_its_cure(monkeypatch):
    for installed, cure in [
        ("3.3.0", "got 3.3.0; cure: pip install 'mujoco>=4,<5'"),
        ("4.0.0", "cure: pip install --force-reinstall --no-deps mujoco==4.0.0 mujoco-core==4.0.0"),
        (None, "got none; cure: pip install"),
    ]:
        with named(installed, cure):
            version = Mock(return_value=installed)
            if installed is None:
                version.side_effect = importlib.metadata.PackageNotFoundError("mujoco")
            monkeypatch.setitem(sys.modules, "mujoco", None)
            monkeypatch.delitem(sys.modules, "vergence.models.mujoco", raising=False)
            monkeypatch.setattr(importlib.metadata, "version", version)
            with pytest.raises(MujocoUnavailableError, match=re.escape(cure)):
                importlib.import_module("vergence.models.mujoco")


@pytest.mark.nightly
def test_what_needs_no_mujoco_works_without_it(tmp_path):
    words = [sys.executable, "-c", WITHOUT, str(tmp_path / "out")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.splitlines() == [
        "vergence: error: mujoco: expected MuJoCo 4, got 4.0.0 with files that are missing or "
        "damaged; cure: pip install --force-reinstall --no-deps mujoco==4.0.0 mujoco-core==4.0.0 "
        "mujoco-studio==4.0.0"
    ]
