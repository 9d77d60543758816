"""The experiments on the physical twin, run small: tables, summaries, conclusions and figures."""

import numpy as np
import pandas as pd
import pytest

from vergence.eval.article.experiment import load_experiment, resolve_config
from vergence.eval.article.fixed_pair.experiment import FixedPairConfig, pair_head
from vergence.eval.article.fixed_pair.findings import explain
from vergence.eval.article.fixed_pair.findings import reported as pair_reported
from vergence.eval.article.reported import reported_results, static_points
from vergence.eval.jobs import ProcessMapper, SerialMapper
from vergence.triangulation import triangulate_views

SMALL = {"heads": 4, "scale": 0.4, "noise_poses": 1, "noise_frames": 3}
TINY = {
    "physical-static": {"imaged_every": 10, "samples": 4, "offsets_px": [0.0, 200.0]},
    "physical-moving": {"speed_m_s": 0.5, "settle_s": 0.5, "table_every": 4},
    "fixed-pair": {"samples": 4, "settle_s": 0.5},
}  # fmt: skip
REPORTED = {
    "physical-static": "physical static",
    "physical-moving": "physical moving",
    "fixed-pair": "versus ZED Mini",
}
NAMES = sorted(TINY)


def config_of(name):
    return resolve_config(load_experiment(name), SMALL | TINY[name], quick=True)


@pytest.fixture(scope="module")
def tables():
    return {n: load_experiment(n).run(config_of(n), 0, SerialMapper()) for n in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_two_processes_give_the_same_table_bit_for_bit(name, tables):
    again = load_experiment(name).run(config_of(name), 0, ProcessMapper(2))
    pd.testing.assert_frame_equal(tables[name], again, check_exact=True)


@pytest.mark.parametrize("name", NAMES)
def test_another_seed_gives_other_heads(name, tables):
    again = load_experiment(name).run(config_of(name), 1, SerialMapper())
    assert not again.equals(tables[name])


@pytest.mark.parametrize("name", NAMES)
def test_the_summary_has_every_row_of_the_article(name, tables):
    rows = load_experiment(name).summarise(tables[name], config_of(name))
    ours = {(r.experiment, r.quantity, r.method, r.axis, r.article_low, r.article_high): r
            for r in rows}  # fmt: skip
    for r in reported_results():
        if r.experiment == REPORTED[name]:
            found = ours[(r.experiment, r.quantity, r.method, r.axis, r.low, r.high)]
            assert np.isfinite([found.ours_low, found.ours_high]).all()
            assert found.ours_low <= found.ours_high
            assert found.verdict in {"reproduced", "smaller", "larger", "other"}
            assert found.unit == "mm"


@pytest.mark.parametrize("name", NAMES)
def test_no_panel_of_a_figure_is_empty(name, tables):
    figures = load_experiment(name).draw(tables[name], config_of(name))
    assert figures
    for figure in figures.values():
        for panel in figure.axes:
            assert panel.has_data()
            assert panel.get_xlabel()


def fixes(table):
    return table[(table["case"] == "fixation") & (table["group"] == "population")]


def test_at_settled_fixations_the_methods_differ_by_the_noise_of_the_images_alone(tables):
    table = tables["physical-static"]
    wide = fixes(table).pivot(index="head", columns=["method", "point"], values="error_z_mm")
    apart = (wide["gaze"] - wide["itpc"]).abs()
    noise = table[table["source"] == "one image's noise"].set_index("point")
    sigma = noise["rms_depth_error_percent"] / 100.0 * noise["truth_z_mm"]
    sigma /= np.sqrt(config_of("physical-static").samples)
    # the median of a normal deviate's size is 0.67 of its sigma; a mean of pixels is one
    assert 0.3 < (apart / sigma).median(axis=None) < 1.2


def test_the_head_with_images_errs_as_it_does_without(tables):
    table = tables["physical-static"]
    imaged = table[(table["case"] == "fixation") & (table["group"] == "imaged")]
    assert (imaged["seen_share"] == 1.0).all()
    keys = ["head", "point", "method"]
    both = imaged.merge(fixes(table), on=keys, suffixes=("_imaged", "_plain"))
    assert len(both) == len(imaged)
    # vertical errors do not depend on the vergence, which an encoder's step moves
    apart = (both["error_y_mm_imaged"] - both["error_y_mm_plain"]).abs()
    step = 2.0 * np.deg2rad(360.0 / 4096.0) * both["truth_z_mm_plain"]
    assert (apart < step).all()


def test_gaze_trails_a_moving_target_by_its_velocity_over_the_gain():
    config = resolve_config(
        load_experiment("physical-moving"), SMALL | {"heads": 20, "settle_s": 2.0}, quick=True
    )
    table = load_experiment("physical-moving").run(config, 0, SerialMapper())
    own = table[(table["case"] == "head") & (table["group"] == "population")]
    wide = own.pivot(index="head", columns="method", values="mean_x_mm")
    velocity = np.array(config.end_mm) - np.array(config.origin_mm)
    velocity *= 1000.0 * config.speed_m_s / np.linalg.norm(velocity)
    trail = (wide["gaze"] - wide["itpc"]).median()
    # on a still target both are the same; the encoders round away half a step at most
    assert trail == pytest.approx(-velocity[0] / 4.0, rel=0.15)


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
    for r in pair_reported():
        if r.axis in ("x", "y"):
            m = explain(r, place_z)
            apart = np.abs(np.deg2rad(m.with_shift_deg) * depth + m.shift_mm)
            assert apart.min() == pytest.approx(r.low)
            assert apart.max() == pytest.approx(r.high)


def test_an_unknown_pose_of_the_pair_moves_all_points_alike(tables):
    own = tables["fixed-pair"]
    own = own[own["case"] == "fix"].pivot(
        index=["draw", "point"], columns="method", values="error_y_mm"
    )
    shift = (own["misaligned"] - own["pair"]).unstack()
    assert (shift.abs().max(axis=1) > 1.0).any()
    assert (shift.std(axis=1) < 0.5 * shift.abs().max(axis=1)).all()


def scaled(table, column, factor, rows):
    changed = table.copy()
    changed.loc[rows, column] *= factor
    return changed


@pytest.mark.parametrize(
    ("name", "case", "column"),
    [
        ("physical-static", "fixation", "error_z_mm"),
        ("physical-static", "off axis", "itpc_rms_percent"),
        ("physical-moving", "head", "mean_abs_z_mm"),
        ("fixed-pair", "fix", "error_x_mm"),
    ],
)
def test_conclusions_follow_the_numbers(name, case, column, tables):
    experiment, config, table = load_experiment(name), config_of(name), tables[name]
    other = scaled(table, column, 30.0, table["case"] == case)
    assert experiment.conclude(table, config) != experiment.conclude(other, config)


def test_a_better_head_than_pair_is_said_so(tables):
    experiment, config = load_experiment("fixed-pair"), config_of("fixed-pair")
    table = tables["fixed-pair"]
    worse = scaled(table, "error_z_mm", 1000.0, table["method"] == "pair")
    assert "the head is" in experiment.conclude(worse, config)
    better = scaled(table, "error_z_mm", 1e-3, table["method"] == "pair")
    assert "in depth the pair is" in experiment.conclude(better, config)


def test_large_differences_at_settled_fixations_would_be_believed(tables):
    experiment, config = load_experiment("physical-static"), config_of("physical-static")
    table = tables["physical-static"]
    assert "cannot come from settled fixations" in experiment.conclude(table, config)
    apart = scaled(table, "error_z_mm", 1e4, (table["method"] == "itpc"))
    assert "could come from settled fixations" in experiment.conclude(apart, config)
