"""Error budgets and ITPC off the axis."""

import numpy as np
import pandas as pd
import pytest

from vergence.eval.article.error_budget import (
    ALL,
    ENCODERS,
    BudgetCase,
    budget_rows,
    crossover_px,
    detector_rows,
    off_axis_rows,
)
from vergence.eval.article.reported import static_points
from vergence.eval.trials.twin_errors import TWIN_SPREADS

POINTS = static_points("physical")[::5]


def case(nominal):
    return BudgetCase(nominal, TWIN_SPREADS.scaled(0.5), 15, POINTS, 0)


def budget(nominal, source):
    rows = budget_rows(case(nominal), source)
    return rows["rms_depth_error_percent"].to_numpy()


def test_the_encoders_cost_what_a_rounded_vergence_does(nominal):
    # two pans, each spread evenly over a step; seen from the side the baseline is shorter, and
    # the line of sight oblique: 1 / cos^2
    eyes = nominal.camera_poses(nominal.rest())[:, :3, 3]
    line = POINTS - eyes.mean(axis=0)
    vergence = nominal.sensor.encoder_resolution_rad * np.sqrt(2.0 / 12.0)
    cosine = line[:, 2] / np.hypot(line[:, 0], line[:, 2])
    depth = 100.0 * line[:, 2] * vergence / (eyes[1, 0] - eyes[0, 0]) / cosine**2
    assert np.allclose(budget(nominal, ENCODERS), depth, rtol=0.2)


def test_a_vergence_error_grows_with_depth_and_a_shifted_camera_s_does_not(nominal):
    turned, shifted = budget(nominal, "head_eye_rad"), budget(nominal, "head_eye_m")
    assert (np.diff(turned) > 0.0).all()
    assert turned[-1] / turned[0] == pytest.approx(POINTS[-1, 2] / POINTS[0, 2], rel=0.15)
    assert shifted[-1] == pytest.approx(shifted[0], rel=0.3)


@pytest.mark.slow
def test_the_sources_add_in_squares_to_all(nominal):
    many = BudgetCase(nominal, TWIN_SPREADS.scaled(0.3), 400, POINTS, 0)
    depth = {
        s: budget_rows(many, s)["rms_depth_error_percent"].to_numpy()
        for s in (ALL, "head_eye_rad", "principal_px", "joint_offset_rad", "head_eye_m",
                  "link_m", "coaxiality_rad", "common_tilt", ENCODERS)
    }  # fmt: skip
    whole = depth.pop(ALL)
    # 400 heads give an rms to 1/sqrt(800), and their sources are correlated by 1/sqrt(400)
    assert np.allclose(np.sqrt(sum(d**2 for d in depth.values())), whole, rtol=0.15)


def test_the_detector_s_budget_is_that_of_a_disparity(nominal):
    ahead = np.array([[0.0, 0.0, 1.0]])
    rows = detector_rows(nominal, ahead, np.full((1, 2, 2), 0.1), "noise")
    expected = 100.0 * 0.1 * np.sqrt(2.0) / 521.5 / 0.092
    assert rows["rms_depth_error_percent"].iloc[0] == pytest.approx(expected, rel=0.05)


def test_on_the_axis_itpc_is_gaze(nominal):
    rows = off_axis_rows(case(nominal), ALL, (0.0, 200.0), 2.01)
    on, off = rows.iloc[0], rows.iloc[1]
    assert on["itpc_rms_percent"] == on["gaze_rms_percent"]
    assert on["added_rms_percent"] == 0.0
    assert on["excess_share"] == 0.0
    assert off["added_rms_percent"] > 0.1
    assert off["gaze_rms_percent"] == pytest.approx(on["gaze_rms_percent"])


def test_focal_errors_spoil_itpc_in_proportion_to_the_offset(nominal):
    rows = off_axis_rows(case(nominal), "focal_relative", (100.0, 200.0), 2.01)
    assert (rows["gaze_rms_percent"] < 1e-9).all()
    ratio = rows["itpc_rms_percent"].iloc[1] / rows["itpc_rms_percent"].iloc[0]
    assert ratio == pytest.approx(2.0, rel=0.1)


def curve(gaze, itpc):
    return pd.DataFrame(
        {"offset_px": [0.0, 100.0, 200.0], "gaze_rms_percent": gaze, "itpc_rms_percent": itpc}
    )


def test_the_crossover_lies_where_itpc_is_worse_by_the_margin():
    grown = [float(np.sqrt(1.0 + (px / 100.0) ** 2)) for px in (0.0, 100.0, 200.0)]
    # 1.05^2 = 1 + (px / 100)^2
    expected = 100.0 * np.sqrt(1.05**2 - 1.0)
    assert crossover_px(curve([1.0] * 3, grown), 0.05) == pytest.approx(expected)
    assert crossover_px(curve([0.0] * 3, [0.0, 1.0, 2.0]), 0.05) == 0.0
    assert crossover_px(curve([1.0] * 3, [1.0, 0.9, 0.8]), 0.05) == np.inf
