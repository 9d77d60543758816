"""The sensor model and the step: what is seen when, how it is dated, one call for many heads."""

import itertools

import numpy as np
import pytest

from tests.controllers.loops import begin
from tests.envs.trials import AHEAD, assert_uniform, assert_white_normal, pixels_of, start_of, steps
from tests.heads import head_of
from tests.naming import named, refused
from vergence import HeadModel, ModelErrors
from vergence.envs import plants
from vergence.envs.plant import make_plant, simulation_of
from vergence.envs.reading import Reading
from vergence.envs.targets.motion import motion_rows, target_position
from vergence.envs.task import GazeTask
from vergence.eval.trials.scenarios import load_scenario

T = 1 / 120
MOVING = [0.0, 0.0, 0.0, 0.5, 0.4, -0.5, 0.3]


def is_new(reading: Reading) -> np.ndarray:
    """(n,) whether an image came just now."""
    return np.abs(reading.received_s - reading.time_s) < 1e-9


def test_nothing_is_visible_until_the_first_frame_is_readable(exact) -> None:
    readings, _q, _v = steps(make_plant("kinematic", exact, 1), start_of(), 8, MOVING)
    for step, reading in enumerate(readings[:8]):
        # the cameras have been running: there are images, and nothing on them
        assert not reading.visible.any()
        assert np.isnan(reading.pixels).all()
        assert reading.exposure_s == pytest.approx([(step - 8) * T], abs=1e-12)
        assert reading.received_s == pytest.approx(reading.time_s, abs=1e-12)
        assert not reading.positions_at_exposure.any()
    assert readings[8].visible.all()


def test_every_image_belongs_with_the_angles_of_its_own_instant(exact, plant_name) -> None:
    readings, positions, _v = steps(make_plant(plant_name, exact, 1), start_of(), 30, MOVING)
    for step in range(8, 31):
        reading, then = readings[step], positions[step - 8]
        assert reading.exposure_s == pytest.approx([(step - 8) * T], abs=1e-15)
        assert np.array_equal(reading.positions_at_exposure, then)
        assert np.array_equal(reading.positions, positions[step])
        assert reading.pixels == pytest.approx(pixels_of(exact, then, positions[0]), abs=1e-9)


def test_a_step_target_shows_the_scene_before_for_eight_periods(exact) -> None:
    before, after = (0.05, -0.1, 1.0), (0.0, -0.2, 1.0)
    start = start_of(point=after, before=before, positions=exact.fixate(before))
    readings, positions, _v = steps(make_plant("kinematic", exact, 1), start, 10, MOVING)
    held = exact.project(start.positions, before)
    for step, reading in enumerate(readings[:8]):
        assert reading.visible.all()
        assert reading.pixels == pytest.approx(held, abs=1e-9)
        assert reading.exposure_s == pytest.approx([(step - 8) * T], abs=1e-15)
        assert np.array_equal(reading.positions_at_exposure, start.positions)
    jumped = exact.project(positions[0], after)
    assert readings[8].pixels == pytest.approx(jumped, abs=1e-9)
    assert np.abs(jumped - held).max() > 10.0


def test_a_late_image_is_dated_by_its_receipt_less_the_nominal_latency(exact) -> None:
    latencies = np.array([6, 8, 11])
    plant = make_plant("kinematic", exact, 3, latency_s=latencies * T)
    readings, positions, _v = steps(plant, start_of(3), 30, MOVING)
    for i, latency in enumerate(latencies):
        for step, reading in enumerate(readings):
            assert reading.visible[i].all() == (step >= latency)
            assert reading.received_s[i] == pytest.approx(step * T, abs=1e-12)
            assert reading.exposure_s[i] == pytest.approx((step - 8) * T, abs=1e-12)
            if step < latency:
                continue
            # the pixel is that of the true instant, the angles are those of the stamp
            exposed = pixels_of(exact, positions[step - latency, i], positions[0, i])
            assert reading.pixels[i] == pytest.approx(exposed, abs=1e-9)
            stamped = positions[max(step - 8, 0), i]
            assert np.array_equal(reading.positions_at_exposure[i], stamped)


