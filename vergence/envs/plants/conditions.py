"""Imperfections of the control loop in one table, their variation, a trial's conditions.

The table defines the options of simulated plants, the quantities that a variation draws, the rows
of kernels, the quantities of margins, and the tables of the docs. Kernels are compiled with the
order of its rows. So a change here must invalidate the cache of `vergence.kernels`, which depends
on all modules that contain this name.

A robot's loop never quite equals its model, and changes from day to day. A variation draws the loop
anew for each trial from the trial's own random stream, so that a trial is the same alone, in a
vector and after other trials.
"""

import dataclasses
from collections import namedtuple
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from math import inf, isfinite
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final, Generic, NamedTuple, TypeVar

import numpy as np

from vergence.envs.reading import real_number_array
from vergence.envs.streams import (
    IntArray,
    KeyArray,
    StreamPurpose,
    four_normals,
    random_words,
    to_uniform,
)
from vergence.errors import ConfigurationError, refuse_unknown
from vergence.kernels import compiled, inlined, make_tuple_reader
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.models.perturbation import ModelErrors, as_model_errors, perturb_by_deviates

LOOP_PARTS: Final = ("camera", "encoders", "motors", "target")
"""Parts of the loop, in the order of the margins' tables and figures."""


class Imperfection(NamedTuple):
    """Description of one imperfect quantity of the loop."""

    part: str  # part of the loop, one of `LOOP_PARTS`
    label: str  # its name in tables and figures
    description: str  # one-line description for the docs
    unit: str
    least: float
    most: float  # upper limit of valid values; for times it is excluded
    search_range: tuple[float, float]
    """Range in which margins are searched. It exceeds the values of existing robots, and ends where
    nothing more can be learned."""
    head_path: str = ""
    """Attribute path of the head's own value, which is then the default; may be empty."""
    default: float = 0.0
    """Default value of a head without one of its own."""
    by_actuator: bool = False
    """True if each actuator has its own value."""
    probability: str = ""
    """Name of the imperfection that is the probability of this one; empty if it always acts."""
    display_unit: tuple[str, float] = ("", 1.0)
    """Unit for display, empty for a ratio, and the factor from `unit` to it."""

    def nominal(self, head: HeadModel) -> float | FloatArray:
        """Default value for a head."""
        value: float | FloatArray = self.default
        return attrgetter(self.head_path)(head) if self.head_path else value


Value = TypeVar("Value", covariant=True)

_MAX_DELAY_S: Final = 1.0
"""Upper limit of every delay and lag, excluded, s (chosen: above those of robots, yet low enough to
catch values in milliseconds)."""
_MS: Final = ("ms", 1e3)
_MRAD: Final = ("mrad", 1e3)
_PERCENT: Final = ("%", 100.0)


def _imperfection_field(
    part: str, label: str, description: str, unit: str, span: tuple[float, float],
    search_range: tuple[float, float], **others: Any,
) -> Any:  # fmt: skip
    """Define a field of `Imperfections`."""
    one = Imperfection(part, label, description, unit, *span, search_range, **others)
    return field(default=None, metadata={"imperfection": one})


