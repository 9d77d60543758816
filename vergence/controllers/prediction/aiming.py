"""Where the targets will be when the next command acts, and what the images show then."""

from math import exp, nan
from typing import Final

from vergence._jit import device
from vergence.controllers.prediction.joints import Rig
from vergence.controllers.prediction.memory import Memory
from vergence.controllers.prediction.moving import ahead_of, slow_share
from vergence.controllers.prediction.response import answer_of
from vergence.models.kinematics import eye_frames, point_in_eye
from vergence.models.packed import PackedHead, camera_of
from vergence.models.pose import out_of

_SURE: Final = 0.9
"""Probability of rest above which a target is taken to rest."""
_CLEARLY: Final = 0.5
"""Share of the speed up to which images show it that a target may have against an eye."""
_GRACE_S: Final = 0.03
"""So long after the next image should have come an eye goes on as its target did."""


@device
def aim_ahead(memory: Memory, rig: Rig, tick: float) -> None:
    """Where the targets will be at a time in periods, and how fast they move then."""
    moves = rig.follows > 0.5 and memory.ways[0] < _SURE
    shows_s = exp(answer_of(memory.response).found[2]) + 0.5 * rig.period_s
    expected_s = memory.delay_s + rig.frame_s + (tick - memory.count) * rig.period_s + _GRACE_S
    slow = 1.0
    for eye in range(2):
        for joint in range(2):
            memory.aims[eye, joint], memory.rates[eye, joint] = memory.goals[eye, joint], 0.0
            memory.later_rates[eye, joint] = 0.0
            if moves and memory.known[eye] > 0.5:
                time_s = (tick - memory.moved_at) * rig.period_s
                motions, resting = memory.motions[eye], memory.goals[eye, joint]
                if joint == 0:
                    slow = slow_share(motions, memory.ways, _CLEARLY * rig.sees)
                angle, rate = ahead_of(
                    motions, memory.ways, resting, joint, time_s, expected_s, slow
                )
                memory.aims[eye, joint], memory.rates[eye, joint] = angle, rate
                time_s += shows_s
                _, rate = ahead_of(
                    motions, memory.ways, resting, joint, time_s, expected_s + shows_s, slow
                )
                memory.later_rates[eye, joint] = rate


@device
def present_error(
    memory: Memory, p: PackedHead, eye: int, first: float, second: float
) -> tuple[float, float]:
    """The pixel error that one eye has at some angles.

    Args:
        memory: what is remembered.
        p: a packed head.
        eye: which one.
        first: the angle of its first joint, rad.
        second: that of its second, rad.

    Returns:
        Undistorted, along u and v, px; nan where it is not known.
    """
    if memory.known[eye] < 0.5:
        return nan, nan
    # the point that is on the axis when the eye has turned there
    camera = eye_frames(p, eye, memory.aims[eye, 0], memory.aims[eye, 1]).camera
    px, py, pz = out_of(camera, 0.0, 0.0, memory.fixated_depth[eye])
    x, y, z = point_in_eye(p, eye, first, second, px, py, pz)
    if not z > 0.0:
        return nan, nan
    lens = camera_of(p, eye)
    return lens.focal_u * x / z, lens.focal_v * y / z
