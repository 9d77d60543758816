"""Faults of images: dropped frames, missed detections of an eye, detections beside the target."""

import itertools

import numpy as np
import pytest

from tests.envs.trials import AHEAD, assert_uniform, start_of, steps
from vergence import HeadModel
from vergence.envs.plant import make_plant

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


def test_nothing_comes_where_all_frames_are_dropped(exact) -> None:
    plant = make_plant("kinematic", exact, 1, dropped_frame_probability=1.0)
    readings, _q, _v = steps(plant, start_of(before=AHEAD), 30)
    for reading in readings:
        assert not reading.visible.any()
        assert reading.frame[0] == 0
        assert np.isnan(reading.exposure_s).all()


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


def test_an_outlier_moves_the_pixel_of_the_eye_that_it_hits_and_no_other(simulated) -> None:
    runs = [
        steps(make_plant("kinematic", simulated, NUM, **faults), start_of(NUM), COUNT)[0]
        for faults in ({}, {"outlier_probability": 0.1, "outlier_px": 80.0})
    ]
    moved = np.array([(a.pixels != b.pixels).any(axis=-1) for a, b in zip(*runs, strict=True)])[8:]
    assert 0.09 < moved.mean() < 0.11
    # noise and all else are what they are without
    assert moved.any(axis=-1).mean() > moved.all(axis=-1).mean() + 0.1


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