# fmt: off
@dataclass(frozen=True, kw_only=True, eq=False)
class Imperfections(Generic[Value]):
    """One value per imperfection of the loop: a range, or the numbers of a batch.

    A trial draws them in this order, so new ones must be appended.
    """

    latency_s: Value = _imperfection_field(
        "camera", "image latency", "latency from mid-exposure to the time at which the image is "
        "readable; a reading dates its image by the model's latency, unless the cameras stamp "
        "exposures", "s", (0.0, _MAX_DELAY_S), (0.0, 0.3), head_path="timing.latency_s",
        display_unit=_MS)
    lag_s: Value = _imperfection_field(
        # margins exclude 0: a joint without lag has no dynamics
        "motors", "joint lag", "time constant of the motors' response; above 0 for dynamics; an "
        "actuator with a lag of its own keeps its ratio to the head's", "s", (0.0, _MAX_DELAY_S),
        (0.001, 0.2), head_path="timing.lag_s", display_unit=_MS)
    detection_noise_px: Value = _imperfection_field(
        "camera", "detection noise", "standard deviation of each coordinate of a detection; not on "
        "`rendered`, whose detector has its own noise", "px", (0.0, inf), (0.0, 3.0),
        head_path="sensor.detection_noise_px", display_unit=("px", 1.0))
    dropped_frame_probability: Value = _imperfection_field(
        "camera", "dropped frames", "probability that a frame of both eyes never arrives", "1",
        (0.0, 1.0), (0.0, 0.9), head_path="sensor.dropped_frame_probability", display_unit=_PERCENT)
    jitter_s: Value = _imperfection_field(
        "camera", "frame jitter", "largest delay of a frame beyond the latency, uniform from 0; "
        "frames keep their order", "s", (0.0, _MAX_DELAY_S), (0.0, 0.1), display_unit=_MS)
    missed_detection_probability: Value = _imperfection_field(
        "camera", "missed detections", "probability that an eye's detector finds nothing in a "
        "frame, independent for each eye", "1", (0.0, 1.0), (0.0, 0.9), display_unit=_PERCENT)
    outlier_probability: Value = _imperfection_field(
        "camera", "outliers", "probability that an eye's detection is an outlier, independent for "
        "each eye", "1", (0.0, 1.0), (0.0, 0.3), display_unit=_PERCENT)
    outlier_px: Value = _imperfection_field(
        "camera", "outlier size", "largest distance of an outlier from the target: uniform from 0, "
        "in any direction", "px", (0.0, inf), (0.0, 300.0), default=100.0,
        probability="outlier_probability", display_unit=("px", 1.0))
    frame_rate_hz: Value = _imperfection_field(
        "camera", "frame rate", "frames per second", "Hz", (1.0, 1000.0), (10.0, 240.0),
        head_path="timing.frame_rate_hz", display_unit=("Hz", 1.0))
    frame_phase: Value = _imperfection_field(
        "camera", "camera phase", "time of the first exposure after time zero, as a fraction of "
        "the frame period", "1", (0.0, 1.0), (0.0, 1.0), display_unit=("of a frame", 1.0))
    clock_drift: Value = _imperfection_field(
        "camera", "camera clock slow by", "fraction by which the cameras' clock is slow", "1",
        (-0.1, 0.1), (-0.05, 0.05), display_unit=_PERCENT)
    command_latency_s: Value = _imperfection_field(
        "motors", "command latency", "latency from a command to the motors' response", "s",
        (0.0, _MAX_DELAY_S), (0.0, 0.1), head_path="timing.command_latency_s", display_unit=_MS)
    feedback_latency_s: Value = _imperfection_field(
        "encoders", "feedback latency", "latency from a measurement of the joints to its reading",
        "s", (0.0, _MAX_DELAY_S), (0.0, 0.1), head_path="timing.feedback_latency_s",
        display_unit=_MS)
    angle_noise_rad: Value = _imperfection_field(
        "encoders", "encoder noise, angle", "standard deviation of an encoder's angle before "
        "quantisation", "rad", (0.0, inf), (0.0, 0.01), display_unit=_MRAD)
    speed_noise_rad_s: Value = _imperfection_field(
        "encoders", "encoder noise, speed", "standard deviation of an encoder's speed before "
        "quantisation", "rad/s", (0.0, inf), (0.0, 0.5), display_unit=("rad/s", 1.0))
    acceleration_ratio: Value = _imperfection_field(
        "motors", "acceleration by model", "ratio of the motors' largest accelerations to the "
        "head's limits", "1", (0.01, 100.0), (0.1, 3.0), default=1.0)
    torque_falloff: Value = _imperfection_field(
        "motors", "torque falloff", "fraction of its acceleration that a motor loses up to its top "
        "speed, gain included; braking is not reduced", "1", (0.0, 0.8), (0.0, 0.8))
    onset_s: Value = _imperfection_field(
        "target", "onset", "time at which the target appears, jumps or begins to move", "s",
        (0.0, 10.0), (0.0, 0.5), display_unit=("s", 1.0))
    speed_gain: Value = _imperfection_field(
        "motors", "speed gain", "ratio of the steady speed to the command, drawn for each actuator",
        "1", (0.01, 2.0), (0.4, 1.6), default=1.0, by_actuator=True)
    backlash_rad: Value = _imperfection_field(
        "motors", "backlash", "backlash between motor and joint, full width, drawn for each "
        "actuator (in a file `sensor.backlash_rad` or the actuator's); none in the neck", "rad",
        (0.0, 0.2), (0.0, 0.02), head_path="actuation.backlash", by_actuator=True,
        display_unit=_MRAD)
    speed_filter_s: Value = _imperfection_field(
        "encoders", "speed filter", "time constant of the first-order low-pass filter of a servo's "
        "reported speed; 0 for none", "s", (0.0, _MAX_DELAY_S), (0.0, 0.1), display_unit=_MS)
    speed_latency_s: Value = _imperfection_field(
        "encoders", "speed latency", "age of a reported speed relative to the angle reported with "
        "it; the filter is applied after it", "s", (0.0, _MAX_DELAY_S), (0.0, 0.1),
        display_unit=_MS)
    speed_span_s: Value = _imperfection_field(
        "encoders", "speed as difference over", "for servos that report no speed: time, in whole "
        "periods, over which the speed is the difference of the reported angles, which then has no "
        "noise, quantisation, latency or filter of its own; below half a period for the servos' "
        "own speed", "s", (0.0, _MAX_DELAY_S), (0.0, 0.1), display_unit=_MS)
    lost_command_probability: Value = _imperfection_field(
        "motors", "lost commands", "probability that a period's command never reaches the motors, "
        "which keep the previous one; `command` of a reading is what was sent", "1", (0.0, 1.0),
        (0.0, 0.9), display_unit=_PERCENT)
    stall_probability: Value = _imperfection_field(
        "motors", "stalls of the control loop", "probability that the control loop stalls in a "
        "period after one in which it ran: joints and images are not read, and the command is not "
        "sent", "1", (0.0, 1.0), (0.0, 0.5), display_unit=_PERCENT)
    stall_s: Value = _imperfection_field(
        "motors", "length of a stall", "longest stall: uniform from 0, in whole periods, at least "
        "one", "s", (0.0, _MAX_DELAY_S), (0.0, 0.5), default=0.1, probability="stall_probability",
        display_unit=_MS)
    false_detection_probability: Value = _imperfection_field(
        "camera", "false detections", "probability that in a frame a lamp, a reflection or another "
        "mark begins to be taken for the target: in the left eye, the right or both, a third each; "
        "in half of the cases with both, their errors are equal", "1", (0.0, 1.0), (0.0, 0.2),
        display_unit=_PERCENT)
    false_detection_s: Value = _imperfection_field(
        "camera", "length of a false detection", "longest false detection: uniform from 0, in "
        "whole frames, at least one", "s", (0.0, _MAX_DELAY_S), (0.0, 0.5), default=0.2,
        probability="false_detection_probability", display_unit=_MS)
    false_detection_px: Value = _imperfection_field(
        "camera", "distance of a false detection", "largest distance of a false detection from the "
        "target, constant over its frames: uniform from 0, in any direction", "px", (0.0, inf),
        (0.0, 300.0), default=100.0, probability="false_detection_probability",
        display_unit=("px", 1.0))
    overshoot: Value = _imperfection_field(
        "motors", "overshoot", "fraction by which the speed of a second-order servo overshoots a "
        "step of its command, with the joint lag as its time constant; 0 for a first-order lag",
        "1", (0.0, 0.9), (0.0, 0.6), display_unit=_PERCENT)
    skew_s: Value = _imperfection_field(
        "camera", "right eye exposed later by", "delay of the right eye's exposures after the left "
        "eye's, at most the frame period; a pair arrives with the later image, and its stamp is "
        "that of the left one; not on `rendered`", "s", (0.0, _MAX_DELAY_S), (0.0, 0.1),
        display_unit=_MS)
