"""Glossary of terms in reports and tables."""

from typing import Final

GLOSSARY: Final[dict[str, str]] = {
    "gaze": "The method of the article: both eyes hold the target at their principal points, and "
    "the point where their optical axes cross follows from the joint angles alone.",
    "ITPC": "The article's comparison method, integrated two-pose calibration: two-view "
    "triangulation from the target's pixels in both images, with the pose between the cameras "
    "computed from the joint angles of the exposure. Its formulas are not public; ours are a "
    "reconstruction.",
    "fix": "One triangulated point: the middle of the shortest segment between the two lines of "
    "sight.",
    "gap": "The length of that segment, the common perpendicular: zero where the lines meet, and "
    "greater with every error that the two eyes do not share.",
    "fixation": "The eyes at rest with the target at the principal point of both.",
    "settle time": "From the moment the target appears or jumps until both eyes' true errors stay "
    "below a threshold to the end of the trial; 1 px where no other is named. A trial whose eyes "
    "swing has none.",
    "swing": "The speed of an eye joint goes on spanning more than 20 degrees/s, through a whole "
    "second, although the target rests.",
    "overshoot": "How far the target's image moves past the principal point, as a part of the "
    "step.",
    "gain, k": "The law's speed: without delay the pixel error decays as exp(-k t).",
    "lag": "The time constant with which a joint's velocity follows its command.",
    "principal point": "Where the optical axis meets the image.",
    "uncertainty": "The standard deviation of a fix that the detections' noise alone would cause.",
    "twin": "A simulated head whose true geometry differs from the model that controls it by drawn "
    "errors; a population of such heads stands for the article's one.",
}
"""Explanations by term, in the order of the report."""

METHODS_LEGEND: Final = (
    "gaze: where the optical axes cross, from the joint angles alone. "
    "ITPC (integrated two-pose calibration): where the rays through the target's pixels cross, "
    "from the joint angles of their exposure."
)
"""Explanation of the two methods, for below a table on a terminal."""
