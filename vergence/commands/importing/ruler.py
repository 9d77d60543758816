"""`vergence import ruler`: make a head file from what a person measures."""

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import tyro

from vergence.commands.console import print_to_stderr
from vergence.commands.importing.head_output import HeadOutput
from vergence.commands.options import parse_size
from vergence.errors import ConfigurationError, UnknownNameError, VergenceError

if TYPE_CHECKING:
    from vergence.models.files.ruler import Ruler

_Mm = Annotated[float | None, tyro.conf.arg(metavar="MM", help_behavior_hint="")]
_Degrees = Annotated[float | None, tyro.conf.arg(metavar="DEG", help_behavior_hint="")]
_USUAL: Final = {
    "height": 100.0,
    "axes_ahead": 0.0,
    "lens_ahead": 20.0,
    "lens_above": 40.0,
    "pan": 80.0,
    "tilt": 45.0,
    "fps": 30.0,
}
"""Values of measures that nobody took (chosen: of two servos and a webcam a side)."""


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
    """Height of the lenses above the plate that carries the head."""
    axes_ahead: _Mm = None
    """Distance of the second axis (with --first pan, the tilt) ahead of the first."""
    lens_ahead: _Mm = None
    """Distance of the lenses ahead of the second axis."""
    lens_above: _Mm = None
    """Height of the lenses above the tilt axis."""
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
    """Range of a pan to either side."""
    tilt: _Degrees = None
    """Range of a tilt to either side."""
    speed: Annotated[float | None, tyro.conf.arg(metavar="RAD_S", help_behavior_hint="")] = None
    """Greatest speed of the joints; the servo's without load by default."""
    acceleration: Annotated[
        float | None, tyro.conf.arg(metavar="RAD_S2", help_behavior_hint="")
    ] = None
    """Greatest acceleration of the joints; by default that in the servo's table."""
    fps: Annotated[float | None, tyro.conf.arg(metavar="HZ", help_behavior_hint="")] = None
    """Images a second."""
    name: Annotated[str, tyro.conf.arg(metavar="NAME")] = ""
    """Name of the head; by default the name of its file."""

    def run(self) -> int:
        """Run the command."""
        from vergence.commands.importing.shown import print_measured_head
        from vergence.hardware.dynamixel.control_table import MODELS
        from vergence.models.files.head_toml import check_head_name, parse_head
        from vergence.models.files.ruler import ruler_to_toml

        self.check()
        name = self.name or self.out.stem
        check_head_name(name)
        ruler = self._measured(name)
        text = ruler_to_toml(ruler)
        head = parse_head(text)
        self.write(text, head)
        print_measured_head(head, self.out)
        self.print_paths()
        servo = f" --servo {ruler.servo.name}" if ruler.servo.name in MODELS.values() else ""
        robot = "robot.toml" if self.out.name == "desk.toml" else "desk.toml"
        print(
            "next: look at the drawing, then\n"
            f"  vergence gaze --head {self.out}\n"
            f"  vergence info --head {self.out}\n"
            f"  vergence emulate --head {self.out}{servo} --out {robot}"
        )
        return 0

    def _measured(self, name: str) -> "Ruler":
        """The measures, with what is missing asked for on a terminal."""
        from vergence.models.files.ruler import Ruler, check_measure, focal_of_view
        from vergence.models.servo_models import find_servo_model, others_of_family

        given = {key: value for key, value in vars(self).items() if value is not None}
        views = [key for key in ("view", "diagonal", "focal") if key in given]
        if len(views) > 1:
            raise ConfigurationError(
                f"{views[1]}: expected one of --view, --diagonal and --focal, got {views[0]} too"
            )
        for key in ("baseline", *_USUAL, "axes_apart", *views, "speed", "acceleration"):
            if key in given:
                check_measure(key, given[key])
        size, servo = parse_size(self.size), self.servo and find_servo_model(self.servo)
        missing = [key for key in ("baseline", "servo") if key not in given]
        missing += [] if views else ["view"]
        if missing and not sys.stdin.isatty():
            raise ConfigurationError(
                f"{missing[0]}: expected it as --{missing[0]}, got none; a head needs --baseline "
                "MM, --view DEG (or --diagonal DEG, --focal PX) and --servo MODEL; on a terminal "
                "the command asks for them"
            )
        if missing:
            given = _asked(given, has_view=bool(views))
            size, servo = parse_size(given["size"]), find_servo_model(given["servo"])
            views = [key for key in ("view", "diagonal", "focal") if key in given]
        assert servo
        size = size or (640, 480)
        view = views[0]
        focal = (
            given["focal"]
            if view == "focal"
            else focal_of_view(size, given[view], diagonal=view == "diagonal")
        )
        for other in others_of_family(servo):
            if servo.name.partition("-")[0] == given["servo"].upper():
                print_to_stderr(f"servo: taken as {servo.name}, not {other.name}")
        values = _USUAL | {key: given[key] for key in _USUAL if key in given}
        return Ruler(
            name=name,
            mount=given.get("mount", "turrets"),
            first=given.get("first", "pan"),
            baseline=given["baseline"],
            axes_apart=given.get("axes_apart", given["baseline"]),
            size=size,
            focal=focal,
            view_note=f"{view} {given[view]:g}{' px' if view == 'focal' else ' degrees'}",
            speed=given.get("speed", servo.speed_rad_s),
            acceleration=given.get("acceleration", servo.acceleration_rad_s2),
            servo=servo,
            assumed=tuple(key for key in _USUAL if key not in given),
            **values,
        )


