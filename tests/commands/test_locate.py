"""`vergence locate`: what it prints and writes, and how it refuses."""

import csv
import json
import tomllib
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.commands.called import call, refused
from tests.heads import head_of, text_of
from tests.naming import named
from tests.perception.drawn import Studio, corners_in_space, pose_at, save_pair
from tests.perception.test_located import exact
from tests.perception.test_pictures import result_of
from vergence.commands.located import print_located_targets
from vergence.models import load_head
from vergence.perception.locate import (
    EdgeSpacing,
    describe_wrong_edges,
    locate_target,
    write_target_table,
)
from vergence.vision.targets import AprilTag, Checkerboard

TARGET = "tag:36h11:5:120"
TAG = AprilTag(id=5, edge_m=0.12)


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A fixed pair's head file, and three pairs of a tag; in the third one its place is empty."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "pair.toml").write_text(text_of("pair"), encoding="utf-8")
    head = load_head(folder / "pair.toml")
    studio, rng = Studio(head, TAG), np.random.default_rng(0)
    poses = [pose_at([0.02, -0.03, 0.6], [0.1, 0.3, 0.0]), pose_at([-0.05, 0.02, 0.8], [0, 0, 0.4])]
    for number, pose in zip((2, 10), poses, strict=True):
        save_pair(folder, f"{number}.png", studio.take(pose, rng))
    save_pair(folder, "11.png", [np.full((240, 320), 120, np.uint8)] * 2)
    return folder, poses


@pytest.fixture
def locate(desk, capsys, tmp_path):
    """Locate in images beside the head file; exit code, standard output and error."""
    folder, _ = desk

    def run(left="left", right="right", *words, target=TARGET):
        words = ("--head", folder / "pair.toml", "--out", tmp_path / "run", *words)
        code = call("locate", folder / left, folder / right, "--target", target, *words)
        return code, *capsys.readouterr()

    return run


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_json_has_a_row_for_each_target_of_a_pair_with_the_true_points(desk, locate):
    code, out, _ = locate("left", "right", "--json")
    rows = json.loads(out)
    assert code == 0
    assert [row["pair"] for row in rows] == ["2.png", "10.png"]
    for row, pose in zip(rows, desk[1], strict=True):
        assert (row["target"], row["id"]) == (TARGET, 5)
        sigma = np.array(row["sigma_mm"])
        error = np.array(row["points_mm"]) - 1e3 * corners_in_space(TAG, pose)
        # 12 coordinates of each: beyond four sigma is no chance
        assert (np.abs(error) < 4.0 * sigma).all()
        assert (sigma > 0.0).all()
        assert np.abs(np.array(row["centre_mm"]) - 1e3 * pose[:3, 3]).max() < 3.0
        assert np.shape(row["pixels"]) == np.shape(row["sigma_px"]) == (2, 4, 2)
        assert np.shape(row["gap_mm"]) == (4,)
        assert row["spacing_mm"]["mean"] == pytest.approx(120.0, abs=0.5)
        assert row["spacing_mm"]["stated"] == 120.0
        T_N_C = load_head(desk[0] / "pair.toml").camera_poses(np.zeros(7))
        truths = [pose, *(np.linalg.inv(T_N_C) @ pose)]
        for found, truth in zip([row["pose"], *row["eye_poses"].values()], truths, strict=True):
            error_mm = np.subtract(found["translation_mm"], 1e3 * truth[:3, 3])
            turned = cv2.Rodrigues(np.array(found["rotation_matrix"]) @ truth[:3, :3].T)[0].ravel()
            sigma = np.concatenate([found["sigma_mm"], found["sigma_rad"]])
            assert (np.abs([*error_mm, *turned]) < 4.0 * sigma).all()
            assert sigma == pytest.approx(np.sqrt(np.diagonal(found["covariance_mm_rad"])))
            again = cv2.Rodrigues(np.array(found["rotation_vector_rad"]))[0]
            assert again == pytest.approx(np.array(found["rotation_matrix"]))
            assert found["other"] is None


