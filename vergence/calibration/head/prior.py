"""How far a head's numbers may be from what its file says, before anything is measured."""

from typing import Final

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.models.perturbation import ModelErrors, standard_deviations

PRIOR: Final = ModelErrors(
    # what a ruler and a drawing leave
    link_m=0.003,
    head_eye_m=0.005,
    # brackets that are bent or printed
    coaxiality_rad=np.deg2rad(1.0).item(),
    # a horn sits on its spline by steps of 15 degrees; what is left after it was set by eye
    joint_offset_rad=np.deg2rad(3.0).item(),
    head_eye_rad=np.deg2rad(3.0).item(),
    focal_relative=0.05,
    principal_px=20.0,
    distortion=0.1,
)
"""Standard deviations. They matter only for what the recording does not tell."""
_COEFFICIENTS: Final = {"p1": 0.005, "p2": 0.005}
_OTHER_COEFFICIENTS: Final = 0.1


def spreads_of(head: HeadModel, cameras: bool = True) -> FloatArray:
    """(p,) deviations of a head's numbers from its file, in the order of `HeadModel.parameters`.

    Args:
        head: the head.
        cameras: whether the cameras may be otherwise, too; if not, theirs are 0.
    """
    names = head.parameters().names
    spreads = standard_deviations(head.geometry, PRIOR)
    record = head.calibration
    for place, name in enumerate(names):
        own = name.rpartition(".")[2]
        if ".camera." not in name:
            continue
        if spreads[place] == 0.0:
            spreads[place] = _COEFFICIENTS.get(own, _OTHER_COEFFICIENTS)
        if record is not None and name in record.sigma:
            spreads[place] = record.sigma[name]
        if not cameras:
            spreads[place] = 0.0
    return spreads
