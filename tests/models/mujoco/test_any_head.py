"""The MuJoCo model and the exports of heads of all shapes."""

import xml.etree.ElementTree as ET
from functools import cache

import mujoco
import numpy as np
import pytest

from tests.heads import TEXTS, head_of, text_of
from tests.models.mujoco.test_export import urdf_poses
from tests.models.mujoco.test_model import mujoco_pixel
from tests.naming import named
from vergence.models import load_head, parse_head
from vergence.models.mujoco.bodies import couplings_of, load_inertias
from vergence.models.mujoco.export import export_files, to_urdf
from vergence.models.mujoco.model import compile_model, find_model_indices

BARE = {"visuals": False}
VERGENCE_OF_ONE = text_of("tied").replace("left_pan = 0.5, right_pan = -0.5", "right_pan = -1.0")
"""A pan of both eyes and a vergence of the right one: no division of rotors keeps these apart."""
THREE_FROM_TWO = (
    text_of("panfirst")
    + "".join(
        f'[[actuators]]\nname = "{name}"\njoints = {{ {joints} }}\nlower_rad = -0.4\n'
        "upper_rad = 0.4\nvelocity_rad_s = 5.0\nacceleration_rad_s2 = 80.0\n"
        for name, joints in (
            ("first", "left_pan = 1.0, left_tilt = 0.5, right_tilt = 0.5"),
            ("second", "right_pan = 1.0, left_tilt = 0.5, right_tilt = -0.5"),
        )
    )
    + "[joint_offsets_rad]\nleft_tilt = 0.1\n"
)
"""Joints that follow two others."""


@cache
def any_head(name):
    texts = {"vergence_of_one": VERGENCE_OF_ONE, "three_from_two": THREE_FROM_TWO}
    if name in texts:
        return parse_head(texts[name])
    return load_head(name) if name in ("turrets", "physical") else head_of(name)


@cache
def bare_model(name):
    return compile_model(any_head(name), **BARE)


ALL = (*TEXTS, "turrets", "vergence_of_one", "three_from_two")


def postures(head, rng, count=6):
    own = head.actuation
    return own.joints_of(rng.uniform(own.lower, own.upper, (count, 7)))


def placed(model, head, q):
    data = mujoco.MjData(model)
    places = find_model_indices(model, head).joint_of_qpos
    data.qpos[: len(places)] = q[places]
    mujoco.mj_forward(model, data)
    return data


class TestTree:
    @pytest.mark.slow
    def test_cameras_and_n_are_where_the_head_has_them(self, rng):
        for kind in (*ALL, "physical"):
            with named(kind):
                head, model = any_head(kind), bare_model(kind)
                for q in postures(head, rng):
                    data, base = placed(model, head, q), head.base_pose(q)
                    np.testing.assert_allclose(data.site("N").xpos, base[:3, 3], atol=1e-12)
                    expected = base @ head.camera_poses(q)
                    for eye, name in enumerate(("left", "right")):
                        camera = data.camera(name)
                        np.testing.assert_allclose(camera.xpos, expected[eye, :3, 3], atol=1e-12)
                        optical = camera.xmat.reshape(3, 3) * [1.0, -1.0, -1.0]
                        np.testing.assert_allclose(optical, expected[eye, :3, :3], atol=1e-12)

    @pytest.mark.slow
    def test_joints_are_the_heads_and_actuators_its_actuators(self):
        for name in ALL:
            with named(name):
                head, model = any_head(name), bare_model(name)
                joints = [name for name in dict.fromkeys(head.joints) if name]
                names = [model.joint(i).name for i in range(model.njnt)]
                assert [name for name in names if not name.endswith("_rotor")] == joints
                expected = [name for name in head.joints[:3] if name] + list(head.actuation.names)
                assert [model.actuator(i).name for i in range(model.nu)] == expected
                slots = find_model_indices(model, head).slot_of_ctrl
                fastest = head.actuation.velocity[slots]
                np.testing.assert_array_equal(model.actuator_ctrlrange[:, 1], fastest)

    def test_an_actuator_may_have_the_name_of_a_neck_joint(self):
        head = parse_head(text_of("tied").replace('name = "tilt"', 'name = "neck_yaw"'))
        model = compile_model(head, **BARE)
        assert model.actuator("eyes_neck_yaw").id == 3

    def test_each_eye_has_its_own_image_size(self):
        model = compile_model(head_of("pair").replace(cameras={"size": [[320, 240], [640, 400]]}))
        np.testing.assert_array_equal(model.cam_resolution, [[320, 240], [640, 400]])
        assert (model.vis.global_.offwidth, model.vis.global_.offheight) == (640, 400)