def test_the_frame_counter_changes_with_each_image_and_with_nothing_else(exact) -> None:
    plant = make_plant("kinematic", exact, 16, dropped_frame_probability=0.3)
    readings, _q, _v = steps(plant, start_of(16), 60)
    assert not readings[0].frame.any()
    assert not plant.begin(start_of(16)).frame.any()
    for last, now in itertools.pairwise(readings):
        assert np.array_equal(now.frame - last.frame, is_new(now).astype(np.int64))
    # some 7 of 10 come, those that were exposed before time zero too
    assert 30 < readings[-1].frame.mean() < 54


def test_a_reset_to_other_angles_keeps_the_trials_target_and_noise(simulated) -> None:
    plant = make_plant("kinematic", simulated, 2)
    plant.begin(start_of(2, seed=4))
    first = [plant.step(np.zeros((2, 7))).copy() for _ in range(12)][-1]
    plant.reset(np.arange(2), np.zeros((2, 7)))
    again = [plant.step(np.zeros((2, 7))).copy() for _ in range(12)][-1]
    assert np.array_equal(first.pixels, again.pixels)


def test_a_dropped_frame_leaves_the_one_before_it_which_ages(exact) -> None:
    plant = make_plant("kinematic", exact, 64, dropped_frame_probability=0.3)
    readings, _q, _v = steps(plant, start_of(64), 300, lambda k: np.sin(0.1 * k) * np.array(MOVING))
    arrived = 0
    for before, now in itertools.pairwise(readings):
        new = is_new(now)
        arrived += new.sum()
        kept = ~new
        for field in ("received_s", "exposure_s", "pixels", "positions_at_exposure", "visible"):
            old = getattr(before, field)[kept]
            assert np.array_equal(getattr(now, field)[kept], old, equal_nan=field != "visible")
    # 64 x 300 draws: four of their standard deviations are 0.0132
    assert arrived / (64 * 300) == pytest.approx(0.7, abs=0.0132)


def test_frames_are_dropped_independently_of_each_other(exact) -> None:
    plant = make_plant("kinematic", exact, 64, dropped_frame_probability=0.5)
    readings, _q, _v = steps(plant, start_of(64), 250)
    arrived = np.array([is_new(r) for r in readings[8:]], dtype=float) - 0.5
    # of 64 x 242 products of independent +-1/2, four standard deviations: 4 * 0.25 / 124
    assert abs((arrived[1:] * arrived[:-1]).mean()) < 0.008
    assert abs((arrived[:, 1:] * arrived[:, :-1]).mean()) < 0.008


def test_detection_noise_is_white_normal_and_as_large_as_said(simulated: HeadModel) -> None:
    for given in [None, 0.2]:
        with named(given):
            sigma = simulated.sensor.detection_noise_px if given is None else given
            plant = make_plant("kinematic", simulated, 64, detection_noise_px=given)
            readings, _q, _v = steps(plant, start_of(64), 300)
            pixels = np.array([reading.pixels for reading in readings[8:]])
            noise = (pixels - simulated.project(np.zeros(7), AHEAD)).reshape(293, 64, 4)
            assert_white_normal(noise, sigma)


def test_noise_before_time_zero_is_as_large(simulated: HeadModel) -> None:
    before = (0.0, -0.1, 1.0)
    plant = make_plant("kinematic", simulated, 256)
    readings, _q, _v = steps(plant, start_of(256, (0, 0, 1), before), 7)
    pixels = np.array([reading.pixels for reading in readings])
    noise = pixels - simulated.project(np.zeros(7), before)
    # 8,192 numbers: four standard deviations of theirs are 3.1 %
    assert noise.std() == pytest.approx(simulated.sensor.detection_noise_px, rel=0.032)


def test_encoders_read_the_nearest_of_their_steps(physical: HeadModel) -> None:
    plant = make_plant("kinematic", physical, 1)
    readings, positions, velocities = steps(plant, start_of(), 40, MOVING)
    for name, true, step in (
        ("positions", positions, 2 * np.pi / 4096),
        ("velocities", velocities, physical.sensor.velocity_resolution_rad_s),
    ):
        value = np.array([getattr(reading, name) for reading in readings])
        counts = value / step
        assert np.abs(counts - np.round(counts)).max() < 1e-9
        assert np.abs(value - true).max() <= 0.5 * step + 1e-12
        assert np.unique(counts).size > 5
    for step in range(8, 41):
        assert np.array_equal(readings[step].positions_at_exposure, readings[step - 8].positions)


