"""The MuJoCo model: the head's own tree, cameras and actuators, and nothing that disturbs them."""

import mujoco
import numpy as np
import pytest

from tests.naming import named
from vergence.errors import ConfigurationError, VergenceError
from vergence.models import EYES, JOINTS
from vergence.models.mujoco.look import OBSERVER_CAMERAS
from vergence.models.mujoco.model import build_spec, compile_model, find_model_indices
from vergence.vision.targets import AprilTag, Checkerboard

BARE = {"visuals": False}
PERIODS = 240
"""Two seconds at 120 Hz."""


def follow(model, commands, start, lag_s, acceleration, exact_actuator):
    """Degrees between a model's joints, read half a step back, and the exact actuator."""
    data = mujoco.MjData(model)
    data.qpos[:] = start
    q, v, worst = np.array(start), np.zeros(model.nv), np.zeros(model.nv)
    for command in commands:
        data.ctrl[:] = command
        mujoco.mj_step(model, data, nstep=4)
        q, v = exact_actuator(q, v, command, 4 * model.opt.timestep, lag_s, acceleration)
        reading = data.qpos - 0.5 * model.opt.timestep * data.qvel
        worst = np.maximum(worst, np.abs(reading - q))
    return np.degrees(worst)


def bang_bang(head, rng, exact_actuator):
    """Full-speed commands that switch at random control periods, away from the limits."""
    limits = head.limits
    lower, upper = limits.lower + 0.45, limits.upper - 0.45
    sign, hold = rng.choice([-1.0, 1.0], 7), rng.integers(1, 30, 7)
    q, v, commands = np.zeros(7), np.zeros(7), np.empty((PERIODS, 7))
    for i in range(PERIODS):
        hold -= 1
        sign[hold <= 0] *= -1.0
        hold[hold <= 0] = rng.integers(1, 30, (hold <= 0).sum())
        sign = np.where(q > upper, -1.0, np.where(q < lower, 1.0, sign))
        commands[i] = sign * limits.velocity
        q, v = exact_actuator(q, v, commands[i], 1 / 120, head.timing.lag_s, limits.acceleration)
    return commands


class TestActuators:
    """The joints follow `v' = clip((u - v) / tau, +-a_max)`, whose lag is the preset's."""

    def test_bang_bang_of_all_joints(self, simulated, rng, exact_actuator):
        # the neck at its full acceleration is what disturbs the eyes most
        model = compile_model(simulated, **BARE)
        acceleration, lag_s = simulated.limits.acceleration, simulated.timing.lag_s
        for _ in range(4):
            commands = bang_bang(simulated, rng, exact_actuator)
            worst = follow(model, commands, np.zeros(7), lag_s, acceleration, exact_actuator)
            assert worst.max() < 0.1

    def test_no_acceleration_limit_leaves_the_lag_alone(self, simulated, exact_actuator):
        free = simulated.replace(limits={"acceleration": np.full(7, np.inf)})
        model = compile_model(free, neck="welded", **BARE)
        assert not model.actuator_forcelimited.any()
        commands = np.tile([6.0, -6.0, -6.0, 6.0], (12, 1))
        lag_s = free.timing.lag_s
        worst = follow(model, commands, np.zeros(4), lag_s, 1e9 * np.ones(4), exact_actuator)
        assert worst.max() < 0.02

    def test_nothing_sags(self, simulated):
        for gravity in (False, True):
            model = compile_model(simulated, gravity=gravity, **BARE)
            data = mujoco.MjData(model)
            data.qpos[:] = [0.3, 0.2, -0.4, 0.5, -0.5, -0.5, 0.5]
            start = data.qpos.copy()
            mujoco.mj_step(model, data, nstep=960)
            assert np.abs(data.qpos - start).max() < 1e-9


class TestTree:
    def test_joints_and_actuators_have_the_order_of_joints(self, head):
        model = compile_model(head)
        assert [model.joint(i).name for i in range(model.njnt)] == list(JOINTS)
        assert [model.actuator(i).name for i in range(model.nu)] == list(JOINTS)
        indices = find_model_indices(model, head)
        for places in (indices.qpos_of_joint, indices.joint_of_qpos, indices.slot_of_ctrl):
            np.testing.assert_array_equal(places, range(7))
        np.testing.assert_array_equal(model.jnt_range.T, [head.limits.lower, head.limits.upper])
        np.testing.assert_array_equal(model.actuator_ctrlrange[:, 1], head.limits.velocity)

    def test_a_welded_neck_leaves_the_eyes_where_it_holds_them(self, head):
        neck = [0.3, -0.2, 0.4]
        model = compile_model(head, neck="welded", neck_position=neck)
        indices = find_model_indices(model, head)
        np.testing.assert_array_equal(indices.qpos_of_joint, [-1, -1, -1, 0, 1, 2, 3])
        np.testing.assert_array_equal(indices.joint_of_qpos, range(7)[EYES])
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        expected = head.base_pose([*neck, 0.0, 0.0, 0.0, 0.0])
        np.testing.assert_allclose(data.site("N").xpos, expected[:3, 3], atol=1e-12)
        rotation = data.site("N").xmat.reshape(3, 3)
        np.testing.assert_allclose(rotation, expected[:3, :3], atol=1e-12)

    def test_other_joints_are_refused_by_name(self, simulated):
        other = mujoco.MjModel.from_xml_string(
            "<mujoco><worldbody><body><joint name='elbow'/><geom size='1'/></body></worldbody>"
            "</mujoco>"
        )
        with pytest.raises(ConfigurationError, match=r"neck_yaw.*elbow"):
            find_model_indices(other, simulated)

    def test_rotors_dominate_the_inertia(self, head):
        # what lets constant gains serve in every pose, and joints move undisturbed
        model = compile_model(head, **BARE)
        data = mujoco.MjData(model)
        for pose in (head.rest(), 0.9 * head.limits.upper, 0.9 * head.limits.lower):
            data.qpos[:] = pose
            mujoco.mj_forward(model, data)
            inertia = np.zeros((7, 7))
            mujoco.mj_fullM(model, data, inertia)
            share = model.dof_armature / np.diag(inertia)
            assert share.min() > 0.95
            coupling = np.abs(inertia - np.diag(np.diag(inertia))) / np.diag(inertia)
            assert coupling.max() < 0.005

    def test_shapes_weigh_nothing_and_touch_nothing(self, simulated):
        plain, dressed = compile_model(simulated, **BARE), compile_model(simulated)
        for name in (f"{joint}_link" for joint in JOINTS):
            assert plain.body(name).mass == dressed.body(name).mass
            np.testing.assert_array_equal(plain.body(name).inertia, dressed.body(name).inertia)
        assert dressed.ngeom > 10
        assert not dressed.geom_contype.any()
        assert not dressed.geom_conaffinity.any()

    def test_four_steps_are_a_control_period(self, head):
        model = compile_model(head, **BARE)
        assert 4 * model.opt.timestep == pytest.approx(head.timing.period_s)
        assert compile_model(head, timestep_s=0.001, **BARE).opt.timestep == 0.001


