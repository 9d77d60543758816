"""Search spaces fit their controllers."""

import pytest

from vergence.controllers.controller import CONTROLLERS, make_controller
from vergence.errors import ConfigurationError, UnknownNameError
from vergence.eval.trials.scenarios import load_scenario
from vergence.eval.tuning.spaces import (
    SEARCH_SPACES,
    default_point,
    has_single_stepped_option,
    search_space,
)
from vergence.models.head_file import load_head


def test_every_search_space_is_of_options_that_its_controller_has():
    head = load_head("simulated")
    for name in SEARCH_SPACES.keys() & CONTROLLERS.keys():
        spans = SEARCH_SPACES[name]
        for end in ("low", "high"):
            make_controller(name, head=head, **{k: getattr(s, end) for k, s in spans.items()})
        for span in spans.values():
            assert span.low < span.high
            assert span.scale == "linear" or (span.low > 0.0 and span.step is None)


def test_a_controllers_own_options_are_the_point_to_improve_on():
    for name, spans in SEARCH_SPACES.items():
        first = default_point(name, spans)
        if first is not None:
            make_controller(name, load_scenario("workspace").model(), **first)
    assert default_point("ibvs", SEARCH_SPACES["ibvs"]) == {"gain": 4.0}
    assert default_point("adaptive", SEARCH_SPACES["adaptive"]) is not None


def test_the_gain_is_searched_on_a_grid_of_at_most_a_twentieth():
    spans = SEARCH_SPACES["ibvs"]
    assert has_single_stepped_option(spans)
    assert spans["gain"].step <= 0.05


def test_a_controller_with_one_set_of_options_is_not_tuned_and_that_is_said():
    for name in ("pursuit", "saccade"):
        with pytest.raises(ConfigurationError, match=rf"got '{name}', which runs in every"):
            search_space(name)


def test_what_is_no_controller_is_not_tuned():
    with pytest.raises(UnknownNameError, match="controller to tune: expected one of adaptive"):
        search_space("persuit")