class TestTies:
    def test_equality_constraints_are_computed_only_where_joints_follow_others(self):
        for name in ALL:
            with named(name):
                model = bare_model(name)
                off = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EQUALITY)
                assert bool(off) == (model.neq == 0)

    def test_joints_that_follow_others_do_so_under_full_commands(self, rng):
        for name in ("mis", "vergence_of_one", "three_from_two"):
            with named(name):
                head = any_head(name)
                own, model = head.actuation, bare_model(name)
                indices = find_model_indices(model, head)
                middle = 0.5 * (own.lower + own.upper)
                data = placed(model, head, own.joints_of(middle))
                data.qpos[len(indices.joint_of_qpos) :] = middle[indices.slot_of_rotor]
                worst = 0.0
                for step in range(400):
                    if step % 20 == 0:
                        fastest = own.velocity[indices.slot_of_ctrl]
                        data.ctrl[:] = rng.choice([-1.0, 1.0], model.nu) * fastest
                    mujoco.mj_step(model, data)
                    q = np.where(indices.qpos_of_joint >= 0, data.qpos[indices.qpos_of_joint], 0.0)
                    worst = max(worst, np.abs(own.joints_of(own.actuators_of(q)) - q).max())
                assert np.abs(data.qpos).max() > 0.1
                # within what an encoder of 0.01 degrees tells
                assert worst < 1e-4

    def test_a_joint_may_follow_two_others_from_an_offset(self):
        head = any_head("three_from_two")
        couplings = {coupling.joint: coupling for coupling in couplings_of(head)}
        assert couplings
        for q in postures(head, np.random.default_rng(3)):
            angles = dict(zip(head.joints, q, strict=True))
            for coupling in couplings.values():
                parts = [factor * angles[name] for name, factor in coupling.follows]
                follows = coupling.offset + sum(parts)
                assert angles[coupling.joint] == pytest.approx(follows, abs=1e-12)

    def test_servos_of_a_wide_head_are_stronger(self):
        wide = parse_head(text_of("common").replace("0.05, 0.0, 0.0", "0.5, 0.0, 0.0"))
        stronger, own = (load_inertias(h).joint_armature for h in (wide, head_of("common")))
        assert (stronger >= own).all()


class TestExports:
    @pytest.mark.slow
    def test_the_folder_loads_and_shows_a_fixated_target_in_the_middle(self, tmp_path):
        for kind in ALL:
            with named(kind):
                head = any_head(kind)
                for name, content in export_files(head, "mjcf").items():
                    (tmp_path / kind / name).parent.mkdir(parents=True, exist_ok=True)
                    (tmp_path / kind / name).write_bytes(content)
                model = mujoco.MjModel.from_xml_path(str(tmp_path / kind / "scene.xml"))
                assert model.cam("left").id >= 0
                point = np.array([0.05, 0.02, 0.9])
                q = head.fixate(point) if head.actuation.count else head.rest()
                data, base = placed(model, head, q), head.base_pose(q)
                expected = head.project(q, point, distorted=False)
                for eye, name in enumerate(("left", "right")):
                    pixel = mujoco_pixel(model, data, name, base[:3] @ [*point, 1.0])
                    # six significant digits of the poses
                    np.testing.assert_allclose(pixel, expected[eye], atol=0.01)

    def test_the_urdf_has_the_heads_frames(self, rng):
        for kind in ALL:
            with named(kind):
                head = any_head(kind)
                text = to_urdf(head)
                for q in postures(head, rng):
                    poses = urdf_poses(text, dict(zip(head.joints, q, strict=True)))
                    base = head.base_pose(q)
                    np.testing.assert_allclose(poses["N"], base, atol=1e-12)
                    for eye, name in enumerate(("left_camera", "right_camera")):
                        expected = base @ head.camera_poses(q)[eye]
                        np.testing.assert_allclose(poses[name], expected, atol=1e-12)

    def test_a_joint_that_follows_one_other_is_a_mimic_and_a_version_a_comment(self):
        joints = {j.get("name"): j for j in ET.fromstring(to_urdf(head_of("mis"))).iter("joint")}
        mimic = joints["right_tilt"].find("mimic")
        assert mimic.attrib == {"joint": "left_tilt", "multiplier": "1", "offset": "0"}
        assert sum(joint.find("mimic") is not None for joint in joints.values()) == 1
        text = to_urdf(head_of("tied"))
        assert "left_pan = 1 version +0.5 vergence" in text
        assert "mimic" not in text


class TestAppearance:
    def test_heads_stand_above_the_floor_whatever_their_base_frame(self):
        for scale in (0.6, 1.0, 10.0):
            with named(scale):
                text = text_of("pair").replace("0.05, 0.0, 0.0", f"{0.05 * scale}, 0.0, 0.0")
                head = parse_head(text)
                model = compile_model(head)
                data = placed(model, head, head.rest())
                floor, up = data.geom("floor"), -head.base_pose(head.rest())[:3, 1]
                np.testing.assert_allclose(floor.xmat.reshape(3, 3)[:, 2], up, atol=1e-12)
                assert ((data.cam_xpos - floor.xpos) @ up > 0.2).all()
                np.testing.assert_allclose(model.opt.gravity, -9.81 * up, atol=1e-12)

    @pytest.mark.slow
    def test_eyeballs_are_about_the_cameras_and_do_not_touch(self):
        for name in ALL:
            with named(name):
                head = any_head(name)
                model = compile_model(head)
                data = placed(model, head, head.rest())
                balls = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE)
                assert len(balls) == 2
                np.testing.assert_allclose(data.geom_xpos[balls], data.cam_xpos, atol=0.004)
                apart = np.linalg.norm(np.diff(data.geom_xpos[balls], axis=0))
                assert model.geom_size[balls, 0].sum() < apart