def test_what_no_model_can_be_made_of_is_refused(simulated, physical, errors, rng):
    for head, options, said in [
        (physical.perturbed(rng, errors, 3), {}, r"one head.*\(3,\)"),
        (simulated.replace(timing={"lag_s": 0.0}), {}, r"lag_s > 0, got 0\.0.*kinematic"),
        (simulated, {"neck": "rubber"}, "'servo' or 'welded', got 'rubber'"),
        (simulated, {"timestep_s": 0.0}, "timestep_s"),
        (simulated, {"timestep_s": np.nan}, "timestep_s"),
    ]:
        with named(options, said), pytest.raises(VergenceError, match=said):
            build_spec(head, **options)


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


class TestCameras:
    def test_project_as_the_head_does(self, head, random_poses, rng):
        model = compile_model(head, **BARE)
        data = mujoco.MjData(model)
        points = rng.uniform([-0.3, -0.3, 0.6], [0.3, 0.3, 2.0], (50, 3))
        for q, point in zip(0.3 * random_poses(head, 50), points, strict=True):
            data.qpos[:] = q
            mujoco.mj_forward(model, data)
            world = head.base_pose(q)[:3] @ [*point, 1.0]
            expected = head.project(q, point, distorted=False)
            for eye, name in enumerate(("left", "right")):
                pixel = mujoco_pixel(model, data, name, world)
                # MuJoCo keeps intrinsics in single precision
                np.testing.assert_allclose(pixel, expected[eye], atol=2e-3)

    def test_the_fixed_pair_is_the_articles(self, simulated):
        model = compile_model(simulated, observer_cameras=True)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        left, right = data.camera("fixed_left"), data.camera("fixed_right")
        assert np.linalg.norm(right.xpos - left.xpos) == pytest.approx(0.063)
        z_N, x_N = simulated.base_pose(np.zeros(7))[:3, [2, 0]].T
        np.testing.assert_allclose(left.xmat.reshape(3, 3)[:, 2], -z_N, atol=1e-12)
        np.testing.assert_allclose(right.xpos - left.xpos, 0.063 * x_N, atol=1e-12)
        ahead = left.xpos + z_N
        pixel = mujoco_pixel(model, data, "fixed_left", ahead)
        np.testing.assert_allclose(pixel, OBSERVER_CAMERAS.principal_px, atol=1e-4)
        beside = mujoco_pixel(model, data, "fixed_left", ahead + 0.1 * x_N) - pixel
        np.testing.assert_allclose(beside, [67.621, 0.0], atol=1e-4)


class TestTargets:
    def test_the_body_is_the_frame_of_the_measured_point(self, simulated):
        for board in (AprilTag(), Checkerboard()):
            with named(board):
                model = compile_model(simulated, targets={"board": board})
                plate = model.geom("board")
                # the front face is z = 0 of T; the upper left corner lies the origin's cells away
                corner = plate.pos[:2] - plate.size[:2]
                np.testing.assert_allclose(corner, -board.cell_m * np.array(board.origin_cells))
                assert plate.pos[2] - plate.size[2] == pytest.approx(0.0)
                size = board.cell_m * np.array(board.cells.T.shape)
                np.testing.assert_allclose(2 * plate.size[:2], size)

    def test_the_target_faces_the_resting_head_and_can_be_moved(self, simulated):
        model = compile_model(simulated, targets={"tag": AprilTag()})
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        facing = simulated.base_pose(np.zeros(7))[:3, :3]
        np.testing.assert_allclose(data.body("tag").xmat.reshape(3, 3), facing, atol=1e-12)
        data.mocap_pos[model.body("tag").mocapid[0]] = [0.1, -2.0, 0.3]
        mujoco.mj_kinematics(model, data)
        np.testing.assert_array_equal(data.body("tag").xpos, [0.1, -2.0, 0.3])