def smear(head: HeadModel, q, v, exposure_s) -> np.ndarray:
    """(2,) how far a point at rest before a head with its neck at rest moves in each image."""
    ends = [head.project(q + side * 0.5 * exposure_s * v, AHEAD) for side in (-1, 1)]
    return np.linalg.norm(ends[1] - ends[0], axis=-1)


def test_an_eye_sees_nothing_while_the_exposure_smears_the_target(physical, plant_name) -> None:
    head = physical.replace(limits={"acceleration": np.full(7, np.inf)})
    start = start_of(positions=[0, 0, 0, 0, -0.3, 0, 0.3])

    def command(step):  # the left eye passes the target at 6 rad/s; the right one is slow
        return [0, 0, 0, 0, 6.0 if step < 10 else 0.0, 0, -0.5]

    readings, q, v = steps(make_plant(plant_name, head, 1), start, 40, command)
    smears = np.array([smear(head, q[k, 0], v[k, 0], 0.004) for k in range(33)])
    inside = head.project(q[:33, 0], AHEAD)
    in_image = ((inside >= -0.5) & (inside <= np.array([639.5, 479.5]))).all(axis=-1)
    expected = in_image & (smears <= head.sensor.max_smear_px)
    assert in_image.all()
    assert 3 < (~expected[:, 0]).sum() < 20
    assert expected[:, 1].all()
    for step, seen in enumerate(expected):
        assert np.array_equal(readings[step + 8].visible[0], seen)
        assert np.array_equal(np.isnan(readings[step + 8].pixels[0]).any(axis=-1), ~seen)


def test_the_necks_motion_smears_as_the_eyes_does(physical: HeadModel) -> None:
    head = physical.replace(
        limits={"acceleration": np.full(7, np.inf)}, timing={"exposure_s": 0.008, "lag_s": 0.0}
    )
    plant = make_plant("kinematic", head, 1)
    turn = np.eye(7)[0] * 3.0
    readings, _q, _v = steps(plant, start_of(), 20, lambda k: turn * (3 <= k < 6))
    # 3 rad/s in 8 ms are 24 mrad, 12 px
    seen = [reading.visible.all() for reading in readings[8:]]
    assert seen == [not 4 <= frame <= 6 for frame in range(13)]
    # the neck turns left and the eyes turn right by as much: the image stands nearly still
    readings, _q, _v = steps(plant, start_of(), 20, [3.0, 0, 0, 0, -3.0, 0, -3.0])
    assert all(reading.visible.all() for reading in readings[8:])


def test_a_moving_eyes_pixel_is_that_of_the_middle_of_the_exposure(physical: HeadModel) -> None:
    plant = make_plant("kinematic", physical, 1, detection_noise_px=0.0)
    readings, q, v = steps(plant, start_of(), 30, [0, 0, 0, 1, 0.5, -1, 0.5])
    assert smear(physical, q[20, 0], v[20, 0], 0.004).min() > 1.0
    assert readings[28].pixels == pytest.approx(physical.project(q[20], AHEAD), abs=1e-9)


def test_a_target_outside_the_image_or_behind_the_head_is_not_seen(exact: HeadModel) -> None:
    plant = make_plant("kinematic", exact, 2)
    # 41 degrees aside of the left eye is outside its 80 degrees, and well inside the right's
    aside = exact.camera_poses(np.zeros(7))[0, :3, 3] + [np.tan(np.deg2rad(-41.0)), 0.0, 1.0]
    readings, _q, _v = steps(plant, start_of(2, [aside, AHEAD]), 8)
    assert not readings[8].visible[0].any()
    assert readings[8].visible[1].all()
    readings, _q, _v = steps(make_plant("kinematic", exact, 1), start_of(point=(0, 0, -1)), 10)
    assert not any(reading.visible.any() for reading in readings)


