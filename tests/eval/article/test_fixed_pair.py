"""The head against a fixed pair of cameras, run small."""

import numpy as np
import pytest

from tests.eval.article.checks import section_text
from tests.eval.article.small_twin import scaled, small, table_of, verdict_of
from vergence.eval.article.experiment import load_experiment
from vergence.eval.article.fixed_pair import (
    FixedPairConfig,
    article_results,
    explaining_misalignment,
    pair_head,
)
from vergence.eval.article.reported import static_points
from vergence.triangulation import triangulate_views

EXPERIMENT = load_experiment("fixed-pair")
CONFIG = small(EXPERIMENT.name)


@pytest.fixture(scope="module")
def table():
    return table_of(EXPERIMENT.name)


def test_a_perfect_fixed_pair_finds_the_points():
    pair = pair_head(FixedPairConfig())
    T_N_C = pair.camera_poses(pair.rest())
    assert np.allclose(T_N_C[:, :3, :3], np.eye(3))
    assert T_N_C[1, 0, 3] - T_N_C[0, 0, 3] == pytest.approx(0.063)
    points = static_points("zed_mini")
    fix = triangulate_views(pair, pair.rest(), pair.project(pair.rest(), points))
    assert np.allclose(fix.point, points, atol=1e-9)


def test_the_misalignment_that_is_named_gives_the_article_s_range():
    place_z = 14.0
    depth = 1000.0 * static_points("zed_mini")[:, 2] - place_z
    for r in article_results():
        if r.axis in ("x", "y"):
            m = explaining_misalignment(r, place_z)
            apart = np.abs(np.deg2rad(m.rotation_with_shift_deg) * depth + m.shift_mm)
            assert apart.min() == pytest.approx(r.low)
            assert apart.max() == pytest.approx(r.high)


@pytest.mark.slow
def test_a_turn_of_the_pair_alone_gives_the_article_s_range_in_y_and_not_in_x(table):
    rows = EXPERIMENT.summarise(table, CONFIG)
    turned = {r.axis: r.verdict for r in rows if r.quantity.endswith("by a turn of the pair alone")}
    assert turned == {"x": "differs", "y": "agrees"}


@pytest.mark.slow
def test_an_unknown_pose_of_the_pair_moves_all_points_alike(table):
    own = table[table["case"] == "fix"].pivot(
        index=["draw", "point"], columns="method", values="error_y_mm"
    )
    shift = (own["misaligned"] - own["pair"]).unstack()
    assert (shift.abs().max(axis=1) > 1.0).any()
    assert (shift.std(axis=1) < 0.5 * shift.abs().max(axis=1)).all()


@pytest.mark.slow
def test_the_verdict_names_what_is_nearer_to_the_truth(table):
    quantity = "mean absolute error, median head over median pair"
    for factor, verdict in {1000.0: "head nearer", 1e-3: "pair nearer"}.items():
        changed = scaled(table, "error_z_mm", factor, table["method"] == "pair")
        rows = EXPERIMENT.summarise(changed, CONFIG)
        assert verdict_of(rows, quantity, "gaze") == verdict


def test_differences_within_the_article_s_range_are_counted(table):
    apart = scaled(table, "error_x_mm", 30.0, table["case"] == "fix")
    before, after = (EXPERIMENT.numbers(t, CONFIG) for t in (table, apart))
    assert before["reported_count"] == 8
    assert before["inside_known_count"] != after["inside_known_count"]


def test_the_text_has_the_numbers_of_the_table(table):
    own = table[(table["case"] == "fix") & (table["method"] == "pair")]
    depth = own["error_z_mm"].abs().groupby(own["draw"]).mean().median()
    assert EXPERIMENT.numbers(table, CONFIG)["pair_z_mm"] == pytest.approx(depth)
    text = section_text(EXPERIMENT, table, CONFIG)
    assert f"and {depth:.1f} mm for the median pair" in text.found
    assert "off by 0.02" in text.what
