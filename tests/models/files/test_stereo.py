"""Calibrated pairs from files: every program's spelling gives the same numbers, faults one line."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.naming import named, refused
from vergence.models.stereo_files import read_intrinsics, read_stereo

from .pairs import (
    D_LEFT,
    D_RIGHT,
    K_LEFT,
    K_RIGHT,
    RECTIFIED,
    RIGHT_FROM_LEFT,
    SIZE,
    R,
    T,
    camchain,
    camera_info,
    opencv_pair,
    write_opencv,
)

EYES = (("left", K_LEFT, D_LEFT), ("right", K_RIGHT, D_RIGHT))
FOUR = [0.1, 0.02, 1e-3, 2e-3]
EIGHT = [*FOUR, 0.3, 0.4, 0.5, 0.6]


def check(pair, atol=1e-12, coefficients=5):
    for eye, k, d in EYES:
        camera = getattr(pair, eye)
        assert (camera.width, camera.height) == SIZE
        np.testing.assert_allclose(camera.focal, k[[0, 1], [0, 1]], atol=atol)
        np.testing.assert_allclose(camera.principal, k[:2, 2], atol=atol)
        assert camera.lens.model == "brown-conrady"
        read = camera.lens.coefficients[:coefficients]
        np.testing.assert_allclose(read, d[:coefficients], atol=atol)
    np.testing.assert_allclose(pair.right.pose, np.linalg.inv(RIGHT_FROM_LEFT), atol=atol)


def written(path, values):
    path.write_text(json.dumps(values, default=np.ndarray.tolist), encoding="utf-8")
    return path


def info_pair(folder):
    return [camera_info(folder / f"{eye}.yaml", i) for i, eye in enumerate(("left", "right"))]


@pytest.fixture
def opencv(tmp_path):
    """The files that hold a changed pair."""
    return lambda **changes: [write_opencv(tmp_path / "pair.yml", opencv_pair(**changes))]


@pytest.fixture
def one(tmp_path):
    """The file of a camera with more keys, or with more text as ROS has it."""

    def write(more: dict | str) -> list[Path]:
        if isinstance(more, str):
            path = camera_info(tmp_path / "one.yaml", 0)
            path.write_text(path.read_text("utf-8") + more, encoding="utf-8")
            return [path]
        own = {"image_size": SIZE, "K": K_LEFT, "D": D_LEFT} | more
        kept = {key: value for key, value in own.items() if value is not None}
        return [written(tmp_path / "one.json", kept)]

    return write


def test_a_file_that_opencv_writes_is_read_in_each_of_its_formats(tmp_path):
    for suffix in ("yml", "yaml", "xml", "json"):
        with named(suffix):
            check(read_stereo([write_opencv(tmp_path / f"pair.{suffix}", opencv_pair())]))
    # older YAML may lack spaces before values
    path = tmp_path / "pair.yml"
    text = path.read_text("utf-8").replace("data: [", "data:[").replace("_width: ", "_width:")
    path.write_text("%YAML:1.0\n---\n" + text.partition("---\n")[2], encoding="utf-8")
    check(read_stereo([path]))


def test_keys_may_be_spelled_as_people_spell_them(tmp_path):
    for matrix, coefficients, sides in [
        ("K{}", "D{}", "12"), ("{}_camera_matrix", "{}_distortion_coefficients", ("left", "right")),
        ("camera_matrix_{}", "dist_coeff_{}", ("left", "right")),
        ("cameraMatrix{}", "distCoeffs{}", "LR"), ("Camera{}_Matrix", "Camera{}_Distortion", "01"),
    ]:  # fmt: skip
        with named(matrix, coefficients, sides):
            values = {"image_size": SIZE, "R": R, "T": T}
            for side, (_, k, d) in zip(sides, EYES, strict=True):
                values |= {matrix.format(side): k, coefficients.format(side): d}
            check(read_stereo([written(tmp_path / "pair.json", values)]))
    eyes = {eye: {"K": k, "dist": d, "width": SIZE[0], "height": SIZE[1]} for eye, k, d in EYES}
    tables = {"calibration": {**eyes, "extrinsics": {"R": R, "T": T}}}
    check(read_stereo([written(tmp_path / "pair.json", tables)]))


def test_files_of_ros_and_orb_slam_hold_the_pair_in_rectification_and_projection(tmp_path):
    paths = info_pair(tmp_path)
    check(read_stereo(paths), atol=1e-7)  # files have eight decimals
    for name, path in zip(("left", "right"), paths, strict=True):
        old = yaml.safe_load(path.read_text("utf-8"))
        message = {  # as recorded from a topic
            "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": name}, "height": SIZE[1],
            "width": SIZE[0], "distortion_model": "plumb_bob",
            "d": old["distortion_coefficients"]["data"], "k": old["camera_matrix"]["data"],
            "r": old["rectification_matrix"]["data"], "p": old["projection_matrix"]["data"],
        }  # fmt: skip
        path.write_text(yaml.safe_dump(message) + "---\n" + yaml.safe_dump(message), "utf-8")
    check(read_stereo(paths), atol=1e-7)
    values = {"Camera.fx": 400.0, "Camera.bf": 40.0}
    for eye, (name, k, d) in enumerate(EYES):
        each = {"width": SIZE[0], "height": SIZE[1], "K": k, "D": d}
        each |= {"R": RECTIFIED[eye], "P": RECTIFIED[2 + eye]}
        values |= {f"{name.upper()}.{key}": value for key, value in each.items()}
    check(read_stereo([written(tmp_path / "orb.json", values)]), atol=1e-9)


def test_a_camchain_of_kalibr_is_read(tmp_path):
    pair = read_stereo([camchain(tmp_path / "camchain.yaml")])
    check(pair, coefficients=4)
    assert pair.guesses == ()
    pair = read_stereo([camchain(tmp_path / "camchain.yaml", "equidistant")])
    assert pair.left.lens.model == pair.right.lens.model == "fisheye"
    np.testing.assert_array_equal(pair.left.lens.coefficients, D_LEFT[:4])


def test_the_parts_of_a_pair_may_stand_in_files_of_their_own(tmp_path):
    values = {"M1": K_LEFT, "D1": D_LEFT, "M2": K_RIGHT, "D2": D_RIGHT}
    place = {"R": R, "T": T, "R1": np.eye(3), "R2": np.eye(3), "Q": np.eye(4)}
    # of OpenCV's stereo sample
    each = {"intrinsics": values, "extrinsics": place}
    paths = [write_opencv(tmp_path / f"{name}.yml", part) for name, part in each.items()]
    check(read_stereo(paths, size=SIZE))
    check(read_stereo(paths[::-1], size=SIZE))
    size = {"image_width": SIZE[0], "image_height": SIZE[1]}
    paths = [
        write_opencv(tmp_path / f"{eye}.yml", {"camera_matrix": k, "dist_coeffs": d} | size)
        for eye, k, d in EYES
    ]
    place = write_opencv(tmp_path / "place.xml", {"R": R, "T": T})
    check(read_stereo([*paths, place]))
    both = read_intrinsics(paths)
    assert (both.left.focal[0], both.right.focal[0]) == (K_LEFT[0, 0], K_RIGHT[0, 0])
    both = read_intrinsics(paths[:1])
    assert both.right is both.left


def test_the_unit_of_the_squares_is_that_of_the_translation(opencv):
    files = opencv(T=1000.0 * T)
    check(read_stereo(files, unit="mm"))
    refused(r"millimetres.*--unit mm: 0\.0939\d? m", read_stereo, files)
    files = opencv(T=1000.0 * T, unit="millimeters")
    check(read_stereo(files))
    refused("unit: expected the unit that was given", read_stereo, files, unit="m")
    files = opencv(T=T / 0.025, square_size=1.0)
    refused(r"in squares: .* --unit 25mm", read_stereo, files)
    check(read_stereo(files, unit="25mm"))
    assert "in squares of the board?" in read_stereo(files, unit="cm").guesses[0]
    for unit in ("inch", "0mm", "-3 mm", "mm25"):
        refused("unit: expected m, cm or mm", read_stereo, files, unit=unit)
    assert read_stereo(opencv(square_size=1.0)).guesses == ()


def test_a_swapped_pair_is_said_and_can_be_swapped_back(tmp_path, opencv, one):
    files = opencv(
        cameraMatrix1=K_RIGHT, cameraMatrix2=K_LEFT, distCoeffs1=D_RIGHT, distCoeffs2=D_LEFT,
        R=R.T, T=(-R.T @ T).reshape(3, 1),
    )  # fmt: skip
    refused("left and right swapped: give --swap", read_stereo, files)
    check(read_stereo(files, swap=True))
    left, right = info_pair(tmp_path)
    refused("left and right swapped", read_stereo, [right, left])
    refused(r"right\.yaml: proj.* left and right swapped", read_intrinsics, [right, left])
    for fine in ([left, right], [left], [right], [left, *one("")]):
        read_intrinsics(fine)


def test_the_number_of_coefficients_or_a_name_says_which_lens_it_is(opencv, one):
    for coefficients, lens, kept in [
        (FOUR, "brown-conrady", 4), ([*FOUR, 0.3], "brown-conrady", 5), (EIGHT, "rational", 8),
        ([*FOUR, 0.3, 0.0, 0.0, 0.0], "brown-conrady", 5), (EIGHT + 6 * [0.0], "rational", 8),
        ([*FOUR, 0.3] + 9 * [0.0], "brown-conrady", 5),
    ]:  # fmt: skip
        with named(coefficients, lens, kept):
            pair = read_stereo(opencv(distCoeffs1=np.array([coefficients])))
            assert pair.left.lens.model == lens
            np.testing.assert_array_equal(pair.left.lens.coefficients[:kept], coefficients[:kept])
            assert not pair.left.lens.coefficients[kept:].any()
            assert (pair.guesses != ()) == (len(coefficients) == 4)
    four = {f"distCoeffs{i}": np.array([FOUR]) for i in (1, 2)}
    pair = read_stereo(opencv(**four), lens="fisheye")
    assert (pair.left.lens.model, pair.guesses) == ("fisheye", ())
    assert read_stereo(opencv(**four, fisheye_model=1)).right.lens.model == "fisheye"
    for more, lens in [  # of other programs
        ({"model": "OPENCV_FISHEYE"}, "fisheye"), ({"model_type": "KANNALA_BRANDT"}, "fisheye"),
        ({"Camera.type": "KannalaBrandt8", "camera_type": "KannalaBrandt8"}, "fisheye"),
        ({"camera_model": "pinhole-equi"}, "fisheye"),
        ({"camera_model": "pinhole", "distortion_type": "radial-tangential"}, "brown-conrady"),
    ]:  # fmt: skip
        with named(more, lens):
            both = read_intrinsics(one({"D": FOUR} | more))
            assert both.left.lens.model == lens
            assert "fisheye" not in " ".join(both.guesses)


def test_what_cannot_be_a_pair_is_refused_with_the_reason(opencv):
    for changes, said in [
        ({"image_width": None}, "--size WIDTHxHEIGHT"),
        ({"image_width": 300}, "principal point inside the image of 300 x 480"),
        ({"R": None}, r"expected the rotation R .* got .*: T alone"),
        ({"R": None, "T": None}, "got neither"), ({"R": 1.01 * R}, "expected a rotation matrix"),
        ({"R": -R}, "expected a rotation matrix"),
        ({"R": np.eye(2)}, "expected a rotation of 3 x 3 numbers"),
        ({"T": np.zeros(3)}, "how large the squares are"),
        ({"T": np.array([-np.nan, 0.0, 0.0])}, "3 numbers, .* not all of them finite"),
        ({"T": np.array([-2.0, 0.0])}, "expected a translation of 3 numbers"),
        ({"T": np.array([0.0, 0.0, 0.1])}, "side by side"),
        ({"cameraMatrix1": K_LEFT.T}, "transposed"),
        ({"cameraMatrix1": np.eye(3)}, "focal lengths in pixels above 10"),
        ({"cameraMatrix1": None}, "expected the camera matrices of"),
        ({"distCoeffs1": np.zeros((1, 6))}, "4, 5, 8, 12 or 14 distortion coefficients"),
        ({"distCoeffs1": np.full((1, 12), 0.01)}, "thin prism"),
        ({"distortion_model": "omni"}, "expected a lens model"),
    ]:  # fmt: skip
        files = opencv(**changes)
        assert str(files[0]) in str(refused(said, read_stereo, files))


def test_a_damaged_file_is_refused_in_one_line_that_names_it(tmp_path):
    for text in [
        "", "- 1\n- 2\n", "? [a, b]\n: 1\n", "M1: {rows: -1, data: []}\n",
        "%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 3\n   cols: 3\n   data: [1, 2",
        "%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 3\n   cols: 3\n   data: [1, 2]\n",
        "%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: -1\n   cols: x\n   data: [1, 2]\n",
        "a: &a {b: *a}\n", "rows: 1\ncols: 1\ndata: [1.0]\n", "<?xml version='1.0'?><robot/>",
        "<?xml version='1.0'?><opencv_storage><M1>", '{"M1": ', "[" * 200_000,
        "a: " + "{b: " * 50_000, "".join(f"{' ' * depth}a:\n" for depth in range(3000)),
        '{"M1": ' * 100_000,
        "<opencv_storage>" + "<a>" * 100_000 + "1" + "</a>" * 100_000 + "</opencv_storage>",
    ]:  # fmt: skip
        path = tmp_path / "pair.yml"
        path.write_text(text, encoding="utf-8")
        refused(r"pair\.yml", read_stereo, [path])


def test_files_that_are_missing_or_do_not_belong_together_are_refused(tmp_path, opencv, one):
    refused("No such file", read_stereo, [tmp_path / "none.yml"])
    (path,) = opencv()
    refused("twice", read_stereo, [path, path])
    other = write_opencv(tmp_path / "other.yml", {"T": 2.0 * T})
    refused(r"other\.yml: T: expected what .*pair", read_stereo, [path, other])
    files = [*info_pair(tmp_path), camchain(tmp_path / "camchain.yaml")]
    unused = r"(left|right)\.yaml, \S*(right|left)\.yaml: expected .*camchain\.yaml"
    for read, given in [(read_stereo, files), (read_stereo, files[::-1]), (read_intrinsics, files)]:
        refused(unused, read, given)
    alone = [camera_info(path, 0) for path in files[:2]]
    refused("calibration of both cameras together", read_stereo, alone)
    text = camera_info(tmp_path / "both.yaml", 0).read_text("utf-8")
    refused("the key 'image_width' twice", read_intrinsics, one(text))
    for name, again in (("a.json", '{"K": 1, "K": 2}'), ("a.xml", "<K>1</K><K>2</K>")):
        text = f"<opencv_storage>{again}</opencv_storage>" if name == "a.xml" else again
        (tmp_path / name).write_text(text, "utf-8")
        refused("the key 'K' twice", read_intrinsics, [tmp_path / name])
    chain = camchain(tmp_path / "three.yaml")
    text = chain.read_text("utf-8")
    chain.write_text(text + text.partition("cam1:")[2].join(["cam2:", ""]), "utf-8")
    values = {f"K{i}": K_LEFT for i in range(3)} | {"size": SIZE}
    for path in (chain, written(tmp_path / "three.json", values)):
        refused("0, 1, 2", read_intrinsics, [path])
        refused("0, 1, 2", read_stereo, [path])


def test_a_calibration_of_part_of_the_image_is_refused(one):
    for more, said in [
        ("binning_x: 2\nbinning_y: 2\n", "binning_x: .* got binning 2 x 2: set both to 1"),
        ("binning_x: 0\nbinning_y: 4\n", "binning_y: .* got binning 1 x 4: set both to 1"),
        ("roi: {x_offset: 0, y_offset: 9, height: 48, width: 64}\n", r"64 x 48 px at \(0, 9\): se"),
        ("roi:\n  x_offset: 16\n", r"roi\.x_offset: .* a region of 640 x 480 px at \(16, 0\)"),
        ("binning_x: two\n", "binning_x: expected a number of pixels"),
        ({"image_size": [480, 640]}, r"that of 640 x 480: is .* rows by columns\?"),
    ]:
        refused(said, read_intrinsics, one(more))
    for more in (
        "binning_x: 0\nbinning_y: 0\n", {"image_size": None, "shape": [480, 640, 3]},
        "roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: true}\n",
        "roi: {x_offset: 0, y_offset: 0, height: 480, width: 640, do_rectify: false}\n",
    ):  # fmt: skip
        with named(more):
            left = read_intrinsics(one(more)).left
            assert (left.width, left.height) == SIZE


def test_what_is_odd_is_accepted_with_a_word(opencv):
    turned = np.diag([-1.0, -1.0, 1.0])
    far = "principal point ({}) far from the middle of 1280 x 960 px: was the camera calib"
    for changes, said in [
        ({"T": np.array([-0.01, 0.1, 0.0])}, ["one above the other: N is turned"]),
        ({"T": np.array([-0.1, 0.09, 0.0])}, []),
        ({"R": turned @ R, "T": turned @ T}, ["turned by 180 degrees about its optical axis"]),
        # a calibration of other images
        ({"image_width": 1280, "image_height": 960},
         [f"left camera: {far.format('322, 246')}", f"right camera: {far.format('315, 240')}"]),
        # numbers that nothing reads need not be finite
        ({"perViewReprojectionErrors": np.array([0.1, np.nan, np.inf])}, []),
    ]:  # fmt: skip
        guesses = read_stereo(opencv(**changes)).guesses
        with named(changes, guesses):
            assert all(part in guess for part, guess in zip(said, guesses, strict=True))


def test_a_value_that_changes_the_meaning_of_others_is_refused_by_name(one):
    for more, said in [
        ({"xi": 1.27}, "xi: .* an omnidirectional lens"),
        ({"mirror_parameters": {"xi": 0.9}}, r"mirror_parameters\.xi: .* an omnidirectional lens"),
        ({"alpha": 0.6, "beta": 1.1}, "alpha: .* skew, or a lens of another model"),
        ({"alpha_c": 0.001}, "alpha_c: .* skew"), ({"mirror": True}, "mirror: .* mirrored images"),
        ({"flip_left": "horizontal"}, "flip_left: .* mirrored images"),
        ({"rotate": 180}, "rotate: .* turned images"),
        ({"camera_model": "omni", "distortion_model": "radtan"}, "camera_model: .* got 'omni'"),
        ({"model_type": "MEI"}, "model_type: .* got 'MEI'"),
        ({"model": "double_sphere"}, "model: .* not supported"),
        ({"lens_type": "FOV"}, "lens_type: .* not supported"),
        ({"fisheye": True, "distortion_model": "plumb_bob"}, "fisheye and .* one lens model"),
    ]:  # fmt: skip
        refused(said, read_intrinsics, one(more))
    for more in ({"xi": 0.0}, {"alpha": -1}, {"mirror": False}, {"flip": "none"}, {"skew": 0}):
        with named(more):
            assert read_intrinsics(one(more)).guesses == ()
    # keys that nothing reads
    more = {"camera_model": "OmniVision OV2311", "image_scale": 2, "rms": 0.2, "k1": 0.1}
    files = one(more | {"R1": np.eye(3)})
    unread = ", ".join(f"{files[0]}: {key}" for key in ("camera_model", "image_scale", "k1"))
    (guess,) = read_intrinsics(files).guesses
    assert guess.endswith(unread)


def test_poses_of_both_cameras_at_a_body_place_them(tmp_path):
    body = np.eye(4)  # of the left camera, in the body
    body[:3, :3], body[:3, 3] = R.T @ R.T, [0.02, -0.3, 0.1]
    poses = [body, body @ np.linalg.inv(RIGHT_FROM_LEFT)]
    for key, values in [
        ("T_BS", poses), ("T_cam_imu", [np.linalg.inv(pose) for pose in poses]),
        ("T_imu_cam", poses), ("body_T_cam", poses),
    ]:  # fmt: skip
        with named(key):
            eyes = zip(EYES, values, strict=True)
            cameras = [{"size": SIZE, "K": k, "D": d, key: pose} for (_, k, d), pose in eyes]
            one = {f"cam{i}": camera for i, camera in enumerate(cameras)}
            if key == "body_T_cam":
                one |= {f"{key}{i}": camera.pop(key) for i, camera in enumerate(cameras)}
            else:
                files = [written(tmp_path / f"{i}.json", cameras[i]) for i in range(2)]
                check(read_stereo(files), atol=1e-9)
            check(read_stereo([written(tmp_path / "one.json", one)]), atol=1e-9)


def test_a_format_that_is_not_read_is_named_with_those_that_are(tmp_path):
    for text, program in [
        ("[LEFT_CAM_HD]\nfx=700.1\n[RIGHT_CAM_HD]\nfx=700.1\n[STEREO]\nBaseline=62\n", "ZED"),
        ("# oST version 5.0 parameters\n\n\n[image]\n\nwidth\n640\n", "oST"),
        ("1 PINHOLE 640 480 500.0 500.0 320 240\n", "COLMAP"),
        ('{"batchName": "", "cameraData": [[1, {"cameraType": 0}]]}', "OAK"),
        ('{"width": 640, "fx": 600, "fy": 600, "ppx": 320, "ppy": 240}', "RealSense"),
        ("%YAML:1.0\nmodel_type: PINHOLE\nprojection_parameters:\n   fx: 461\n", "camodocal"),
        ("fc = [ 657.46 ; 657.95 ];\ncc = [ 303.13 ; 242.56 ];\n", "MATLAB"),
        ("<?xml version='1.0'?>\n<calibration>\n<f>3000</f></calibration>", "Agisoft"),
    ]:
        path = tmp_path / "calibration.txt"
        path.write_text(text, encoding="utf-8")
        said = rf"{program}.* not read: .*OpenCV .*ROS .*kalibr .*EuRoC .*ORB-SLAM2"
        refused(said, read_intrinsics, [path])