def test_the_target_rests_in_the_world_while_the_neck_moves(exact, plant_name) -> None:
    plant = make_plant(plant_name, exact, 1)
    start = start_of(positions=[0.2, -0.1, 0.1, 0, 0, 0, 0])
    world = exact.base_pose(start.positions) @ [*AHEAD, 1.0]
    plant.begin(start)
    before = plant.truth().target.copy()
    for _ in range(40):
        plant.step(np.array([[1.0, -0.5, 0.7, 0.0, 0.0, 0.0, 0.0]]))
        truth = plant.truth()
        again = (exact.base_pose(truth.positions) @ [*truth.target[0], 1.0])[0]
        assert again == pytest.approx(world[0], abs=1e-12)
        assert truth.pixels == pytest.approx(exact.project(truth.positions, truth.target))
    assert before[0] == pytest.approx(AHEAD, abs=1e-12)
    assert np.abs(truth.target - before).max() > 0.1


def test_images_show_where_the_moving_neck_has_carried_the_eyes(exact: HeadModel) -> None:
    plant = make_plant("kinematic", exact, 1)
    readings, q, _v = steps(plant, start_of(), 30, [0.6, 0.3, -0.4, 0.0, 0.0, 0.0, 0.0])
    pixels = pixels_of(exact, q[22], q[0])
    assert np.abs(pixels - exact.project(q[0], AHEAD)).min(axis=0).max() > 30.0
    assert readings[30].pixels == pytest.approx(pixels, abs=1e-9)


def test_truth_is_the_present_without_delay_and_noise(simulated: HeadModel, plant_name) -> None:
    plant = make_plant(plant_name, simulated, 1)
    _r, q, _v = steps(plant, start_of(), 12, MOVING)
    truth = plant.truth()
    pixels = pixels_of(simulated, q[12], q[0])
    assert truth.time_s == pytest.approx([12 * T])
    # the eyes' servos push the neck a little, and N with it
    assert truth.target == pytest.approx(np.array([AHEAD]), abs=1e-4)
    assert truth.pixels == pytest.approx(pixels, abs=1e-9)
    assert truth.pixel_error == pytest.approx(truth.pixels - simulated.cameras.principal)
    assert truth.image_visible.all()


def test_true_heads_look_and_the_model_judges(physical: HeadModel) -> None:
    sizes = {"joint_offset_rad": 0.01, "head_eye_rad": 0.01, "principal_px": 3.0}
    errors = ModelErrors(**sizes, distortion=0.01)
    true = physical.perturbed(np.random.default_rng(4), errors, 5)
    plant = make_plant("kinematic", physical, 5, true_head=true, detection_noise_px=0.0)
    readings, q, _v = steps(plant, start_of(5), 20, [0, 0, 0, 0.2, 0.2, 0.2, 0.2])
    assert readings[20].pixels == pytest.approx(true.project(q[12], AHEAD), abs=1e-9)
    assert np.abs(readings[20].pixels - physical.project(q[12], AHEAD)).max() > 3.0
    truth = plant.truth()
    assert truth.pixels == pytest.approx(true.project(q[20], AHEAD), abs=1e-9)
    seen = physical.undistort(truth.pixels) - physical.cameras.principal
    assert truth.pixel_error == pytest.approx(seen, abs=1e-9)


def test_starting_some_trials_leaves_the_others_as_they_were(simulated) -> None:
    plant = make_plant("mujoco", simulated, 3)
    steps(plant, start_of(3), 20, MOVING)
    before, angles = plant.reading.copy(), plant.truth().positions
    one = start_of(1, (0.1, 0.0, 0.7))
    reading = plant.begin(one._replace(ids=np.array([1])))
    for old, new in zip(before, reading, strict=True):
        assert np.array_equal(old[[0, 2]], new[[0, 2]], equal_nan=old.dtype != np.bool_)
    assert np.array_equal(plant.truth().positions[[0, 2]], angles[[0, 2]])
    assert reading.time_s[1] == 0.0
    assert not reading.visible[1].any()
    assert not plant.truth().velocities[1].any()


