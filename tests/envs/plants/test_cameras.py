"""The cameras: their own clock, faults of images, and images that are drawn for a posture."""

import itertools

import numpy as np
import pytest

from tests.envs.plants.trajectory import motion_of, swing
from tests.envs.trials import AHEAD, assert_uniform, begin, pixels_of, start_of, steps
from tests.naming import named
from vergence import HeadModel
from vergence.envs.plant import make_plant
from vergence.envs.plants.cameras import BoardImageRenderer
from vergence.envs.streams import RandomStreams, StreamPurpose
from vergence.envs.targets.motion import motion_rows
from vergence.errors import ConfigurationError
from vergence.vision.targets import make_planar_target

STAMPED = {"exposure_stamps": True, "exposure_s": 0.0}
LATENCY_S = 0.0437
RATES = [(120, 15.0), (120, 47.3), (120, 60.0), (50, 120.0), (250, 60.0)]
CLOCK = {"frame_phase": 0.37, "clock_drift": 0.003}


def looped(head: HeadModel, control_hz: float, frame_hz: float, **timing) -> HeadModel:
    """The head in a loop of other rates, its exposures stamped."""
    own = {"control_rate_hz": control_hz, "frame_rate_hz": frame_hz, "latency_s": LATENCY_S}
    return head.replace(timing={**STAMPED, **own, **timing})


def frame_at(step: int, head: HeadModel, phase: float, drift: float) -> tuple[int, float]:
    """The newest frame that can be read at a step, and when it was exposed."""
    frame_s = (1.0 + drift) / head.timing.frame_rate_hz
    age_s = step * head.timing.period_s - head.timing.latency_s
    frame = int(np.floor(age_s / frame_s - phase + 1e-9))
    return frame, (phase + frame) * frame_s


def test_a_reading_has_the_newest_frame_of_a_clock_of_its_own(exact) -> None:
    for control_hz, frame_hz in RATES:
        with named(control_hz, frame_hz):
            head = looped(exact, control_hz, frame_hz)
            plant = make_plant("kinematic", head, 1, **CLOCK)
            readings, _q, _v = steps(plant, start_of(), int(1.5 * control_hz))
            first, _time_s = frame_at(0, head, 0.37, 0.003)
            for step, reading in enumerate(readings):
                frame, exposed_s = frame_at(step, head, 0.37, 0.003)
                assert reading.exposure_s == pytest.approx([exposed_s], abs=1e-12)
                assert reading.received_s == pytest.approx([exposed_s + LATENCY_S], abs=1e-12)
                assert reading.visible.all() == (exposed_s >= 0.0)
                assert reading.frame[0] == frame - first


@pytest.mark.parametrize(
    ("plant_name", "within_px", "control_hz", "frame_hz"),
    [("kinematic", 1e-6, 120, 47.3), ("kinematic", 1e-6, 250, 60.0), ("mujoco", 0.02, 50, 120.0)],
)
def test_an_image_shows_the_posture_of_its_own_instant(
    exact, control_hz, frame_hz, plant_name, within_px
) -> None:
    head, count = looped(exact, control_hz, frame_hz), int(0.6 * control_hz)
    commands = swing(count, head.timing.period_s, 0.8)
    own = {"neck": "welded"} if plant_name == "mujoco" else {}
    plant = make_plant(plant_name, head, 1, **CLOCK, **own)
    readings, _q, _v = steps(plant, start_of(), count, lambda k: commands[k])
    motion, seen = motion_of(head, commands), 0
    if plant_name == "mujoco":  # whose time step is a quarter of the control period
        within_px *= max(1.0, 100.0 / control_hz)
    for step, reading in enumerate(readings):
        _frame, exposed_s = frame_at(step, head, 0.37, 0.003)
        if exposed_s < 0.0:
            continue
        expected = pixels_of(head, motion(exposed_s)[0], np.zeros(7))
        assert reading.pixels[0] == pytest.approx(expected, abs=within_px)
        seen += 1
    assert seen > 20
    # the eyes move by so much within a period that another instant would show
    moved = head.project(motion(0.3)[0], AHEAD) - head.project(motion(0.3 + 1e-3)[0], AHEAD)
    assert np.abs(moved).max() > 0.2


