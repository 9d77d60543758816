"""Play, harmonics of encoders and axes that D-H lacks: found where they are, and nowhere else."""

import numpy as np
import pytest

import vergence
from vergence.calibration.head.adjust import HeadAdjustment, MeasurementWeights, ReadingErrorTerms
from vergence.calibration.head.calibrate import calibrate_head
from vergence.calibration.head.fit import parameter_prior_sigma
from vergence.calibration.head.report import head_file_text
from vergence.calibration.head.simulated import JointReadingErrors, simulate_recording
from vergence.calibration.head.terms import AUTO, dh_to_joint_axes, parse_terms, with_backlash
from vergence.errors import ConfigurationError
from vergence.eval.trials.twin_errors import TWIN_ERRORS
from vergence.models.geometry import JointAxes
from vergence.models.head_file import head_to_toml, parse_head

STEP = 1e-6
HEAD = vergence.load_head("physical")
TRUE = HEAD.perturbed(np.random.default_rng(5), TWIN_ERRORS)
PLAY = JointReadingErrors(backlash_rad=np.deg2rad([0.2, 0.1, 0.2, 0.2, 0.3, 0.2, 0.1]))
WAVES = JointReadingErrors(
    harmonics_rad=np.deg2rad(0.2) * np.random.default_rng(8).standard_normal((7, 4))
)
FEW = {"target": "checkerboard:4x3:60", "poses": 14, "frames_per_pose": 3}


def recorded(true=TRUE, faults=None):
    rng = np.random.default_rng(8)
    return simulate_recording(HEAD, true, rng, reading_errors=faults, **FEW).frames


def turned():
    """The true head with one tilt axis 0.3 degrees about the vertical beside where it may be."""
    true = dh_to_joint_axes(TRUE)
    names, _, values = true.parameters()
    aside = np.deg2rad(0.3) * (np.array(names) == "left.1.ry")
    return true.with_parameters(values + aside)


FAULTS = {"play": (TRUE, PLAY), "harmonics": (TRUE, WAVES), "axes": (turned(), None)}


@pytest.fixture(scope="module")
def knowing():
    """Calibrations of a head by its fault, with its term; the axes are chosen."""
    terms = {"play": ("play",), "harmonics": ("harmonics",), "axes": (AUTO,)}
    return {one: calibrate_head(HEAD, recorded(*FAULTS[one]), terms=terms[one]) for one in FAULTS}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["physical", "icub"])
def test_derivatives_by_the_rules_numbers_are_those_of_differences(name):
    head = vergence.load_head(name).replace(sensor={"encoder_resolution_rad": 0.0})
    if head.actuators is not None:
        head = head.replace(actuators={"encoder_resolution_rad": np.zeros(head.actuation.count)})
    seen = simulate_recording(head, head, np.random.default_rng(1), poses=6, frames_per_pose=2)
    terms = ReadingErrorTerms.of_frames(head, seen.frames, ("play", "harmonics"))
    problem = HeadAdjustment(head, parameter_prior_sigma(head), seen.frames, terms=terms)
    assert not problem.reading_error_unknowns.has_frame_error.any()  # so that no errors follow
    values = np.random.default_rng(2).uniform(0.001, 0.01, len(terms.names))
    start, weights = problem.start(seen.boards), MeasurementWeights.of(seen.frames.seen)

    def normal(values):
        return problem.linearised(start._replace(term_parameters=values), weights)

    p = problem.common_count - len(values)
    slope = normal(values).gradient[p : problem.common_count]
    ways = np.random.default_rng(3).standard_normal((3, len(values)))  # of all numbers at once
    differences = [normal(values + s).cost - normal(values - s).cost for s in STEP * ways]
    np.testing.assert_allclose(ways @ slope, np.divide(differences, 4.0 * STEP), rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("term", "true"), [("play", PLAY.backlash_rad), ("harmonics", WAVES.harmonics_rad.ravel())]
)
def test_a_term_is_what_was_put_in(knowing, term, true):
    found = knowing[term].terms
    away = [(each.value - value) / each.sigma for each, value in zip(found, true, strict=True)]
    assert np.abs(away).max() < 3.0
    assert 0.5 < np.sqrt(np.mean(np.square(away))) < 1.7


@pytest.mark.slow
def test_a_tilt_axis_is_where_it_is(knowing):
    found = knowing["axes"]
    q = HEAD.rest()
    axes = [
        (head.link_poses(q) @ np.linalg.inv(head.link_poses(q + 0.1 * (np.arange(7) == 3))))[0]
        for head in (found.head, turned(), HEAD)
    ]
    lines = [np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) for R in axes]
    found_axis, true_axis, file_axis = (line / np.linalg.norm(line) for line in lines)
    assert np.linalg.norm(found_axis - true_axis) < 0.1 * np.linalg.norm(file_axis - true_axis)