# fmt: on


IMPERFECTIONS: Final[dict[str, Imperfection]] = {
    one.name: one.metadata["imperfection"] for one in fields(Imperfections)
}
"""Descriptions by name, in the order in which a trial draws the imperfections."""
PER_TRIAL: Final = tuple(name for name, one in IMPERFECTIONS.items() if not one.by_actuator)
"""Names of the imperfections with one number per trial."""
PER_ACTUATOR: Final = tuple(name for name, one in IMPERFECTIONS.items() if one.by_actuator)
"""Names of the imperfections with one number per actuator."""


def valid_range_text(name: str) -> str:
    """Valid values of an imperfection, in words for an error message."""
    one = IMPERFECTIONS[name]
    if one.unit == "s":
        return f"seconds from {one.least:g} to below {one.most:g} (is it in milliseconds?)"
    if one.most == inf:
        return f"at least {one.least:g}"
    return f"{one.least:g} to {one.most:g}"


def is_valid_range(name: str, low: float, high: float) -> bool:
    """True if an imperfection may have all values from `low` to `high`."""
    one = IMPERFECTIONS[name]
    return one.least <= low and (high < one.most if one.unit == "s" else high <= one.most)


EnvIndex = int | np.unsignedinteger[Any]
"""Environment index; unsigned to spare kernels the check for a negative index."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Conditions(Imperfections[FloatArray]):
    """Actual conditions of the trials of a batch, hidden from the controller.

    All fields but `heads` have the shape (n,), or (n, 7) for the neck's joints and the eye
    actuators.
    """

    heads: FloatArray
    """(n or 1, PACKED) the true heads, see `vergence.models.kinematics`."""

    def __iter__(self) -> Iterator[FloatArray]:
        return iter(vars(self).values())


class PackedConditions(NamedTuple):
    """`Conditions` packed into three arrays, the form kernels take."""

    loop: FloatArray  # (n, TRIAL_CONDITIONS) one row of `TrialConditions` per trial
    own: FloatArray  # (n, PER_ACTUATOR, 7) speed gains, and backlashes in rad, per actuator
    heads: FloatArray  # (n or 1, PACKED) the true heads


if TYPE_CHECKING:

    class TrialConditions(Imperfections[float]):
        """The scalar conditions of one trial."""

        frame_s: float
        """Time from one frame to the next, s, from frame rate and clock drift."""

        def __init__(self, *numbers: float) -> None: ...

else:  # kernels take named tuples, but no dataclasses
    TrialConditions = namedtuple("TrialConditions", (*PER_TRIAL, "frame_s"))

TRIAL_CONDITIONS: Final = len(PER_TRIAL) + 1
"""Length of a row of `TrialConditions` (numerical)."""
_read_trial_conditions = make_tuple_reader(TRIAL_CONDITIONS)
GAIN: Final = PER_ACTUATOR.index("speed_gain")
BACKLASH: Final = PER_ACTUATOR.index("backlash_rad")


@inlined
def unpack_conditions(packed: PackedConditions, n: EnvIndex) -> TrialConditions:
    """Unpack the scalar conditions of one trial."""
    return TrialConditions(*_read_trial_conditions(packed.loop[n], 0))


Range = tuple[float, float]

_VARIATION: Final = int(StreamPurpose.VARIATION)
RANGES: Final = tuple(IMPERFECTIONS)
"""Fields of `Variation` that are ranges."""


@dataclass(frozen=True, kw_only=True)
class Variation(Imperfections[Range | None]):
    """Ranges from which each trial draws its own conditions, uniformly; None for no variation.

    The ranges have the names of `vergence.envs.plants.conditions`, such as
    `latency_s=(0.03, 0.13)`. An imperfection of actuators is drawn for each actuator separately.
    Without a range, the plant's option or the head's preset holds.
    """

    model_errors: ModelErrors | None = None
    """Standard deviations of the true head from its model."""

    def __post_init__(self) -> None:
        for name in RANGES:
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, _range(name, value))
        if self.model_errors is not None:
            errors = as_model_errors(self.model_errors, "variation.model_errors")
            object.__setattr__(self, "model_errors", errors)

    def largest_value(self, name: str, given: float) -> float:
        """Largest value of one of `RANGES` in any trial."""
        span: Range | None = getattr(self, name)
        return given if span is None else span[1]

    def ranges(self, names: tuple[str, ...]) -> FloatArray:
        """(n, 2) the ranges of these of `RANGES`; nan where nothing is drawn."""
        spans = (getattr(self, name) for name in names)
        return np.array([(np.nan, np.nan) if span is None else span for span in spans])

    def make_true_heads(self, head: HeadModel, deviates: FloatArray) -> HeadModel:
        """Make the true heads of trials, a population of shape (m,), from their deviates."""
        if self.model_errors is None:
            raise ConfigurationError("variation.model_errors: expected some, got None")
        geometry = perturb_by_deviates(head.geometry, self.model_errors, deviates)
        return dataclasses.replace(head, **geometry._asdict())


def make_variation(variation: Mapping[str, Any] | Variation | None) -> Variation | None:
    """Make a variation from its fields."""
    if variation is None or isinstance(variation, Variation):
        return variation
    if not isinstance(variation, Mapping):
        raise ConfigurationError(f"variation: expected ranges by field, got {variation!r:.80}")
    refuse_unknown("variation", variation, Variation.__dataclass_fields__)
    return Variation(**variation)


def _range(name: str, value: Any) -> Range:
    try:
        low, high = map(float, real_number_array(value))
    except (TypeError, ValueError) as error:
        raise ConfigurationError(
            f"variation.{name}: expected two numbers, got {value!r}"
        ) from error
    if not np.isfinite([low, high]).all():
        raise ConfigurationError(f"variation.{name}: expected finite numbers, got {value!r}")
    if not low <= high:
        raise ConfigurationError(f"variation.{name}: expected least <= greatest, got {value!r}")
    if not is_valid_range(name, low, high):
        raise ConfigurationError(
            f"variation.{name}: expected {valid_range_text(name)}, got {value!r}"
        )
    return low, high


@compiled
def draw_conditions(
    seeds: KeyArray, trials: KeyArray, ids: IntArray, trial_ranges: FloatArray,
    actuator_ranges: FloatArray, loop: FloatArray, own: FloatArray,
) -> None:  # fmt: skip
    """Draw the conditions of the trials of some environments, except their heads."""
    count, numbers = trial_ranges.shape[0], actuator_ranges.shape[0] * own.shape[2]
    for m in range(ids.shape[0]):
        n = ids[m]
        for lane in range((count + 3) // 4):
            words = random_words(seeds[n], trials[n], _VARIATION, 0, lane + 1)
            for i in range(4):
                at = 4 * lane + i
                if at < count and isfinite(trial_ranges[at, 0]):
                    low, high = trial_ranges[at, 0], trial_ranges[at, 1]
                    loop[n, at] = low + to_uniform(words[i]) * (high - low)
        for lane in range((numbers + 3) // 4):
            words = random_words(seeds[n], trials[n], _VARIATION, 2, lane + 1)
            for i in range(4):
                at = 4 * lane + i
                one, slot = at // own.shape[2], at % own.shape[2]
                if at < numbers and isfinite(actuator_ranges[one, 0]):
                    low, high = actuator_ranges[one, 0], actuator_ranges[one, 1]
                    own[n, one, slot] = low + to_uniform(words[i]) * (high - low)


@compiled
def draw_head_deviates(seeds: KeyArray, trials: KeyArray, count: int) -> FloatArray:
    """(m, count) standard normal numbers of the true heads of trials."""
    numbers = np.empty((len(seeds), count))
    for m in range(seeds.shape[0]):
        for lane in range((count + 3) // 4):
            words = random_words(seeds[m], trials[m], _VARIATION, 1, lane + 1)
            for i, number in enumerate(four_normals(words, 1.0)):
                if 4 * lane + i < count:
                    numbers[m, 4 * lane + i] = number
    return numbers
