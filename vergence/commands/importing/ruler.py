"""`vergence import ruler`: make a head file from what a person measures."""

import shlex
import sys
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import tyro

from vergence.commands.console import print_to_stderr
from vergence.commands.importing.head_output import HeadOutput
from vergence.commands.options import parse_size
from vergence.errors import ConfigurationError, UnknownNameError, VergenceError

if TYPE_CHECKING:
    from vergence.models.ruler import Ruler

_Mm = Annotated[float | None, tyro.conf.arg(metavar="MM", help_behavior_hint="")]
_Degrees = Annotated[float | None, tyro.conf.arg(metavar="DEG", help_behavior_hint="")]


@dataclass(frozen=True, kw_only=True)
class ImportRuler(HeadOutput):
    """Make a head from a ruler and data sheets: two turrets, or two cameras on one neck.

    On a terminal the command asks for what is not given.
    """

    mount: Annotated[
        Literal["turrets", "neck"] | None, tyro.conf.arg(help_behavior_hint="(turrets)")
    ] = None
    """turrets: each eye has its own pan and tilt; neck: one pan and tilt turns both cameras."""
    first: Annotated[Literal["pan", "tilt"] | None, tyro.conf.arg(help_behavior_hint="(pan)")] = (
        None
    )
    """The joint nearer to the plate."""
    baseline: _Mm = None
    """Distance between the two lenses, looking straight ahead."""
    axes_apart: _Mm = None
    """Distance between the first axes of two turrets, if the lenses are not in line with them."""
    height: _Mm = None
    """Height of the lenses above the plate that carries the head; 100 by default."""
    axes_ahead: _Mm = None
    """Distance of the second axis (with --first pan, the tilt) ahead of the first; 0 by default."""
    lens_ahead: _Mm = None
    """Distance of the lenses ahead of the second axis; 20 by default."""
    lens_above: _Mm = None
    """Height of the lenses above the tilt axis; 40 by default."""
    size: Annotated[
        str | None, tyro.conf.arg(metavar="WIDTHxHEIGHT", help_behavior_hint="(640x480)")
    ] = None
    """Image size in pixels."""
    view: _Degrees = None
    """Horizontal field of view of these images."""
    diagonal: _Degrees = None
    """Diagonal field of view in its place, as data sheets of webcams state it."""
    focal: Annotated[float | None, tyro.conf.arg(metavar="PX", help_behavior_hint="")] = None
    """Focal length in pixels, in its place."""
    servo: Annotated[str | None, tyro.conf.arg(metavar="MODEL", help_behavior_hint="")] = None
    """Servo: XL330-M288, XL330-M077, XL430-W250, XC330-T288, XC330-T181, XC330-M288, XM430-W350,
    XM430-W210, STS3215 or hobby; the beginning of a name is enough."""
    pan: _Degrees = None
    """Range of a pan to either side; 80 by default."""
    tilt: _Degrees = None
    """Range of a tilt to either side; 45 by default."""
    speed: Annotated[float | None, tyro.conf.arg(metavar="RAD_S", help_behavior_hint="")] = None
    """Greatest speed of the joints; the servo's without load by default."""
    acceleration: Annotated[
        float | None, tyro.conf.arg(metavar="RAD_S2", help_behavior_hint="")
    ] = None
    """Greatest acceleration of the joints; by default that in the servo's table."""
    fps: Annotated[float | None, tyro.conf.arg(metavar="HZ", help_behavior_hint="")] = None
    """Images a second; 30 by default."""
    name: Annotated[str, tyro.conf.arg(metavar="NAME")] = ""
    """Name of the head; by default that of its file, or my-turrets."""

    def run(self) -> int:
        """Run the command."""
        from vergence.commands.importing.shown import print_measured_head
        from vergence.hardware.dynamixel.servos import DynamixelServos
        from vergence.models.head_file import check_head_name, parse_head
        from vergence.models.ruler import ruler_to_toml

        self.check()
        name = self.name or self.out.stem
        if name == "head":
            name = f"my-{self.mount or 'turrets'}"
        check_head_name(name)
        ruler = self._measured(name)
        text = ruler_to_toml(ruler)
        head = parse_head(text)
        self.write(text, head)
        print_measured_head(head, self.out)
        self.print_paths()
        servo = f" --servo {ruler.servo.name}" if ruler.servo.name in DynamixelServos.models else ""
        robot = "robot.toml" if self.out.name == "desk.toml" else "desk.toml"
        head_option = f"--head {shlex.quote(str(self.out))}"
        print(
            "next: look at the drawing, then\n"
            f"  vergence gaze {head_option}\n"
            f"  vergence info {head_option}\n"
            f"  vergence emulate {head_option}{servo} --out {robot}"
        )
        return 0

    def _measured(self, name: str) -> "Ruler":
        """The measures, with what is missing asked for on a terminal."""
        from vergence.models.ruler import (
            SERVO_MODELS,
            VIEWS,
            Ruler,
            check_measure,
            find_servo_model,
        )

        output = vars(HeadOutput())
        given = {k: v for k, v in vars(self).items() if v is not None and k not in output}
        for key, value in given.items():
            check_measure(key, value)
        if self.servo is not None:
            find_servo_model(self.servo)
        missing = [key for key in ("baseline", "servo") if key not in given]
        missing += [] if given.keys() & set(VIEWS) else ["view"]
        if missing and not sys.stdin.isatty():
            raise ConfigurationError(
                f"{missing[0]}: expected it as --{missing[0]}, got none; a head needs --baseline "
                "MM, --view DEG (or --diagonal DEG, --focal PX) and --servo MODEL; on a terminal "
                "the command asks for them"
            )
        if missing:
            given |= _answers(given, view_too="view" in missing)
        asked = given.pop("servo")
        servo = find_servo_model(asked)
        alike = [known for known in SERVO_MODELS if known.startswith(asked.upper())]
        if len(alike) > 1:
            print_to_stderr(f"servo: {servo.name} is taken of {', '.join(alike)}")
        if "size" in given:
            given["size"] = parse_size(given["size"])
        given["name"] = name
        return Ruler(servo=servo, measured=frozenset(given), **given)


