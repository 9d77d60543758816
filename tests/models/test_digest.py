"""The digest in its versioned form: a head keeps it, whatever the code's fields are called."""

import dataclasses
import os
import subprocess
import sys

import pytest

from tests.heads import text_of
from tests.models.lenses import wide
from vergence.models import parse_head


def test_the_presets_keep_the_digests_that_bundles_and_tuned_options_name(simulated, physical):
    for head, digest in [
        (simulated, "a2ab725a9b004002cdf8a148ac1ee224722901d3a91846794c649ad30453cc12"),
        (physical, "906730e6530f5a5a8c0f2f656a0eadef2b0222584ca9b835a51f567b913d4518"),
    ]:
        assert head.digest == digest


def test_what_rounding_leaves_of_a_latency_or_a_pose_is_no_other_head(simulated):
    # a decimal's rounding makes no other head
    same = simulated.replace(timing={"latency_s": 0.066666666666667})
    assert same.digest == simulated.digest
    between = simulated.replace(timing={"latency_s": 0.0708})
    nearest = simulated.replace(timing={"latency_s": between.timing.latency_frames / 120.0})
    assert between.digest not in (simulated.digest, nearest.digest)
    head = parse_head(text_of("panfirst"))
    for nudge, same in ((1e-16, True), (1e-9, False)):
        links = dataclasses.replace(head.links, pose=head.links.pose + nudge)
        assert (dataclasses.replace(head, links=links).digest == head.digest) is same


def test_the_digest_of_other_cameras_is_of_the_same_form_ever_after(physical):
    same = physical.replace(cameras={"size": (640, 480), "lens": "brown-conrady"})
    assert same.digest == physical.digest
    digest = wide("fisheye", "rational").digest
    assert digest != wide("rational", "fisheye").digest
    assert digest == "16ccd2facc796eefe3d8f773451b155001714bc6ce039ca9b970d93a784375c7"


@pytest.mark.nightly
def test_a_head_is_the_same_on_another_processor():
    # OpenBLAS, which NumPy comes with on most machines, sums as the processor likes best
    tilted = "axis = [0.0131, 0.9987, -0.0271]\nrpy_rad = [0.013, -0.02, 0.041]"
    text = text_of("panfirst").replace("axis = [0.0, 1.0, 0.0]", tilted)
    assert text.count("0.0131") == 2
    code = "import sys, vergence.models as m; print(m.parse_head(sys.stdin.read()).digest)"
    run = subprocess.run(
        [sys.executable, "-c", code], input=text, text=True, capture_output=True, check=True,
        env=os.environ | {"OPENBLAS_CORETYPE": "Prescott"},
    )  # fmt: skip
    assert run.stdout.split() == [parse_head(text).digest]