def test_cameras_run_from_before_the_trial(exact) -> None:
    # a late image of a slow camera: what is read at time zero was exposed long before it
    head = looped(exact, 120, 10.0, latency_s=0.25)
    plant = make_plant("kinematic", head, 1, frame_phase=0.5)
    before = (0.05, -0.1, 1.0)
    reading = plant.begin(start_of(before=before))
    assert reading.exposure_s == pytest.approx([-0.25], abs=1e-12)
    assert reading.visible.all()
    assert reading.pixels == pytest.approx(head.project(np.zeros((1, 7)), before), abs=1e-9)


def test_heads_of_a_batch_have_clocks_of_their_own(exact) -> None:
    head = looped(exact, 120, 60.0)
    hz, phase, drift = [20.0, 63.0, 110.0], [0.1, 0.5, 0.9], [0.0, -0.002, 0.01]
    options = {"frame_rate_hz": hz, "frame_phase": phase, "clock_drift": drift}
    readings, _q, _v = steps(make_plant("kinematic", head, 3, **options), start_of(3), 100)
    for i in range(3):
        alone = head.replace(timing={"frame_rate_hz": hz[i]})
        for step, reading in enumerate(readings):
            _frame, exposed_s = frame_at(step, alone, phase[i], drift[i])
            assert reading.exposure_s[i] == pytest.approx(exposed_s, abs=1e-12)


@pytest.mark.parametrize(
    ("plant_name", "within_px", "frame_hz", "share"),
    [("kinematic", 1e-6, 47.3, 0.99), ("mujoco", 0.02, 200.0, 0.5)],
)
def test_the_right_eye_sees_what_is_there_one_skew_later(
    exact, plant_name, within_px, frame_hz, share
) -> None:
    head, count = looped(exact, 120, frame_hz), 70
    skew_s, commands = share / frame_hz, swing(count, 1 / 120)
    own = {"neck": "welded"} if plant_name == "mujoco" else {}
    plant = make_plant(plant_name, head, 1, skew_s=skew_s, **CLOCK, **own)
    readings, _q, _v = steps(plant, start_of(before=AHEAD), count, lambda k: commands[k])
    motion, start = motion_of(head, commands), np.zeros(7)
    apart = []
    for reading in readings:
        left_s = float(reading.exposure_s[0])
        assert reading.received_s == pytest.approx([left_s + skew_s + LATENCY_S], abs=1e-12)
        left, right = (pixels_of(head, motion(t)[0], start) for t in (left_s, left_s + skew_s))
        assert reading.pixels[0, 0] == pytest.approx(left[0], abs=within_px)
        assert reading.pixels[0, 1] == pytest.approx(right[1], abs=within_px)
        apart.append(np.abs(left[1] - right[1]).max())
        # the newest pair that can have come
        frame_s = (1.0 + CLOCK["clock_drift"]) / frame_hz
        assert reading.time_s[0] - reading.received_s[0] < frame_s
    assert max(apart) > 1.0


SEED = 3
POINT, VELOCITY = np.array([0.05, -0.1, 0.9]), np.array([0.3, -0.1, 0.2])
COMMAND = [0.4, 0.0, -0.2, 1.0, -1.5, 0.8, 1.2]
PERIODS = 20
VIEW = {"board": "tag", "facing": "forward", "width_rad": "fit"}


def frame_noise(period: int) -> np.random.Generator:
    """The generator of the frame that is exposed at the end of a period of the first trial."""
    streams = RandomStreams(1)
    streams.start(np.arange(1), np.full(1, SEED, np.uint64), np.zeros(1, np.uint64))
    return streams.generator_at(0, StreamPurpose.IMAGE, 2 * period)


def views_of(head) -> BoardImageRenderer:
    own = {name: value for name, value in VIEW.items() if name != "board"}
    return BoardImageRenderer(head, make_planar_target("tag"), **own)