@pytest.mark.slow
def test_the_table_and_the_run_folder_hold_what_was_located(locate, tmp_path):
    code, out, err = locate()
    assert (code, err) == (0, "")
    for word in ("tags of 36h11", "centre", "sigma", "gap", "rotation", "2 of 3", "stated 120 mm"):
        assert word in out
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert names == {
        "points.csv", "targets.csv", "result.json", "config.toml", "head.toml", "locate.png",
    }  # fmt: skip
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    rows = result["located"]
    assert f"{rows[0]['centre_mm'][2]:.2f}" in out
    assert result["pairs"] == ["2.png", "10.png", "11.png"]
    config = tomllib.loads((tmp_path / "run" / "config.toml").read_text())
    assert config["config"]["target"] == [TARGET]
    with (tmp_path / "run" / "points.csv").open(newline="") as file:
        points = list(csv.DictReader(file))
    assert len(points) == 8
    assert float(points[5]["z_mm"]) == rows[1]["points_mm"][1][2]
    assert float(points[5]["right_u_px"]) == rows[1]["pixels"][1][1][0]
    with (tmp_path / "run" / "targets.csv").open(newline="") as file:
        target = list(csv.DictReader(file))[1]
    pose = rows[1]["pose"]
    for axis, place in enumerate("xyz"):
        assert float(target[f"pose_{place}_mm"]) == pose["translation_mm"][axis]
        assert float(target[f"pose_r{place}_rad"]) == pose["rotation_vector_rad"][axis]
        assert float(target[f"sigma_pose_r{place}_rad"]) == pose["sigma_rad"][axis]
        assert target[f"other_pose_r{place}_rad"] == ""
    for degrees in np.degrees(pose["rotation_vector_rad"]):
        assert f" {degrees:.2f}" in out
    assert min(cv2.imread(str(tmp_path / "run" / "locate.png")).shape[:2]) > 700


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_edges_tell_wrong_joint_angles_and_none_stand_for_rest(capsys, tmp_path):
    head, place = load_head("turrets"), [0.1, 0.05, 0.7]
    q = head.fixate(place)
    images = Studio(head, TAG, q).take(pose_at(place), np.random.default_rng(1))
    pair = save_pair(tmp_path, "one.png", images)
    words = ("locate", *pair, "--head", "turrets", "--target", TARGET, "--json", "--out")
    turned = q.copy()
    # along the gap it shows nowhere but in the depth
    turned[list(head.joints).index("left_pan")] += 0.05
    for angles, wrong in ((q, False), (turned, True)):
        given = {name: float(a) for name, a in zip(head.joints, angles, strict=True) if name}
        (tmp_path / "q.json").write_text(json.dumps(given), encoding="utf-8")
        assert call(*words, tmp_path / f"{wrong}", "--joints", tmp_path / "q.json") == 0
        out, err = capsys.readouterr()
        (row,) = json.loads(out)
        assert ("edges are" in err) == wrong
        assert "rest" not in err
        # of the joints' steps: far more than pixels alone would leave
        assert 0.1 < row["spacing_mm"]["sigma"] < 2.0
        error = np.subtract(row["centre_mm"], 1e3 * np.array(place))
        assert (np.abs(error) < 3.0 * np.array(row["centre_sigma_mm"])).all() != wrong
    call(*words, tmp_path / "without")
    out, err = capsys.readouterr()
    assert "no --joints: the eyes are taken to be at rest, in degrees" in err
    for row in json.loads(out):
        assert (
            row["centre_mm"] is None
            or np.abs(np.subtract(row["centre_mm"], 1e3 * np.array(place))).max() > 50.0
        )


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_what_one_image_alone_has_is_counted_and_a_broken_one_named(desk, locate, tmp_path):
    rights = tmp_path / "right"
    rights.mkdir()
    for name, image in (("10.png", "11.png"), ("12.png", "2.png")):
        (rights / name).write_bytes((desk[0] / "right" / image).read_bytes())
    (rights / "2.png").write_bytes(b"no image")
    code, out, err = locate("left", rights, "--json")
    assert (code, json.loads(out)) == (2, [])
    assert f"{TARGET} found in the left image only of 1 pair: 10.png" in err
    assert "2 of the images have no partner: 11.png, 12.png" in err
    assert str(rights / "2.png") in err
    assert (tmp_path / "run" / "result.json").exists()


def test_without_any_readable_pair_nothing_is_written(desk, locate, tmp_path):
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"")
    code, _, err = locate("left/2.png", broken)
    assert code == 2
    assert str(broken) in err
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_nothing_found_ends_in_exit_code_1(locate):
    code, out, err = locate("left/2.png", "right/2.png", "--json", target="tag:36h11:6:120")
    assert (code, json.loads(out)) == (1, [])
    assert "expected tag:36h11:6:120 in both images of the pair, found none" in err


@pytest.mark.nightly
@pytest.mark.usefixtures("undrawn")
def test_images_that_are_swapped_or_do_not_belong_together_are_told(locate, tmp_path):
    code, _, err = locate("right/2.png", "left/2.png")
    assert code == 1
    assert "are left and right swapped?" in err
    err = locate("left/2.png", "right/10.png", "--out", tmp_path / "other")[-1]
    assert "lines of sight miss each other by more than 2 px" in err


@pytest.mark.slow
def test_what_cannot_be_is_refused_in_one_line(desk, capsys, tmp_path, monkeypatch):
    folder, _ = desk
    monkeypatch.chdir(tmp_path)
    (tmp_path / "left").mkdir()
    cv2.imwrite("small.png", np.zeros((48, 64), np.uint8))
    for change, said in [
        ({"left": "none.png"}, "none.png: no such file"),
        ({"left": "small.png"}, "image: expected the camera's 320 x 240 px, got 64 x 48"),
        ({"left": "left"}, "two images or two folders"),
        ({"target": None}, "target: expected at least one"),
        ({"target": "tag:99h9"}, "target tag:99h9:"), ({"head": None}, "--head"),
        ({"head": "nonsense"}, "'nonsense'"), ({"joints": "none.json"}, "none.json: No such file"),
        ({"response": "9"}, "response: expected 'linear', 'srgb', a gamma"),
    ]:  # fmt: skip
        options = {
            "left": folder / "left" / "2.png", "right": folder / "right" / "2.png",
            "head": folder / "pair.toml", "target": TARGET,
        } | change  # fmt: skip
        words = [options.pop("left"), options.pop("right")]
        for name, value in options.items():
            words += [f"--{name}", value] if value is not None else []
        with named(change):
            assert said in refused(capsys, "locate", *words)
            assert not (tmp_path / "runs").exists()


