"""What is searched fits the controllers."""

from vergence.controllers.controller import CONTROLLERS, make_controller
from vergence.eval.trials.scenarios import load_scenario
from vergence.eval.tuning.spaces import SEARCH_SPACES, first_point, is_grid
from vergence.models.files.head_file import load_head


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
        first = first_point(name, spans)
        if first is not None:
            make_controller(name, load_scenario("workspace").model(), **first)
    assert first_point("ibvs", SEARCH_SPACES["ibvs"]) == {"gain": 4.0}
    assert first_point("adaptive", SEARCH_SPACES["adaptive"]) is not None


def test_the_gain_is_searched_on_a_grid_of_at_most_a_twentieth():
    spans = SEARCH_SPACES["ibvs"]
    assert is_grid(spans)
    assert spans["gain"].step <= 0.05