def worst_grey(ours, theirs) -> int:
    """The greatest difference of grey levels in both eyes."""
    return max(
        int(np.abs(a.astype(int) - b.astype(int)).max()) for a, b in zip(ours, theirs, strict=True)
    )


@pytest.fixture
def seen(physical):
    """A plant after some periods in which the head, its eyes and the board have moved."""
    plant = make_plant("rendered", physical, 1, **VIEW)
    start = start_of(point=POINT, seed=SEED)
    begin(plant, start._replace(motions=motion_rows(POINT, velocity=VELOCITY)))
    for _ in range(PERIODS):
        plant.step(np.array([COMMAND]))
    return plant


@pytest.mark.slow
def test_eyes_in_motion_see_what_the_rendered_plant_shows(physical, seen):
    truth = seen.truth()
    q, v, point = truth.positions[0], truth.velocities[0], truth.target[0]
    turned = np.linalg.inv(physical.base_pose(q)) @ physical.base_pose(np.zeros(7))
    velocity = turned[:3, :3] @ VELOCITY
    views = views_of(physical)
    drawn = views.draw(q, v, point, frame_noise(PERIODS), velocity)
    assert worst_grey(drawn, seen.frames()) <= 1
    for still in ((np.zeros(7), velocity), (v, np.zeros(3))):
        drawn = views.draw(q, still[0], point, frame_noise(PERIODS), still[1])
        assert worst_grey(drawn, seen.frames()) > 5


def test_where_there_is_no_target_the_background_is_plain(physical):
    views = views_of(physical)
    views.draw(np.zeros(7), np.zeros(7), POINT)
    assert views.board_in_image == (True, True)
    for image in views.draw(np.zeros(7), np.ones(7), [np.nan] * 3):
        assert np.ptp(image) == 0
    assert views.board_in_image == (False, False)


def test_a_board_that_fits_looks_equally_large_near_and_far(physical):
    widths = []
    for away in (1.0, 3.0):
        left, _right = views_of(physical).draw(np.zeros(7), np.zeros(7), away * POINT)
        widths.append(np.ptp(np.flatnonzero((left != left[0, 0]).any(axis=0))))
    assert widths[0] == pytest.approx(widths[1], abs=3)
    assert widths[0] > 50


def test_the_true_eyes_see_a_board_that_fits_the_model(physical):
    true = physical.replace(cameras={"focal": 1.1 * physical.cameras.focal})
    target = make_planar_target("tag")
    of_model = BoardImageRenderer(physical, target, width_rad="fit").board
    fitted = BoardImageRenderer(true, target, width_rad="fit", model=physical).board
    assert fitted.true_size_distance_m == of_model.true_size_distance_m


def test_a_board_with_axes_of_its_own_is_drawn_by_them(physical):
    views = BoardImageRenderer(physical, make_planar_target("checkerboard"), facing="forward")
    level = [image.copy() for image in views.draw(np.zeros(7), np.zeros(7), POINT)]
    rolled = np.diag([-1.0, -1.0, 1.0])
    same = [image.copy() for image in views.draw(np.zeros(7), np.zeros(7), POINT, axes=np.eye(3))]
    turned = views.draw(np.zeros(7), np.zeros(7), POINT, axes=rolled)
    assert worst_grey(level, same) == 0
    assert worst_grey(level, turned) > 50


def test_an_unknown_facing_is_refused(physical):
    with pytest.raises(ConfigurationError, match="facing: expected 'head' or 'forward', got 'up'"):
        BoardImageRenderer(physical, make_planar_target("tag"), facing="up")


NUM, COUNT = 64, 160


def seen_in(head: HeadModel, **faults: object):
    """(images, 2) visibility and (images, 2, 2) px less where the target is, once it is there."""
    plant = make_plant("kinematic", head, NUM, **faults)
    readings, _q, _v = steps(plant, start_of(NUM), COUNT)
    visible, pixels = [], []
    for last, now in itertools.pairwise(readings):
        new = (now.frame != last.frame) & (now.exposure_s > -1e-9)
        visible.append(now.visible[new])
        pixels.append(now.pixels[new])
    off = np.concatenate(pixels) - head.project(np.zeros(7), AHEAD)
    return np.concatenate(visible), off


