"""Findings from the table of uncertainties."""

import pandas as pd
import pytest

from vergence.eval.article.uncertainty.findings import cramer_rao_bounds_px


def test_a_bound_is_the_root_of_the_mean_square_over_images():
    rows = [
        {"part": "bound", "depth_mm": depth, "quantity": quantity, "value": scale * value}
        for depth, scale in ((500.0, 1.0), (1000.0, 2.0))
        for quantity, values in (("board", (3.0, 4.0)), ("window", (6.0, 8.0)))
        for value in values
    ]
    found = cramer_rao_bounds_px(pd.DataFrame(rows))
    assert found["board"].tolist() == pytest.approx([12.5**0.5, 2.0 * 12.5**0.5])
    assert (found["window"] == 2.0 * found["board"]).all()
