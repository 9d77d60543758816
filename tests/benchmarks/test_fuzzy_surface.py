"""The picture of the fuzzy gains is made by one command, and no panel of it is empty."""

import numpy as np

from benchmarks.fuzzy_surface import draw_surfaces
from vergence import load_head, make_controller


def test_every_gain_has_a_panel_with_a_surface() -> None:
    fuzzy = make_controller("fuzzy", head=load_head("simulated"), span_i=1.0)
    panels = [axes for axes in draw_surfaces(fuzzy, points=21).axes if axes.get_title()]
    assert len(panels) == 3
    for panel in panels:
        shown = panel.collections[0].get_array()
        assert shown is not None
        assert np.ptp(shown) > 0.0