def test_each_eye_misses_the_target_by_itself(exact) -> None:
    p = 0.15
    seen, off = seen_in(exact, missed_detection_probability=p)
    sigma = np.sqrt(p * (1.0 - p) / len(seen))
    assert len(seen) == NUM * (COUNT - 8 + 1)  # the images come all the same
    assert (~seen).mean(axis=0) == pytest.approx([p, p], abs=4 * sigma)
    both = (~seen).all(axis=1).mean()
    assert both == pytest.approx(p * p, abs=4 * np.sqrt(p * p / len(seen)))
    assert np.array_equal(np.isnan(off).any(axis=-1), ~seen)


def test_outliers_are_as_many_and_as_far_off_as_said(exact) -> None:
    p, most = 0.1, 80.0
    seen, off = seen_in(exact, outlier_probability=p, outlier_px=most)
    assert seen.all()
    away = np.linalg.norm(off, axis=-1)
    hit = away > 1e-9
    assert hit.mean(axis=0) == pytest.approx([p, p], abs=4 * np.sqrt(p * (1 - p) / len(hit)))
    # an eye's outlier says nothing of the other's
    assert hit.all(axis=1).mean() == pytest.approx(p * p, abs=4 * p / np.sqrt(len(hit)))
    assert_uniform(away[hit] / most)
    around = np.arctan2(off[..., 1], off[..., 0])[hit] / (2.0 * np.pi) % 1.0
    assert_uniform(around)


def test_faults_before_time_zero_are_as_frequent(exact) -> None:
    before, num = (0.05, -0.1, 1.0), 4000
    plant = make_plant("kinematic", exact, num, missed_detection_probability=0.2)
    reading = plant.begin(start_of(num, before=before))
    assert (~reading.visible).mean() == pytest.approx(0.2, abs=4 * np.sqrt(0.16 / (2 * num)))


def test_false_detections_last_and_hold_their_offset(exact) -> None:
    rate, most, chance, px = 30.0, 6, 0.004, 80.0
    options = {
        "false_detection_probability": chance,
        "false_detection_s": most / rate,
        "false_detection_px": px,
    }
    head = exact.replace(timing={"frame_rate_hz": rate})
    plant = make_plant("kinematic", head, NUM, **options)
    readings, _q, _v = steps(plant, start_of(NUM), 1200)
    new = [b for a, b in itertools.pairwise(readings) if (b.frame != a.frame).all()]
    new = [one for one in new if one.visible.all()]
    off = np.array([one.pixels for one in new]) - head.project(np.zeros(7), AHEAD)
    off[np.abs(off) < 1e-9] = 0.0
    sizes = np.linalg.norm(off, axis=-1)
    offsets, images, eyes, same = [], 0, np.zeros(3), 0
    for n in range(NUM):
        runs = [
            (list(there), pair)
            for pair, there in itertools.groupby(off[:, n], key=lambda a: a.round(9).tobytes())
            if np.frombuffer(pair).any()
        ]
        for there, _pair in runs:
            left, right = (there[0][eye].any() for eye in range(2))
            eyes[2 if left and right else int(right)] += 1
            same += left and right and bool(np.allclose(there[0][0], there[0][1], atol=1e-6))
            offsets += [a for a in there[0] if a.any()]
            images += len(there)
            assert len(there) <= most
    count = eyes.sum()
    # max(1, rint(most u)) frames each; a few begin in the midst of another
    mean = np.maximum(np.rint(most * (np.arange(10000) + 0.5) / 10000), 1).mean()
    assert images / (len(new) * NUM) == pytest.approx(chance * mean, rel=0.15)
    assert eyes / count == pytest.approx(np.full(3, 1 / 3), abs=4 * np.sqrt(2 / 9 / count))
    assert same / eyes[2] == pytest.approx(0.5, abs=4 * 0.5 / np.sqrt(eyes[2]))
    assert_uniform(np.linalg.norm(offsets, axis=1) / px)
    assert sizes.max() <= px + 1e-9