def test_edges_that_are_not_as_stated_are_explained_by_the_likeliest_unit():
    for size_mm, hint in (
        (120.0, None),
        (121.0, None),  # 0.8 %: such a calibration is no mistake
        (100.0, ""), (0.12, "was the size given in m"), (12.0, "was the size given in cm"),
        (4.724, "was the size given in inches"), (120000.0, "was the size given in micrometres"),
    ):  # fmt: skip
        with named(size_mm):
            edges = EdgeSpacing(0.12, 0.0, 4, 1e-3 * size_mm, 1e-4)
            pairs = [(pair, edges) for pair in ("2.png", "10.png")]
            said = describe_wrong_edges("tag", pairs)
            assert bool(said) == (hint is not None)
            if hint is not None:
                assert f"in 2 of 2 places (2.png, 10.png), expected {size_mm:g} ± " in said
                assert hint in said
                assert ("was the size" in said) == bool(hint)


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_what_is_wrong_beside_what_was_located_is_said(desk, locate, tmp_path):
    folder, _ = desk
    for side, other in (("left", "right"), ("right", "left")):
        (tmp_path / side).mkdir()
        for name, source in (("2.png", side), ("10.png", other)):  # the second is swapped
            image = (folder / source / name).read_bytes()
            (tmp_path / side / name).write_bytes(image)
    words = ("--target", "tag:36h11", "--target", "tag:36h11:9")
    both = (tmp_path / "left", tmp_path / "right")
    code, out, err = locate(*both, *words, target="tag:36h11:5:100")
    assert code == 0
    assert "1 of 2 pairs; edges of tags 1" in out
    assert "nan" not in out
    assert "!" in out
    assert "edges are" in err
    assert "the lines of sight do not cross before the eyes in 10.png" in err
    assert "tag:36h11:9: found in 0 of 4 images" in err
    assert err.count("found in 0 of") == 1  # the family's tag is that of the second text as well
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    assert [one["centre_mm"] is None for one in result["located"]] == [False, True]
    assert result["located"][1]["spacing_mm"]["sigma"] is None


@pytest.mark.parametrize(
    ("name", "angles"), [("pair", ""), ("mis", ", and joint angles of that moment")]
)
def test_a_board_of_another_size_than_stated_is_doubted_and_its_rotation_marked(
    capsys, name, angles
):
    head, board = head_of(name), Checkerboard(square_m=0.02)
    q = head.rest()
    sides = exact(head, q, board, pose_at([0.0, 0.0, 0.6], [0.3, 0.4, 0.0]), 0.01)
    stated = replace(board, square_m=0.03)
    one = locate_target(head, q, "a.png", *(each._replace(target=stated) for each in sides))
    result = replace(result_of(("a.png", board, (0.0, 0.0, 1.0))), head=head, located=(one,))
    print_located_targets(result)
    assert "! no pose explains the corners of both images" in capsys.readouterr().out
    (said,) = (note for note in result.notes() if note.startswith("no pose"))
    expected = "a target of the stated size and a head file of these cameras as they stand"
    assert said.endswith(f"in a.png: expected {expected}{angles}")


def test_a_rotation_beside_which_another_fits_is_marked(capsys, tmp_path):
    head, tag = head_of("pair"), AprilTag(edge_m=0.02)
    result = result_of(("a.png", tag, (0.0, 0.0, 1.0)))
    sure = exact(head, head.rest(), tag, pose_at([0.0, 0.0, 0.3], [0.5, 0.4, 0.0]), 0.01)
    unsure = exact(head, head.rest(), tag, pose_at([0.0, 0.0, 1.0], [0.5, 0.4, 0.0]), 0.5)
    for sides, marked in ((sure, False), (unsure, True)):
        one = locate_target(head, head.rest(), "a.png", *sides)
        print_located_targets(replace(result, located=(one,)))
        out = capsys.readouterr().out
        assert ("? two tilts fit the corners" in out) == (out.count("?") == 2) == marked
        write_target_table(tmp_path / "targets.csv", [one])
        with (tmp_path / "targets.csv").open(newline="") as file:
            (row,) = csv.DictReader(file)
        other = one.document()["pose"]["other"]
        assert (other is not None) == bool(row["other_pose_rx_rad"]) == marked
        if marked:
            assert other["other"] is None
            assert float(row["other_pose_ry_rad"]) == other["rotation_vector_rad"][1]