def test_options_that_cannot_be_are_refused_by_name(simulated) -> None:
    true = simulated.perturbed(np.random.default_rng(0), ModelErrors(joint_offset_rad=0.01), 3)
    for plant, head, options, message in [
        ("kinematic", simulated, {"latency_s": -0.01},
         "latency_s: expected seconds from 0 to below 1 .*got -0.01"),
        ("kinematic", simulated, {"lag_s": [0.03, np.nan]}, "lag_s: expected seconds"),
        ("kinematic", simulated, {"detection_noise_px": [0.1, 0.1, 0.1]},
         "detection_noise_px: expected a number or 2"),
        ("kinematic", simulated, {"dropped_frame_probability": 1.5},
         "dropped_frame_probability: expected 0 to 1"),
        ("mujoco", simulated, {"lag_s": [0.0, 0.03]}, "lag_s: expected seconds above 0"),
        ("kinematic", simulated, {"true_head": true}, "true_head: expected one head or 2"),
        ("kinematic", true, {}, "head: expected one head"),
        ("kinematic", head_of("tied"), {"true_head": head_of("common")},
         r"true_head: expected actuators .* \(tilt, ver"),
    ]:  # fmt: skip
        refused(message, make_plant, plant, head, 2, **options)


def test_an_image_that_comes_between_two_periods_is_read_at_the_next(exact) -> None:
    head = exact.replace(timing={"latency_s": 8.5 * T})
    readings, positions, _v = steps(make_plant("kinematic", head, 1), start_of(), 30, MOVING)
    assert not readings[8].visible.any()
    for step in range(9, 31):
        reading = readings[step]
        assert reading.received_s == pytest.approx([(step - 0.5) * T], abs=1e-12)
        assert reading.exposure_s == pytest.approx([(step - 9) * T], abs=1e-12)
        exposed = pixels_of(head, positions[step - 9], positions[0])
        assert reading.pixels == pytest.approx(exposed, abs=1e-9)


@pytest.mark.parametrize("plant", ["kinematic", "rendered"])
def test_a_jump_during_the_exposure_does_not_smear_the_first_frame_after_it(plant):
    task = begin(GazeTask(1, head="physical", plant=plant, target="step"))
    for _ in range(8):
        task.step(np.zeros((1, 4)))
    # the frame of time zero: the target has jumped by 100 mm at 1 m, some 52 px
    assert task.reading.exposure_s[0] == 0.0
    assert task.reading.visible.all()
    assert np.abs(task.pixel_error[0, :, 1]).min() > 40.0


NOMINAL_S = 8 * T


@pytest.fixture
def stamped(exact: HeadModel) -> HeadModel:
    """A head whose cameras tell when a frame was exposed."""
    return exact.replace(timing={"exposure_stamps": True})


def arrivals(readings) -> tuple[np.ndarray, np.ndarray]:
    """Exposures and receipts of all images of all heads that came, s."""
    pairs = [
        np.stack([now.exposure_s, now.received_s])[:, now.frame != last.frame]
        for last, now in itertools.pairwise(readings)
    ]
    return tuple(np.concatenate(pairs, axis=1))


def test_lateness_is_uniform_up_to_the_jitter(stamped) -> None:
    jitter_s = 0.006  # less than from one frame to the next: no image waits for another
    plant = make_plant("kinematic", stamped, 32, jitter_s=jitter_s)
    exposed, received = arrivals(steps(plant, start_of(32), 150)[0])
    late = (received - exposed - NOMINAL_S) / jitter_s
    assert late.size > 4000
    assert_uniform(late)


def test_an_image_never_overtakes_one_that_was_exposed_earlier(stamped) -> None:
    jitter_s = 6 * T
    plant = make_plant("kinematic", stamped, 64, jitter_s=jitter_s)
    readings, _q, _v = steps(plant, start_of(64), 300)
    waited = 0
    for last, now in itertools.pairwise(readings):
        assert (now.exposure_s >= last.exposure_s).all()
        assert (now.received_s >= last.received_s).all()
        assert (now.received_s <= now.time_s + 1e-9).all()
        new = now.frame != last.frame
        late = (now.received_s - now.exposure_s - NOMINAL_S)[new]
        assert (late >= -1e-12).all()
        assert (late <= jitter_s + 1e-12).all()
        waited += ((now.frame - last.frame) > 1).sum()
    assert waited > 100  # those that wait come together
    # nothing is lost: of 300 frames those have come that were exposed long enough ago
    due = 300 - 8 - 6 + 8
    assert (readings[-1].frame >= due).all()
    assert (readings[-1].frame <= 300 + 6).all()


