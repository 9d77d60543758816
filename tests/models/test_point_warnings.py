"""Points and errors that are hardly meant so: millimetres, degrees, and beyond the limits."""

import warnings

import numpy as np
import pytest

from tests.grids import some_of
from tests.naming import named
from vergence.errors import ConfigurationError, VergenceWarning
from vergence.models.head_file import load_head
from vergence.models.perturbation import ModelErrors

HEADS = ["simulated", "physical", "icub", "turrets"]


def test_a_point_in_millimetres_is_asked_about_and_answered():
    for name in HEADS:
        with named(name):
            head, point = load_head(name), [100.0, -100.0, 800.0]
            asked = r"points.*\(100, -100, 800\).*in millimetres\?"
            with pytest.warns(VergenceWarning, match=asked) as said:
                q = head.fixate(point)
            assert len(said) == 1
            assert said[0].filename == __file__, "the line of the caller"
            np.testing.assert_array_equal(q, head.fixate([point])[0])


def test_angles_beyond_the_limits_are_said_by_name():
    points = [(0.1, 0.0, -1.0), (0.0, -2.0, 0.5), (0.0, 2.0, 0.5)]
    for name, point in some_of(["simulated", "icub"], points):
        with named(name, point):
            head = load_head(name)
            q = head.fixate([point])[0]
            assert not head.reaches(q)
            own = "|".join(head.actuation.names)
            with pytest.warns(VergenceWarning, match=rf"({own}) would be at .* degrees, outside"):
                head.fixate(point)


def test_what_a_head_looks_at_or_a_program_judges_is_not_asked_about(simulated):
    for name, distance in some_of(HEADS, [0.5, 20.0, 1e6, np.inf]):
        with named(name, distance), warnings.catch_warnings():
            warnings.simplefilter("error")
            load_head(name).fixate([0.0, 0.0, distance])
    head = load_head("turrets")
    assert head.reaches(head.fixate([0.1, 0.0, -1.0]))
    # 0.15 m between the eyes times 6000 px by 800 m is a disparity of 1.1 px
    head = head.replace(cameras={"focal": np.full((2, 2), 6000.0)})
    assert head.reaches(head.fixate([0.0, 0.0, 800.0]))
    # programs that judge the angles themselves
    simulated.fixate([0.1, 0.0, -1.0], warn=False)
    for head in (simulated, load_head("icub")):
        head.least_error([0.1, 0.0, -1.0])
    assert np.isfinite(simulated.fixate([[100.0, -100.0, 800.0], [0.1, 0.0, -1.0]])).all()


def test_an_error_in_degrees_or_millimetres_or_below_zero_is_refused():
    degrees, millimetres = r"radians.*is it in degrees\?", r"metres.*is it in millimetres\?"
    for name, value, said in [
        ("joint_offset_rad", 5.7, degrees), ("common_tilt_rad", 1.4, degrees),
        ("head_eye_rad", 1.0, degrees), ("link_m", 0.5, millimetres),
        ("head_eye_m", 0.5, millimetres),
        *(("principal_px", value, ">= 0") for value in (-1.0, np.nan, np.inf)),
    ]:  # fmt: skip
        with named(name, value), pytest.raises(ConfigurationError, match=f"{name}.*{said}"):
            ModelErrors(**{name: value})
    # ten degrees, and a centimetre: what no calibration has seen
    ModelErrors(joint_offset_rad=0.17, head_eye_rad=0.17, link_m=0.01, head_eye_m=0.01)
