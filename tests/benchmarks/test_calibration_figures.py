"""The picture of a calibration: four figures of its report, side by side."""

import numpy as np
import pytest

from benchmarks.calibration_figures import panels, tiled
from tests.calibration.rigs import as_calibrated, look, make_poses, make_rig


@pytest.mark.nightly
def test_no_quarter_of_the_picture_is_empty():
    rng = np.random.default_rng(0)
    rig, poses = make_rig(), make_poses(rng, 12)
    picture = np.asarray(tiled(panels(as_calibrated(rig, poses, look(rig, poses, rng)))))
    middle = np.array(picture.shape[:2]) // 2
    for rows in (slice(None, middle[0]), slice(middle[0], None)):
        for columns in (slice(None, middle[1]), slice(middle[1], None)):
            assert np.ptp(picture[rows, columns]) == 255
