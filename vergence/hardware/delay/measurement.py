"""Results of a loop measurement: by eye, as a configuration, and as text."""

import datetime
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from vergence.hardware.config import LoopConfig
from vergence.hardware.delay.image_fit import ImageFit
from vergence.hardware.delay.joint_fit import JointFit

_MOST_CORRELATION: Final = 0.9
"""Correlation of latency and lag above which it is reported (chosen)."""
_MISFIT_RAD: Final = 3e-3
"""Rms angle residual above which a misfit is reported, rad: twice that of timing errors for a servo
with a pure lag, and less than that of an overshoot of 10 % (measured:
tests/hardware/delay/test_fits.py)."""
_MISFIT_PX: Final = 1.0
"""Rms reprojection error above which a misfit is reported, px (chosen)."""
_MOST_SCALE_ERROR: Final = 0.05
"""Deviation of the image scale from 1 that is reported if it exceeds 3 sigma (chosen)."""
_MOST_LATENCY_DIFFERENCE_S: Final = 0.01
"""Difference of the eyes' latencies above which their mean is reported as a poor model, s
(chosen)."""


@dataclass(frozen=True, kw_only=True)
class EyeLoop:
    """Measured loop of one eye."""

    eye: str
    actuator: str
    lag_ratio: float
    """Ratio of the actuator's own lag to the head's, from the head file."""
    model_acceleration_rad_s2: float
    """The actuator's greatest acceleration in the head file, rad/s^2."""
    joint_fit: JointFit
    image_fit: ImageFit | None
    """Fit of the images; None if too few of them showed the target."""
    computing_s: float
    """Sum of the median times from an image's receipt to its detection and from a reading to its
    command, s."""


@dataclass(frozen=True, kw_only=True)
class LoopMeasurement:
    """Measured loop of a robot."""

    eyes: tuple[EyeLoop, ...]

    @property
    def latencies_s(self) -> dict[str, float]:
        """Least latency of each measured camera by eye, s; images arrive up to the jitter later."""
        return {
            one.eye: one.image_fit.least_latency_s for one in self.eyes if one.image_fit is not None
        }

    def loop(self) -> LoopConfig:
        """Combine the values of both eyes into one loop for the configuration."""
        joints = [one.joint_fit for one in self.eyes]
        images = [one.image_fit for one in self.eyes if one.image_fit is not None]
        values: dict[str, float] = {}
        sigma: dict[str, float] = {}

        def put(name: str, pairs: Sequence[tuple[float, float]], shared: bool = False) -> None:
            if pairs:
                values[name], deviation = _mean(pairs, shared)
                if np.isfinite(deviation):
                    sigma[name] = deviation

        put(
            "command_latency_s",
            [(max(one.motor.latency_s, 0.0), one.sigma.latency_s) for one in joints],
            shared=True,
        )
        put(
            "lag_s",
            [
                (
                    one.joint_fit.lag_s / one.lag_ratio,
                    one.joint_fit.lag_sigma_s / one.lag_ratio,
                )
                for one in self.eyes
            ],
        )
        put("speed_gain", [(one.motor.gain, one.sigma.gain) for one in joints])
        put("backlash_rad", [(one.backlash_rad, one.backlash_sigma_rad) for one in images])
        jitters = [(one.jitter_s, one.jitter_sigma_s) for one in images if one.jitter_s is not None]
        put("jitter_s", jitters)
        accelerations = [
            (
                found / one.model_acceleration_rad_s2,
                one.joint_fit.acceleration_sigma / one.model_acceleration_rad_s2,
            )
            for one in self.eyes
            if (found := one.joint_fit.acceleration_rad_s2) is not None
        ]
        if len(accelerations) == len(joints):
            put("acceleration_ratio", accelerations)
        latencies = [(one.least_latency_s, one.least_latency_sigma_s) for one in images]
        if latencies:
            sigma["latency_s"] = _mean(latencies, shared=True)[1]
        return LoopConfig(
            measured=datetime.date.today().isoformat(),
            computing_s=float(np.mean([one.computing_s for one in self.eyes])),
            sigma=sigma,
            **values,
        )

    def misfits(self) -> list[str]:
        """Texts, a line each, on misfits of the model of a robot."""
        lines = []
        for one in self.eyes:
            if one.joint_fit.misfit_rad > _MISFIT_RAD:
                lines.append(
                    f"{one.actuator}: its angles are {1e3 * one.joint_fit.misfit_rad:.1f} mrad "
                    "(rms) "
                    "beside those of a lag behind a latency, whose values are the nearest: a servo "
                    "that overshoots or slips, or a machine that pauses"
                )
            if one.image_fit is None:
                continue
            off = one.image_fit.scale - 1.0
            scaled = abs(off) > max(_MOST_SCALE_ERROR, 3.0 * one.image_fit.scale_sigma)
            # a joint that moves otherwise between its readings displaces the image too
            beside = one.image_fit.residual_px > _MISFIT_PX
            if scaled or (beside and one.joint_fit.misfit_rad <= _MISFIT_RAD):
                by = f"moves by {100.0 * abs(off):.0f} % {'more' if off > 0.0 else 'less'}, and "
                lines.append(
                    f"{one.eye} eye: its camera is not as the head file has it: the image "
                    f"{by if scaled else ''}is {one.image_fit.residual_px:.1f} px (rms) off its "
                    "motion; calibrate it"
                )
        return lines

    def rows(self) -> list[dict[str, Any]]:
        """One row per eye and quantity: `eye`, `actuator`, `what`, `value`, `sigma`, `unit`."""
        return [row for one in self.eyes for row in _rows(one)]

    def undetermined(self) -> list[str]:
        """Texts, a line each, on quantities that the measurement cannot determine."""
        lines = [
            "the age of the encoders' readings cannot be measured and is taken to be zero: image "
            "latency is measured relative to it, and command latency together with it"
        ]
        for one in self.eyes:
            joint = one.joint_fit
            if joint.acceleration_rad_s2 is None:
                lines.append(
                    f"{one.actuator}: its acceleration limit was not reached: at least "
                    f"{joint.peak_acceleration_rad_s2:.0f} rad/s^2"
                )
            if abs(joint.latency_lag_correlation) > _MOST_CORRELATION:
                lines.append(
                    f"{one.actuator}: command latency and lag are poorly separated "
                    f"(correlation {joint.latency_lag_correlation:.2f}); their sum is better known"
                )
            fit = one.image_fit
            if fit is None:
                lines.append(
                    f"{one.eye} eye: too few images showed the target to measure latency, jitter "
                    "and backlash"
                )
                continue
            if fit.jitter_s is None:
                lines.append(
                    f"{one.eye} eye: it turned too slowly to measure the jitter of its images, so "
                    "their mean latency stands for the least; raise safety.speed_rad_s"
                )
            backlash_rad, doubt_rad = fit.backlash_rad, 2.0 * fit.backlash_sigma_rad
            if backlash_rad < doubt_rad:
                lines.append(
                    f"{one.actuator}: backlash is no greater than its uncertainty, below "
                    f"{1e3 * (backlash_rad + doubt_rad):.1f} mrad"
                )
        latencies = list(self.latencies_s.values())
        if len(latencies) == 2 and abs(latencies[0] - latencies[1]) > _MOST_LATENCY_DIFFERENCE_S:
            lines.append(
                f"the cameras' latencies differ by {1e3 * abs(latencies[0] - latencies[1]):.0f} "
                "ms; a simulation has their mean"
            )
        return lines