def test_a_stamp_is_the_exposure_or_else_the_receipt_less_the_latency(exact, stamped) -> None:
    options = {"latency_s": 0.09, "jitter_s": 0.01, "frame_rate_hz": 50.0, "frame_phase": 0.4}
    turn = [0, 0, 0, 0.4, 0, 0, 0]
    runs = [
        steps(make_plant("kinematic", head, 8, **options), start_of(8), 120, turn)
        for head in (exact, stamped)
    ]
    for dated, true in zip(runs[0][0], runs[1][0], strict=True):
        assert np.array_equal(dated.received_s, true.received_s)
        assert np.array_equal(dated.pixels, true.pixels, equal_nan=True)
        assert dated.exposure_s == pytest.approx(dated.received_s - NOMINAL_S, abs=1e-12)
        frame = true.exposure_s * 50.0 - 0.4
        assert frame == pytest.approx(np.round(frame), abs=1e-9)
    off = np.subtract(*[[reading.exposure_s for reading in run[0]] for run in runs])
    # 90 ms and up to 10 more, where 67 are nominal
    assert off.min() > 0.09 - NOMINAL_S - 1e-9
    assert off.max() < 0.1 - NOMINAL_S + 1e-9
    assert np.ptp(off) > 0.008


def test_angles_at_exposure_lie_between_two_readings_of_the_joints(stamped) -> None:
    head = stamped.replace(timing={"feedback_latency_s": 0.004})
    plant = make_plant("mujoco", head, 1, frame_rate_hz=47.0, frame_phase=0.3)
    way = np.array([0, 0, 0, 0.5, 0.4, -0.5, 0.3])
    readings, _q, _v = steps(plant, start_of(), 90, lambda k: np.sin(0.2 * k) * way)
    told = np.array([reading.positions[0] for reading in readings])
    dates = np.array([reading.joints_s[0] for reading in readings])
    assert dates == pytest.approx(T * np.arange(91) - 0.004, abs=1e-12)
    between = 0
    for reading in readings:
        when = reading.exposure_s[0]
        expected = [np.interp(when, dates, told[:, j]) for j in range(7)]
        assert reading.positions_at_exposure[0] == pytest.approx(expected, abs=1e-12)
        share = (when / T) % 1.0
        between += 0.1 < share < 0.9
    assert between > 40


ONSETS = np.array([0.0, 23 / 120, 0.1375, 0.4])


def test_nothing_is_seen_of_a_target_before_its_onset(exact, plant_name) -> None:
    plant = make_plant(plant_name, exact, 4, onset_s=ONSETS)
    readings, _q, _v = steps(plant, start_of(4), 80)
    for i, onset_s in enumerate(ONSETS):
        dates = np.array([reading.exposure_s[i] for reading in readings])
        seen = np.array([reading.visible[i].all() for reading in readings])
        assert np.array_equal(seen, dates > onset_s - 1e-9)
        first = np.ceil(onset_s / T - 1e-9) * T  # with cameras at the control rate
        assert dates[seen].min() == pytest.approx(first, abs=1e-9)


def test_a_target_that_jumps_stays_where_it_was_until_the_onset(exact, plant_name) -> None:
    before, after = (0.05, -0.1, 1.0), AHEAD
    plant = make_plant(plant_name, exact, 4, onset_s=ONSETS)
    readings, q, _v = steps(plant, start_of(4, after, before), 80)
    held, jumped = (exact.project(np.zeros(7), point) for point in (before, after))
    for reading in readings:
        assert reading.visible.all()
        for i, onset_s in enumerate(ONSETS):
            expected = jumped if reading.exposure_s[i] > onset_s - 1e-9 else held
            assert reading.pixels[i] == pytest.approx(expected, abs=1e-9)
    assert not q.any()
    assert np.abs(held - jumped).max() > 10.0