_QUESTIONS: Final = {
    "mount": "Two turrets, or two cameras on one neck",
    "first": "The joint nearer to the plate: pan or tilt",
    "baseline": "Distance between the two lenses, mm",
    "height": "Height of the lenses above the plate, mm",
    "axes_ahead": "Distance of the second axis ahead of the first, mm",
    "lens_ahead": "Distance of the lenses ahead of the second axis, mm",
    "lens_above": "Height of the lenses above the tilt axis, mm",
    "size": "Image size in pixels",
    "view": "Field of view in degrees: horizontal, or diagonal as 78d",
    "servo": "Servo, such as XL330-M288, XL430, XM430-W350, STS3215 or hobby",
    "pan": "Range of a pan to either side, degrees",
    "tilt": "Range of a tilt to either side, degrees",
}
"""Questions about the measures, in the order in which they are asked."""


def _answers(given: Mapping[str, object], *, view_too: bool) -> dict[str, Any]:
    """Answers to the questions about what is not given, by measure."""
    from vergence.models.ruler import Ruler

    usual = {one.name: one.default for one in fields(Ruler) if one.default not in (None, MISSING)}
    print("Measure with the head looking straight ahead. Enter takes the value in brackets.")
    answers: dict[str, Any] = {}
    for key, question in _QUESTIONS.items():
        if key in given or (key == "view" and not view_too):
            continue
        shown = {"size": "640x480"}.get(key, usual.get(key))
        while True:
            try:
                text = input(f"{question}{'' if shown is None else f' [{shown}]'}: ").strip()
            except EOFError:
                raise ConfigurationError(f"{key}: expected an answer, got none") from None
            if not text and shown is not None:
                break
            try:
                answers |= _answer(key, text)
                break
            except VergenceError as error:
                print_to_stderr(str(error))
    return answers


def _answer(key: str, text: str) -> dict[str, Any]:
    """The measure that an answer states, by its name."""
    from vergence.models.ruler import check_measure, find_servo_model

    if key in ("servo", "size"):
        find_servo_model(text) if key == "servo" else parse_size(text)
        return {key: text}
    choices = {"mount": ["turrets", "neck"], "first": ["pan", "tilt"]}.get(key)
    if choices is not None:
        if text not in choices:
            raise UnknownNameError(key, text, choices)
        return {key: text}
    if key == "view" and text.endswith("d"):
        key, text = "diagonal", text.removesuffix("d")
    try:
        value = float(text)
    except ValueError:
        raise ConfigurationError(f"{key}: expected a number, got {text!r}") from None
    check_measure(key, value)
    return {key: value}