def _mean(pairs: Sequence[tuple[float, float]], shared: bool) -> tuple[float, float]:
    """Mean of the values, and its standard deviation, at least half the range of the values.

    Shared errors, such as timing errors of readings on one line, do not average out.
    """
    values, sigmas = np.array(pairs).T
    own = float(np.sqrt(np.mean(sigmas**2) / (1 if shared else len(values))))
    return float(values.mean()), max(own, 0.5 * float(np.ptp(values)))


def _rows(eye_loop: EyeLoop) -> Iterator[dict[str, Any]]:
    joint, image = eye_loop.joint_fit, eye_loop.image_fit
    motor, sigma = joint.motor, joint.sigma
    rows: list[tuple[str, float | None, float, str]] = [
        ("command + feedback latency", 1e3 * motor.latency_s, 1e3 * sigma.latency_s, "ms"),
        ("joint lag", 1e3 * joint.lag_s, 1e3 * joint.lag_sigma_s, "ms"),
        ("speed gain", motor.gain, sigma.gain, ""),
        (
            "greatest acceleration",
            joint.acceleration_rad_s2,
            joint.acceleration_sigma,
            "rad/s^2",
        ),
    ]
    if (friction := joint.friction_ratio) is not None:
        rows.append(("friction", 100.0 * friction, np.nan, "% of torque"))
    if image is not None:
        jitter_ms = None if image.jitter_s is None else 1e3 * image.jitter_s
        rows += [
            (
                "image - feedback latency",
                1e3 * image.least_latency_s,
                1e3 * image.least_latency_sigma_s,
                "ms",
            ),
            ("image jitter", jitter_ms, 1e3 * image.jitter_sigma_s, "ms"),
            ("play", 1e3 * image.backlash_rad, 1e3 * image.backlash_sigma_rad, "mrad"),
            ("image scale", image.scale, image.scale_sigma, ""),
        ]
    rows.append(("computing, in total", 1e3 * eye_loop.computing_s, np.nan, "ms"))
    for what, value, deviation, unit in rows:
        yield {
            "eye": eye_loop.eye,
            "actuator": eye_loop.actuator,
            "what": what,
            "value": value,
            "sigma": deviation if value is not None and np.isfinite(deviation) else None,
            "unit": unit,
        }
