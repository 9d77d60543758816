"""Servo models: speed, acceleration, resolution and play from data sheets, with their sources.

Speeds are those without load. No data sheet gives an acceleration: where the rotor's inertia at the
output is published, it is half the stall torque over that inertia, else assumed.
"""

import re
from math import pi, tau
from typing import Final, NamedTuple

from vergence.errors import UnknownNameError

_STEPS_4096_RAD: Final = tau / 4096
_DYNAMIXEL_SPEED_RAD_S: Final = 0.229 * tau / 60
_MANUAL: Final = "ROBOTIS e-Manual, emanual.robotis.com/docs/en/dxl/x/"
_SAME: Final = "assumed, as for the XL430 of the preset turrets"


class ServoModel(NamedTuple):
    """What a data sheet says of a servo.

    Attributes:
        name: the maker's name.
        rev_min: speed without load, rev/min.
        volts: supply at that speed, V.
        acceleration_rad_s2: greatest acceleration, rad/s^2.
        source: origin of speed and resolution.
        acceleration_source: origin of the acceleration.
        backlash_deg: play of the gears, degrees; 0 where it is not stated.
        angle_step_rad: step of the reported angle, rad.
        speed_step_rad_s: step of speeds, rad/s.
    """

    name: str
    rev_min: float
    volts: float
    acceleration_rad_s2: float
    source: str
    acceleration_source: str
    backlash_deg: float = 0.0
    angle_step_rad: float = _STEPS_4096_RAD
    speed_step_rad_s: float = _DYNAMIXEL_SPEED_RAD_S

    @property
    def speed_rad_s(self) -> float:
        """Speed without load, rad/s."""
        return self.rev_min * tau / 60


SERVO_MODELS: Final = {
    model.name: model
    for model in (
        ServoModel(
            "XL330-M288", 103.0, 5.0, 144.0, f"{_MANUAL}xl330-m288",
            "half of 0.52 N m over 0.0018 kg m^2, the rotor's in the MuJoCo model of Reachy Mini",
        ),
        ServoModel("XL330-M077", 383.0, 5.0, 144.0, f"{_MANUAL}xl330-m077", "as the XL330-M288"),
        ServoModel("XL430-W250", 57.0, 11.1, 80.0, f"{_MANUAL}xl430-w250", "assumed"),
        ServoModel("XC330-T288", 65.0, 11.1, 80.0, f"{_MANUAL}xc330-t288", _SAME),
        ServoModel("XC330-T181", 104.0, 11.1, 80.0, f"{_MANUAL}xc330-t181", _SAME),
        ServoModel("XC330-M288", 81.0, 5.0, 80.0, f"{_MANUAL}xc330-m288", _SAME),
        ServoModel(
            "XM430-W350", 46.0, 12.0, 45.0, f"{_MANUAL}xm430-w350",
            "half of 4.1 N m over 0.045 kg m^2, the rotor's in MuJoCo Menagerie's robotis_op3",
            backlash_deg=0.25,
        ),
        ServoModel(
            "XM430-W210", 77.0, 12.0, 45.0, f"{_MANUAL}xm430-w210", "as the XM430-W350",
            backlash_deg=0.25,
        ),
        ServoModel(
            "STS3215", 45.0, 12.0, 52.0, "Feetech's data sheet of the STS3215-C018",
            "half of 2.94 N m over 0.028 kg m^2, the rotor's in the MuJoCo model of the SO-101 arm",
            backlash_deg=0.5, speed_step_rad_s=_STEPS_4096_RAD,
        ),
        ServoModel(
            "hobby", 59.0, 4.8, 80.0,
            "Tower Pro's data sheet of the MG996R: 0.17 s for 60 degrees, dead band 5 us; it tells "
            "no angle, so it can be simulated, and not deployed on",
            _SAME, backlash_deg=0.5, angle_step_rad=0.5 * pi / 180, speed_step_rad_s=0.0,
        ),
    )
}  # fmt: skip
"""Servo models by name, the usual one of a family first."""


def find_servo_model(text: str) -> ServoModel:
    """Model of a name, or of the beginning of one: XL330, XL430-W250-T, sts3215.

    Raises:
        UnknownNameError: there is none in the table.
    """
    asked = re.sub(r"[^a-z0-9]", "", text.lower())
    for model in SERVO_MODELS.values():
        name = re.sub(r"[^a-z0-9]", "", model.name.lower())
        if asked and (name.startswith(asked) or asked in (name + "t", name + "r")):
            return model
    raise UnknownNameError("servo", text, list(SERVO_MODELS))