_QUESTIONS: Final = (
    ("mount", "Two turrets, or two cameras on one neck", "turrets"),
    ("first", "The joint nearer to the plate: pan or tilt", "pan"),
    ("baseline", "Distance between the two lenses, mm", None),
    ("height", "Height of the lenses above the plate, mm", _USUAL["height"]),
    ("axes_ahead", "Distance of the second axis ahead of the first, mm", _USUAL["axes_ahead"]),
    ("lens_ahead", "Distance of the lenses ahead of the second axis, mm", _USUAL["lens_ahead"]),
    ("lens_above", "Height of the lenses above the tilt axis, mm", _USUAL["lens_above"]),
    ("size", "Image size in pixels", "640x480"),
    ("view", "Field of view in degrees: horizontal, or diagonal as 78d", None),
    ("servo", "Servo, such as XL330-M288, XL430, XM430-W350, STS3215 or hobby", None),
    ("pan", "Range of a pan to either side, degrees", _USUAL["pan"]),
    ("tilt", "Range of a tilt to either side, degrees", _USUAL["tilt"]),
)
"""Measure, question and usual answer, in the order in which they are asked."""


def _asked(given: dict[str, Any], *, has_view: bool) -> dict[str, Any]:
    """The measures with the answers to what is not given."""
    print("Measure with the head looking straight ahead. Enter takes the value in brackets.")
    answers = dict(given)
    for key, question, usual in _QUESTIONS:
        if key in given or (key == "view" and has_view):
            continue
        shown = "" if usual is None else f" [{usual if isinstance(usual, str) else f'{usual:g}'}]"
        while True:
            try:
                text = input(f"{question}{shown}: ").strip()
            except EOFError:
                raise ConfigurationError(f"{key}: expected an answer, got none") from None
            try:
                if text or isinstance(usual, str):
                    answers |= _answer(key, text or str(usual))
                elif usual is None:
                    raise ConfigurationError(f"{key}: expected an answer, got none")
                break
            except VergenceError as error:
                print_to_stderr(str(error))
    return answers


def _answer(key: str, text: str) -> dict[str, Any]:
    """The measure that an answer states, by its name."""
    from vergence.models.files.ruler import check_measure
    from vergence.models.servo_models import find_servo_model

    if key == "servo":
        find_servo_model(text)
        return {key: text}
    if key == "size":
        parse_size(text)
        return {key: text}
    choices = {"mount": ["turrets", "neck"], "first": ["pan", "tilt"]}.get(key)
    if choices is not None:
        if text not in choices:
            raise UnknownNameError(key, text, choices)
        return {key: text}
    if key == "view" and text.endswith("d"):
        key, text = "diagonal", text.removesuffix("d")
    try:
        return {key: check_measure(key, float(text))}
    except ValueError:
        raise ConfigurationError(f"{key}: expected a number, got {text!r}") from None
