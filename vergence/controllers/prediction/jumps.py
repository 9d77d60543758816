"""Detection of target jumps: gates on a goal, and confirmation of a displaced one over images."""

from typing import Final

from vergence.controllers.prediction.comparing import MODEL_ERROR_SD_RAD
from vergence.controllers.prediction.joints import PredictorParameters
from vergence.controllers.prediction.predictor_state import PredictorState
from vergence.kernels import inlined
from vergence.models.parts import FloatArray

DISPLACED_GATE: Final = 36.0
"""Squared Mahalanobis distance of an innovation above which a goal is displaced (chosen: 6
sigma)."""
UNMOVED_GATE: Final = 9.0
"""Squared Mahalanobis distance up to which a goal is where it was (chosen: 3 sigma)."""
_OTHER_UNMOVED_S: Final = 0.25
"""Time for which one eye has to see its target displaced while the other sees it unmoved, s
(chosen: false detections against reaction time)."""
_OTHER_UNSURE_S: Final = 0.1
"""This time if the other eye does not see its target, or sees it at a third place, s (chosen)."""


@inlined
def squared_mahalanobis(
    state: PredictorState,
    eye: int,
    goals: FloatArray,
    variance: FloatArray,
    delay_variance: FloatArray,
) -> float:
    """Squared Mahalanobis distance of an image's goals of one eye from the filtered ones.

    Args:
        state: the predictor's state.
        eye: index of the eye.
        goals: (2, 2) goals of the image, rad.
        variance: (2, 2) variances of the goals for a known delay, rad^2.
        delay_variance: (2, 2) variances that the uncertain delay adds, rad^2.

    Returns:
        Larger distance of the two joints.
    """
    most = 0.0
    for joint in range(2):
        off = goals[eye, joint] - state.goals[eye, joint]
        known = state.filter_variance[eye, joint] + state.goal_variance_over_delays[eye, joint]
        known += variance[eye, joint] + delay_variance[eye, joint]
        most = max(most, off * off / known)
    return most


@inlined
def has_jumped(
    state: PredictorState,
    params: PredictorParameters,
    eye: int,
    goals: FloatArray,
    variance: FloatArray,
    delay_variance: FloatArray,
    other_eye_unmoved: bool,
) -> bool:
    """True if the displaced detection of one eye has stayed long enough to be its target.

    A lamp or a reflection may be taken for the target in several images. So a displaced target has
    to be confirmed in as many images as the old one was, or for `_OTHER_UNSURE_S`, or for
    `_OTHER_UNMOVED_S` if the other eye sees its target unmoved.

    Args:
        state: the predictor's state; its count of images in a row is updated.
        params: the head's parameters.
        eye: index of the eye.
        goals: (2, 2) goals of the image, rad.
        variance: (2, 2) variances of the goals for a known delay, rad^2.
        delay_variance: (2, 2) variances that the uncertain delay adds, rad^2.
        other_eye_unmoved: True if the other eye sees its target where it was.
    """
    again = state.displaced_image_count[eye] > 0.5
    for joint in range(2):
        off = goals[eye, joint] - state.displaced_goals[eye, joint]
        known = (
            2.0 * (variance[eye, joint] + delay_variance[eye, joint]) + 2.0 * MODEL_ERROR_SD_RAD**2
        )
        again = again and off * off <= DISPLACED_GATE * known
    state.displaced_image_count[eye] = state.displaced_image_count[eye] + 1.0 if again else 1.0
    for joint in range(2):
        state.displaced_goals[eye, joint] = goals[eye, joint]
    most = max(
        round((_OTHER_UNMOVED_S if other_eye_unmoved else _OTHER_UNSURE_S) / params.frame_period_s),
        2,
    )
    return bool(
        state.displaced_image_count[eye] > min(max(state.confirmations[eye], 2.0), most) - 0.5
    )
