"""The plants with dynamics, with and without images, move heads that are not the article's."""

import numpy as np
import pytest

from tests.envs.any_head import begun, least_squares, uneven
from tests.heads import head_of


@pytest.mark.slow
@pytest.mark.parametrize(("plant", "name"), [("mujoco", "common"), ("rendered", "mis")])
def test_a_vector_of_any_head_settles(plant, name) -> None:
    head = head_of(name)
    task = begun(head, 2, plant=plant)
    for _ in range(120):
        task.step(least_squares(task, 5.0))
    truth = task.truth()
    left = truth.pixel_error - head.least_error(truth.target)
    assert np.abs(left).max() < 1.5
    assert head.reaches(truth.positions).all()
    task.close()


def test_images_of_different_sizes_are_drawn_and_looked_at() -> None:
    head = uneven("tied")
    task = begun(head, 1, plant="rendered")
    left, right = task.plant.frames(0)
    assert left.shape == (240, 320)
    assert right.shape == (360, 640)
    for _ in range(120):
        task.step(least_squares(task, 5.0))
    assert np.abs(task.truth().pixel_error).max() < 1.5
    task.close()
