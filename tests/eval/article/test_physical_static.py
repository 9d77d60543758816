"""Static targets before the physical twin, run small."""

import numpy as np
import pytest

from tests.eval.article.checks import section_text
from tests.eval.article.small_twin import scaled, small, table_of, verdict_of
from tests.eval.refusals import not_refused
from vergence.errors import ConfigurationError
from vergence.eval.article.experiment import load_experiment
from vergence.reporting.jobs import SerialMapper

pytestmark = pytest.mark.slow
EXPERIMENT = load_experiment("physical-static")
CONFIG = small(EXPERIMENT.name)


@pytest.fixture(scope="module")
def table():
    return table_of(EXPERIMENT.name)


def fixes(table):
    return table[(table["case"] == "fixation") & (table["group"] == "population")]


@pytest.mark.nightly
def test_at_settled_fixations_the_methods_differ_by_the_noise_of_the_images_alone():
    table = EXPERIMENT.run(small(EXPERIMENT.name, settle_s=2.0), 0, SerialMapper())
    wide = fixes(table).pivot(index="head", columns=["method", "point"], values="error_z_mm")
    apart = (wide["gaze"] - wide["itpc"]).abs()
    noise = table[table["source"] == "one image's noise"].set_index("point")
    sigma = noise["rms_depth_error_percent"] / 100.0 * noise["truth_z_mm"]
    sigma /= np.sqrt(CONFIG.samples)
    # the median of a normal deviate's size is 0.67 of its sigma; a mean of pixels is one
    assert 0.3 < (apart / sigma).median(axis=None) < 1.2


@pytest.mark.nightly
def test_the_head_with_images_errs_as_it_does_without(table):
    imaged = table[(table["case"] == "fixation") & (table["group"] == "imaged")]
    assert (imaged["seen_share"] == 1.0).all()
    keys = ["head", "point", "method"]
    both = imaged.merge(fixes(table), on=keys, suffixes=("_imaged", "_plain"))
    assert len(both) == len(imaged)
    # vertical errors do not depend on the vergence, which an encoder's step moves
    apart = (both["error_y_mm_imaged"] - both["error_y_mm_plain"]).abs()
    step = 2.0 * np.deg2rad(360.0 / 4096.0) * both["truth_z_mm_plain"]
    assert (apart < step).all()


APART = "gaze and ITPC apart in depth at settled fixations"


def test_only_large_differences_at_settled_fixations_explain_the_article_s(table):
    assert verdict_of(EXPERIMENT.summarise(table, CONFIG), APART, "both") == "differs"
    apart = scaled(table, "error_z_mm", 1e4, table["method"] == "itpc")
    (row,) = (row for row in EXPERIMENT.summarise(apart, CONFIG) if row.quantity == APART)
    assert row.ours_high > row.article_high
    assert EXPERIMENT.numbers(apart, CONFIG)["apart_most_mm"] > 124.0


OFF_AXIS = "rms depth error of ITPC 200 px off the axis less that of gaze"


def test_the_verdict_on_itpc_off_the_axis_follows_its_error(table):
    whole = (table["case"] == "off axis") & (table["source"] == "all")
    table = table.copy()
    away = whole & (table["offset_px"] > 0.0)
    table.loc[whole, "itpc_rms_percent"] = table.loc[whole, "gaze_rms_percent"]
    for factor, verdict in {3.0: "ITPC worse", 1.0: "alike", 0.5: "ITPC better"}.items():
        changed = scaled(table, "itpc_rms_percent", factor, away)
        rows = EXPERIMENT.summarise(changed, CONFIG)
        assert verdict_of(rows, f"{OFF_AXIS}, all errors", "both") == verdict


def test_errors_that_vanish_on_the_axis_make_itpc_worse(table):
    rows = EXPERIMENT.summarise(table, CONFIG)
    for source in ("focal lengths", "distortion"):
        assert verdict_of(rows, f"{OFF_AXIS}, {source}", "both") == "ITPC worse"


def test_the_text_has_the_numbers_of_the_table_and_a_dash_for_none(table):
    numbers = EXPERIMENT.numbers(table, CONFIG)
    own = fixes(table).query("method == 'gaze'")
    largest = (own["error_z_mm"].abs() / own["truth_z_mm"]).groupby(own["head"]).max()
    assert numbers["largest_median_percent"] == pytest.approx(100.0 * largest.median())
    assert numbers["reported_count"] == 8
    assert f"{100.0 * largest.median():.2f} %" in section_text(EXPERIMENT, table, CONFIG).found
    level = table.assign(itpc_rms_percent=table["gaze_rms_percent"])
    assert "from – px on" in section_text(EXPERIMENT, level, CONFIG).found


def test_errors_that_cannot_be_are_refused():
    cases = [
        ({"tilt_deg": 1.0}, "physical-static.errors.tilt_deg: expected one of link_m"),
        ({"link_m": -1.0}, "link_m: expected a standard deviation >= 0"),
        ({"link_m": "much"}, "physical-static.errors.link_m"),
        (0.1, "physical-static.errors: expected values by field"),
    ]
    assert not_refused(lambda errors: small("physical-static", errors=errors), cases) == []
    with pytest.raises(ConfigurationError, match="offsets_px: expected one beyond the axis"):
        small("physical-static", offsets_px=[0.0])
