"""Exports: the URDF's own tree, the folder of MJCF files, and that they run."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import cv2
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.heads import head_of, text_of
from tests.models.mujoco.test_model import ALL, any_head, mujoco_pixel, placed, postures
from tests.models.urdf.descriptions import UrdfKinematics
from tests.naming import named, refused
from vergence.errors import UnknownNameError
from vergence.models import JOINTS, parse_head
from vergence.models.mujoco.export import FORMATS, export_files, roll_pitch_yaw, to_urdf
from vergence.models.mujoco.model import compile_model
from vergence.vision.targets import AprilTag, Checkerboard

TARGETS = {"tag": AprilTag()}
FOLDER = Path(__file__).resolve().parents[3] / "models" / "bionic_eyes"


class TestUrdf:
    def test_it_has_the_heads_frames(self, rng):
        for kind in ALL:
            head = any_head(kind)
            kinematics = UrdfKinematics(to_urdf(head))
            for q in postures(head, rng):
                angles, base = dict(zip(head.joints, q, strict=True)), head.base_pose(q)
                expected = [base, *(base @ head.camera_poses(q))]
                links = ("N", "left_camera", "right_camera")
                found = [kinematics.pose(link, "base", angles) for link in links]
                with named(kind):
                    np.testing.assert_allclose(found, expected, atol=1e-12)

    def test_a_joint_that_follows_one_other_is_a_mimic_and_a_version_a_comment(self):
        head = parse_head(text_of("mis") + "[joint_offsets_rad]\nright_tilt = 0.1\n")
        joints = {j.get("name"): j for j in ET.fromstring(to_urdf(head)).iter("joint")}
        mimic = joints["right_tilt"].find("mimic")
        assert mimic.attrib == {"joint": "left_tilt", "multiplier": "1", "offset": "0.1"}
        assert sum(joint.find("mimic") is not None for joint in joints.values()) == 1
        text = to_urdf(head_of("tied"))
        assert "left_pan = 1 version +0.5 vergence" in text
        assert "mimic" not in text

    def test_limits_efforts_and_inertia_are_the_models(self, head):
        limits, model = [*ET.fromstring(to_urdf(head)).iter("limit")], compile_model(head)
        for name, own in [
            *((name, getattr(head.limits, name)) for name in ("lower", "upper", "velocity")),
            ("effort", model.actuator_forcerange[:, 1]),
        ]:
            values = [float(limit.get(name)) for limit in limits]
            np.testing.assert_allclose(values, own, rtol=1e-12)
        urdf = mujoco.MjModel.from_xml_string(to_urdf(head))
        for joint in JOINTS:
            ours, theirs = (one.body(f"{joint}_link") for one in (model, urdf))
            np.testing.assert_allclose(theirs.mass, ours.mass)
            np.testing.assert_allclose(theirs.ipos, ours.ipos, atol=1e-12)
            np.testing.assert_allclose(np.sort(theirs.inertia), np.sort(ours.inertia), rtol=1e-9)
        free = head.replace(limits={"acceleration": np.full(7, np.inf)})
        limits = ET.fromstring(to_urdf(free)).iter("limit")
        assert all(0.0 < float(limit.get("effort")) < 1e3 for limit in limits)

    def test_roll_pitch_yaw_make_the_rotation(self, rng):
        for pitch in [0.3, np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-8, 1.5707]:
            for roll, yaw in rng.uniform(-3.0, 3.0, (50, 2)):
                rotation = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()
                again = Rotation.from_euler("xyz", roll_pitch_yaw(rotation)).as_matrix()
                with named(roll, pitch, yaw):
                    np.testing.assert_allclose(again, rotation, atol=1e-12)


def test_what_cannot_be_exported_is_refused(physical, errors, rng):
    refused(r"one head.*\(2,\)", to_urdf, physical.perturbed(rng, errors, 2))
    refused("mjcf, urdf, got 'sdf'", export_files, physical, "sdf", error=UnknownNameError)


def test_exported_files_carry_the_heads_name(simulated):
    for name, stem in [("my head 2", "my-head-2"), ("scene", "scene-head"), ("…", "head")]:
        with named(name, stem):
            head = simulated.replace(name=name)
            mjcf, urdf = (export_files(head, kind) for kind in ("mjcf", "urdf"))
            assert {*mjcf, *urdf} == {f"{stem}.xml", "scene.xml", f"{stem}.urdf"}
            assert ET.fromstring(mjcf["scene.xml"]).find("include").get("file") == f"{stem}.xml"
            assert ET.fromstring(mjcf[f"{stem}.xml"]).get("model") == name
            assert ET.fromstring(urdf[f"{stem}.urdf"]).get("name") == name


def test_the_folder_is_what_is_generated(simulated):
    files = {k: v for kind in FORMATS for k, v in export_files(simulated, kind, TARGETS).items()}
    stored = {str(p.relative_to(FOLDER)): p for p in FOLDER.rglob("*") if p.is_file()}
    assert stored.keys() - files.keys() == {"README.md", "bionic_eyes.png"}
    for name, content in files.items():
        both = stored[name].read_bytes(), content
        if name.endswith(".png"):
            # another version of the encoder may pack the same pixels otherwise
            images = [cv2.imdecode(np.frombuffer(data, np.uint8), -1) for data in both]
            np.testing.assert_array_equal(*images)
            continue
        words = (re.split(r'[\s"]+', data.decode()) for data in both)
        for word, other in zip(*words, strict=True):  # the last digits of numbers may differ
            same = word == other or np.isclose(float(word), float(other), rtol=2e-6, atol=1e-12)
            assert same, (name, word, other)


def scene_of(head, targets=TARGETS):
    """Model and data of an exported scene; the model has six significant digits."""
    files = export_files(head, "mjcf", targets)
    model = mujoco.MjModel.from_xml_string(files["scene.xml"].decode(), files)
    return model, placed(model, head, head.rest())


class TestMjcf:
    @pytest.mark.slow
    def test_the_scene_steps_under_noise_without_a_warning(self, rng):
        scene = mujoco.MjModel.from_xml_path(str(FOLDER / "scene.xml"))
        data = mujoco.MjData(scene)
        fastest = scene.actuator_ctrlrange[:, 1]
        while data.time < 2.0:
            step = 0.1 * fastest * rng.standard_normal(scene.nu)
            data.ctrl[:] = np.clip(data.ctrl + step, -fastest, fastest)
            mujoco.mj_step(scene, data)
            assert [warning.number for warning in data.warning] == [0] * len(data.warning)
        assert np.isfinite(data.qpos).all()
        assert np.abs(data.qpos).max() > 0.1

    @pytest.mark.slow
    def test_the_scene_is_the_head_and_shows_a_fixated_target_in_the_middle(self):
        for kind in ALL:
            with named(kind):
                head = any_head(kind)
                model, ours = scene_of(head)[0], compile_model(head, visuals=False)
                np.testing.assert_allclose(model.actuator_gainprm, ours.actuator_gainprm, rtol=1e-5)
                np.testing.assert_allclose(model.dof_armature, ours.dof_armature, rtol=1e-5)
                point = np.array([0.05, 0.02, 0.9])
                q = head.fixate(point) if head.actuation.count else head.rest()
                data, base = placed(model, head, q), head.base_pose(q)
                expected = head.project(q, point, distorted=False)
                for eye, name in enumerate(("left", "right")):
                    pixel = mujoco_pixel(model, data, name, base[:3] @ [*point, 1.0])
                    np.testing.assert_allclose(pixel, expected[eye], atol=0.01)

    def test_the_fixed_pair_is_the_articles(self, simulated):
        model, data = scene_of(simulated)
        left, right = data.camera("fixed_left"), data.camera("fixed_right")
        z_N, x_N = simulated.base_pose(np.zeros(7))[:3, [2, 0]].T
        np.testing.assert_allclose(left.xmat.reshape(3, 3)[:, 2], -z_N, atol=1e-6)
        np.testing.assert_allclose(right.xpos - left.xpos, 0.063 * x_N, atol=1e-6)
        ahead = left.xpos + z_N
        pixel = mujoco_pixel(model, data, "fixed_left", ahead)
        np.testing.assert_allclose(pixel, (645.09, 368.27), atol=1e-3)
        beside = mujoco_pixel(model, data, "fixed_left", ahead + 0.1 * x_N) - pixel
        np.testing.assert_allclose(beside, [67.621, 0.0], atol=1e-3)

    def test_a_target_faces_the_head_and_is_the_frame_of_the_measured_point(self, simulated):
        for board in (AprilTag(), Checkerboard()):
            with named(board):
                model, data = scene_of(simulated, {"board": board})
                facing = simulated.base_pose(np.zeros(7))[:3, :3]
                np.testing.assert_allclose(data.body("board").xmat.reshape(3, 3), facing, atol=1e-6)
                assert model.body("board").mocapid[0] == 0
                plate = model.geom("board")
                # the front face is z = 0 of T; the upper left corner lies the origin's cells away
                corner = plate.pos[:2] - plate.size[:2]
                np.testing.assert_allclose(corner, -board.cell_m * np.array(board.origin_cells))
                assert plate.pos[2] - plate.size[2] == pytest.approx(0.0)
                size = board.cell_m * np.array(board.cells.T.shape)
                np.testing.assert_allclose(2 * plate.size[:2], size)

    def test_the_head_alone_can_be_put_into_other_scenes(self):
        model = mujoco.MjModel.from_xml_path(str(FOLDER / "simulated.xml"))
        assert (model.nmocap, model.ntex) == (0, 0)
        # gravity and contacts act on what others add; the head is spared by its own attributes
        assert model.opt.disableflags == 0
        assert (model.body_gravcomp[1:] == 1.0).all()