@pytest.mark.slow
@pytest.mark.parametrize("fault", [pytest.param("play", marks=pytest.mark.nightly), "axes"])
def test_what_frames_call_for_is_chosen_and_nothing_else(knowing, fault):
    found = knowing[fault]
    if fault == "play":
        found = calibrate_head(HEAD, recorded(*FAULTS[fault]), terms=(AUTO,))
    assert found.solution.problem.scatter_ratio.max() == 1.0
    assert set(found.solution.problem.terms.kinds) == {fault} - {"axes"}
    assert isinstance(found.head.links, JointAxes) == (fault == "axes")
    assert ("D-H numbers lack" in "; ".join(found.remarks)) == (fault == "axes")


@pytest.mark.nightly
def test_harmonics_that_frames_call_for_are_said_as_no_file_holds_them():
    found = calibrate_head(HEAD, recorded(*FAULTS["harmonics"]), terms=(AUTO,))
    assert found.solution.problem.scatter_ratio.max() > 1.5
    assert found.terms == ()
    assert not isinstance(found.head.links, JointAxes)
    assert "off by harmonics" in found.remarks[0]
    assert "--terms harmonics estimates them" in found.remarks[0]


@pytest.mark.slow
def test_a_head_that_its_numbers_describe_has_the_terms_that_are_asked_for_alone():
    found = calibrate_head(HEAD, recorded(), terms=(AUTO,))
    assert found.terms == ()
    assert not isinstance(found.head.links, JointAxes)
    found = calibrate_head(HEAD, recorded(), terms=("play", "axes"), estimate_cameras=False)
    assert len(found.terms) == 7
    assert all(abs(each.value) < 3.0 * each.sigma for each in found.terms)
    assert isinstance(found.head.links, JointAxes)
    np.testing.assert_array_equal(found.head.cameras.focal, HEAD.cameras.focal)


@pytest.mark.slow
def test_play_goes_into_the_file_and_the_rest_is_said(knowing):
    found = knowing["play"]
    head = parse_head(head_file_text(found, "0" * 64, "mine"))
    eyes = found.solution.state.term_parameters[3:]
    assert head.sensor.backlash_rad == pytest.approx(eyes.max())
    assert head.sensor.encoder_side == "motor"
    said = "; ".join(found.remarks)
    assert "the greatest of the eyes' for all" in said
    assert "no place for that of the neck" in said
    assert "encoders" not in said
    waves = knowing["harmonics"]
    assert "corrected by the terms of result.json" in "; ".join(waves.remarks)
    assert waves.head.sensor == HEAD.sensor


def test_play_of_actuators_is_theirs():
    head = vergence.load_head("icub")
    play = np.array([0.0, 0.0, 0.0, 0.001, 0.0, 0.003, 0.0])
    np.testing.assert_array_equal(with_backlash(head, play).actuation.backlash, play)


def test_terms_are_said_in_a_word():
    assert parse_terms("none") == ()
    assert parse_terms("auto") == (AUTO,)
    assert parse_terms("play,axes") == ("play", "axes")
    for wrong in ("", "plays", "auto,play", "none,play"):
        with pytest.raises(ConfigurationError, match="expected none, auto, or some of play"):
            parse_terms(wrong)


def test_a_head_by_its_axes_is_the_same_head_and_goes_into_a_file_and_back():
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 7))
    found = dh_to_joint_axes(HEAD)
    np.testing.assert_allclose(found.camera_poses(q), HEAD.camera_poses(q), atol=1e-12)
    np.testing.assert_allclose(found.base_pose(q), HEAD.base_pose(q), atol=1e-12)
    assert (found.joints, found.actuation.direct) == (HEAD.joints, True)
    for name in ("lower", "angle_step"):
        own, same = (getattr(head.actuation, name) for head in (found, HEAD))
        np.testing.assert_array_equal(own, same)
    assert parse_head(head_to_toml(found)) == found
    icub = vergence.load_head("icub")
    assert dh_to_joint_axes(icub) is icub  # it has axes already
    # a tilt by its axis can be turned about the vertical
    names, _, values = found.parameters()
    turned_head = found.with_parameters(values + 0.01 * (np.array(names) == "left.1.ry"))
    moved, still = (head.camera_poses(np.zeros(7))[0, :3, :3] for head in (turned_head, HEAD))
    assert abs((moved @ still.T)[2, 0]) == pytest.approx(np.sin(0.01))
