"""Model errors of real heads, estimated from the article's physical head.

The estimate uses the article's own figures. At time zero of section 5.3.2 the target was off the
position that the nominal geometry predicts, by 1.6 and 1.2 degrees of tilt (left, right) and 0.8
and -1.1 degrees of pan. Head-eye calibration removes most of that: in every posture, an offset of
pan equals a rotation of the camera in its eye, so the difference of 1.9 degrees between the two
pans does not reach the triangulated point (0.10 degrees of vergence are 124 mm at 2.5 m).
Calibration cannot remove the common part of the two tilts, 1.4 degrees: both eyes tilt about the
same line, so turning both together leaves the relative pose of the cameras unchanged. Hence there
are two kinds of error: small independent residuals of calibration, and a common tilt. Bending under
load, which the article names too, counts as offsets.
"""

from math import radians
from typing import Final

from vergence.models.perturbation import ModelErrors

TWIN_SPREADS: Final = ModelErrors(
    # tolerance of milled or printed brackets
    link_m=0.0002,
    # 0.1 mm across the 60 mm of an eye's bracket
    coaxiality_rad=radians(0.1),
    # residual of each offset after head-eye calibration: about the encoders' precision
    joint_offset_rad=radians(0.05),
    # typical precision of hand-eye calibration, like the next
    head_eye_rad=radians(0.1),
    head_eye_m=0.0005,
    # 1 px, the uncertainty that calibration toolboxes report
    focal_relative=0.002,
    # without the part that is indistinguishable from a head-eye rotation
    principal_px=0.5,
    distortion=0.01,
    # mean of the two tilts, from the initial pixels of section 5.3.2
    common_tilt_rad=radians(1.4),
)
"""Relative sizes of the errors, as standard deviations; the experiments on the physical twin find
their common scale."""
TWIN_ERRORS: Final = TWIN_SPREADS.scaled(0.41)
"""Standard deviations of the scenarios' model errors: `TWIN_SPREADS` times the scale found by
`vergence reproduce physical-static` (measured)."""