def test_the_truth_changes_at_the_onset_itself(exact, plant_name) -> None:
    before = (0.05, -0.1, 1.0)
    plant = make_plant(plant_name, exact, 4, onset_s=ONSETS)
    simulation_of(plant).begin(start_of(4, AHEAD, before))
    for step in range(60):
        # 23 periods are not 23 / 120 s to the last bit, but a little less
        there = step * T > ONSETS - 1e-9
        expected = np.where(there[:, None], AHEAD, before)
        assert simulation_of(plant).truth().target == pytest.approx(expected, abs=1e-12)
        plant.step(np.zeros((4, 7)))
    assert simulation_of(plant).onset_s() == pytest.approx(ONSETS, abs=1e-12)


def test_a_moving_targets_time_begins_at_the_onset(exact) -> None:
    onset_s = 0.137
    rows = motion_rows(np.array([AHEAD]), before=np.array([AHEAD]), velocity=(0.2, 0.0, 0.1))
    start = start_of()._replace(motions=rows)
    plant = make_plant("kinematic", exact, 1, onset_s=onset_s)
    readings, q, _v = steps(plant, start, 60)
    for reading in readings:
        point = target_position(rows, max(reading.exposure_s[0] - onset_s, 0.0))[0]
        expected = pixels_of(exact, q[0], q[0], point)
        assert reading.pixels == pytest.approx(expected, abs=1e-5)
    expected = target_position(rows, 60 * T - onset_s)
    assert plant.truth().target == pytest.approx(expected, abs=1e-9)


STEPS = 20
RESET_AFTER = 9
"""Step after which one head begins another trial (chosen: its frames are still on their way)."""


def assert_equal_states(tasks):
    one, other = ({**state["task"], **state["plant"]} for state in (t.state() for t in tasks))
    assert one.keys() == other.keys()
    for name, array in one.items():
        np.testing.assert_array_equal(array, other[name], err_msg=name)


def assert_steps_equal(tasks):
    """Begin trials of both tasks, step them by actions drawn at random, begin one trial anew."""
    rng, num = np.random.default_rng(0), tasks[0].num

    def begin(ids, trial):
        for task in tasks:
            task.begin(ids, np.full(len(ids), 7, np.uint64), np.full(len(ids), trial, np.uint64))
        assert_equal_states(tasks)

    for n in range(num):
        begin(np.array([n]), n)
    start = tasks[0].truth().positions
    for i in range(STEPS):
        action = rng.uniform(-1.5, 1.5, (num, tasks[0].layout.count))
        for task in tasks:
            task.step(action)
        assert_equal_states(tasks)
        if i == RESET_AFTER:
            assert (tasks[0].truth().positions != start).any(axis=1).all()
            begin(np.array([num - 1]), num)


@pytest.mark.parametrize("head", ["simulated", "turrets"])
def test_a_simulation_stepped_inside_is_that_of_the_batch_to_the_bit(head):
    tasks = [GazeTask(1, head=head) for _ in range(2)]
    assert tasks[1].plant._inside
    tasks[1].plant._inside, tasks[1].plant._kept_table = False, None
    assert_steps_equal(tasks)


def states_of(heads: int, **options) -> dict[str, np.ndarray]:
    """All arrays of a batch after some steps, with new trials of a few heads in between."""
    rng, task = np.random.default_rng(0), GazeTask(heads, **options)
    seeds = np.arange(heads, dtype=np.uint64)
    task.begin(np.arange(heads), seeds, np.zeros(heads, np.uint64))
    for step in range(20):
        task.step(rng.uniform(-1.0, 1.0, (heads, task.layout.count)))
        if step == 10:
            some = np.arange(0, heads, 37)
            task.begin(some, seeds[some], np.ones(len(some), np.uint64))
    state = task.state()
    return {**state["task"], **state["plant"]}


@pytest.mark.parametrize(
    ("heads", "options"),
    [
        (80, {"plant": "kinematic"}),
        (80, load_scenario("hardware").env_options()),
        (50, {"plant": "mujoco", "head": "icub"}),
    ],
    ids=str,
)
def test_results_do_not_depend_on_the_number_of_threads(heads, options, monkeypatch):
    states = []
    for count in (1, 3):
        monkeypatch.setattr(plants, "processors", lambda count=count: count)
        states.append(states_of(heads, **options))
    assert len(plants.bounds(heads, 16)) == 4
    for name, array in states[0].items():
        np.testing.assert_array_equal(array, states[1][name], err_msg=name)
