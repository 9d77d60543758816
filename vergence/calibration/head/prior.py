"""Prior of a head's parameters: standard deviations from its file, before any measurement."""

from typing import Final

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.models.perturbation import ModelErrors, standard_deviations

PRIOR: Final = ModelErrors(
    # errors of lengths from a ruler and a drawing
    link_m=0.003,
    head_eye_m=0.005,
    # bent or printed brackets
    coaxiality_rad=np.deg2rad(1.0).item(),
    # a servo horn fits its spline in steps of 15 degrees; the error after it was set by eye
    joint_offset_rad=np.deg2rad(3.0).item(),
    head_eye_rad=np.deg2rad(3.0).item(),
    focal_relative=0.05,
    principal_px=20.0,
    distortion=0.1,
)
"""Prior standard deviations (chosen: they matter only for directions that the recording does not
determine)."""
_COEFFICIENT_SIGMA: Final = {"p1": 0.005, "p2": 0.005}
"""Prior standard deviations of lens coefficients, by name (chosen)."""
_OTHER_COEFFICIENT_SIGMA: Final = 0.1
"""Prior standard deviation of other lens coefficients (chosen)."""


def parameter_prior_sigma(head: HeadModel, estimate_cameras: bool = True) -> FloatArray:
    """(p,) prior sigmas of parameters; cameras' from the head's record if any, or 0: fixed."""
    names = head.parameters().names
    spreads = standard_deviations(head.geometry, PRIOR)
    record = head.calibration
    for place, name in enumerate(names):
        own = name.rpartition(".")[2]
        if ".camera." not in name:
            continue
        if spreads[place] == 0.0:
            spreads[place] = _COEFFICIENT_SIGMA.get(own, _OTHER_COEFFICIENT_SIGMA)
        if record is not None and name in record.sigma:
            spreads[place] = record.sigma[name]
        if not estimate_cameras:
            spreads[place] = 0.0
    return spreads
