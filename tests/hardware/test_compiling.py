"""Compiling before motors have torque calls the kernels that the loop will call."""

import pytest

from tests.hardware.fakes import HEAD, TAG
from vergence.hardware.compiling import compile_loop_kernels
from vergence.vision.tracking import Tracker


@pytest.mark.slow
def test_preparing_compiles_what_a_target_that_comes_later_needs(monkeypatch):
    seen, find = [], Tracker.find

    def watched(tracker, image, **pose):
        seen.append(find(tracker, image, **pose))
        return seen[-1]

    monkeypatch.setattr(Tracker, "find", watched)
    compile_loop_kernels(HEAD, TAG)
    # both eyes' boards are found and followed, and an image without one is searched
    assert [one is not None for one in seen] == [True, True, False] * 2
