"""How far real heads lie from their model: the errors of the article's head, as far as one knows.

What the article's own figures say about its head. At time zero of section 5.3.2 the target stood
1.6 and 1.2 degrees of tilt (left, right) and 0.8 and -1.1 degrees of pan beside where the nominal
geometry has it. Head-eye calibration takes up most of that: an offset of pan is a rotation of the
camera in its eye, whatever the posture, so the 1.9 degrees between the two pans do not reach the
point (0.10 degrees of vergence are 124 mm at 2.5 m). It cannot take up what the two tilts have in
common, 1.4 degrees: both eyes tilt about one line, so turning both together leaves every relation
between the two cameras as it was. Hence two kinds of error: residuals of calibration, independent
and small, and a common tilt. Bending under load, which the article names too, counts as offsets.
"""

from math import radians
from typing import Final

from vergence.models.perturbation import ModelErrors

TWIN_SPREADS: Final = ModelErrors(
    # what milled or printed brackets keep
    link_m=0.0002,
    # 0.1 mm across the 60 mm of an eye's bracket
    coaxiality_rad=radians(0.1),
    # what head-eye calibration leaves of each offset: about the encoders' precision
    joint_offset_rad=radians(0.05),
    # the common precision of hand-eye calibration, as is the next
    head_eye_rad=radians(0.1),
    head_eye_m=0.0005,
    # 1 px, the uncertainty that calibration toolboxes report
    focal_relative=0.002,
    # an error that calibration shared with the head-eye rotation is gone
    principal_px=0.5,
    distortion=0.01,
    # the mean of the two tilts that the initial pixels of section 5.3.2 show
    common_tilt_rad=radians(1.4),
)
"""The relative sizes of the errors; the experiments on the physical twin find their scale."""
TWIN_ERRORS: Final = TWIN_SPREADS.scaled(0.41)
"""The same times the scalar that `vergence reproduce physical-static` finds: how real heads differ
from their model in the scenarios."""
