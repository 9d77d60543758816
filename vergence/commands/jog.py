"""`vergence jog`: turn one joint at a time by small steps, to find signs and zeros."""

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, TextIO

import tyro

from vergence import interrupts
from vergence.commands.console import print_to_stderr
from vergence.commands.extras import require_modules
from vergence.errors import ConfigurationError, VergenceError, did_you_mean

if TYPE_CHECKING:
    from vergence.hardware.jog import Jogger as Joints

_HELP: Final = """\
NAME      go on with this joint
+ and -   turn it by a step
step RAD  take another step
flip      take the other sign: + turned the joint backwards
zero      take the present posture for its zero
off       switch its torque off, to turn it by hand
list      show all joints
write     write signs and zeros into the configuration
quit      leave; torque stays as it is"""
_COMMANDS: Final = ("+", "-", "step", "flip", "zero", "off", "list", "write", "quit", "help")


@dataclass(frozen=True, kw_only=True)
class Jog:
    """Turn one joint at a time by small steps to find signs and zeros; `help` lists commands."""

    config: Annotated[Path, tyro.conf.arg(metavar="PATH")]
    """Configuration of the robot; `write` saves signs and zeros in it."""
    step: Annotated[float, tyro.conf.arg(metavar="RAD")] = 0.05
    """Rotation of a joint per step, rad."""

    def run(self) -> int:
        """Run the command."""
        require_modules("robot", "tomlkit")
        import time

        from vergence.hardware.checks import check_servos, raise_errors
        from vergence.hardware.config import load_hardware
        from vergence.hardware.jog import Jogger as Joints

        config = load_hardware(self.config)
        step_rad = _step(self.step)
        interrupts.raise_on_termination()
        servos, session = config.make_servos(time.monotonic), None
        servos.open()
        try:
            findings = check_servos(config, servos, check_joint_in_limits=False)
            for finding in raise_errors(findings):
                print_to_stderr(f"warning: {finding}")
            session = JogSession(Joints(config, servos), self.config, step_rad, _say)
            session.print_introduction()
            _execute_all(session, sys.stdin)
            session.warn_if_unwritten()
        except KeyboardInterrupt:
            if session is not None and session.wrote:
                raise KeyboardInterrupt(f"{self.config} is written") from None
            raise
        finally:
            servos.close()
        return int(session.failed and not sys.stdin.isatty())


class JogSession:
    """Interpreter for the interactive commands of `vergence jog`; `say` prints a line."""

    def __init__(
        self, jog: "Joints", path: Path, step_rad: float, say: Callable[[str], None]
    ) -> None:
        self.name = next(iter(jog.servos))  # joint that commands apply to
        self.failed = self.wrote = False  # a command failed; the configuration was written
        self._jog, self._path, self._step_rad, self._say = jog, path, step_rad, say
        self._written = dict(jog.servos)

    def print_introduction(self) -> None:
        """Show the joints."""
        self._say("one joint at a time, without limits: keep a hand at the power; help lists words")
        self._list()

    def execute_line(self, line: str) -> bool:
        """Carry out one line; return False if it is `quit`."""
        words = line.split()
        if words[:1] == ["quit"]:
            return False
        try:
            self._execute(words)
        except (VergenceError, OSError) as error:
            self.failed = True
            self._say(f"error: {error}")
        return True

    def warn_if_unwritten(self) -> None:
        """Warn if signs and zeros were changed but not written."""
        if self._jog.servos != self._written:
            self._say(f"left without write: {self._path} has the signs and zeros that it had")

    def _execute(self, words: list[str]) -> None:
        match words:
            case []:
                pass
            case ["+" | "-" as word]:
                self._jog.step(self.name, math.copysign(self._step_rad, 1 if word == "+" else -1))
                self._show(self.name)
            case ["step", value]:
                self._step_rad = _step(value)
            case ["flip"]:
                self._jog.flip_sign(self.name)
                self._show(self.name)
            case ["zero"]:
                self._jog.set_zero(self.name)
                self._show(self.name)
            case ["off"]:
                self._jog.torque_off(self.name)
                self._say(f"{self.name}: torque is off: what hangs on it may sink")
            case ["list"]:
                self._list()
            case ["write"]:
                self._write()
            case ["help"]:
                self._say(_HELP)
            case [name] if name in self._jog.servos:
                self.name = name
                self._show(name)
            case _:
                self._refuse(" ".join(words))

    def _write(self) -> None:
        from vergence.hardware.config import write_servos

        write_servos(self._path, self._jog.servos.values())
        self._written, self.wrote = dict(self._jog.servos), True
        self._say(f"written to {self._path}")

    def _list(self) -> None:
        for name in self._jog.servos:
            self._show(name)

    def _show(self, name: str) -> None:
        servo = self._jog.servos[name]
        self._say(
            f"{name}: {round(self._jog.angle(name), 3) + 0.0:.3f} rad of {servo.lower_rad:.3f} to "
            f"{servo.upper_rad:.3f}, position {servo.position_text(self._jog.position(name))}, "
            f"{servo.zero_key} {servo.zero:g}, sign {servo.sign}"
        )

    def _refuse(self, text: str) -> None:
        known = [*_COMMANDS, *self._jog.servos]
        raise ConfigurationError(
            f"expected one of {', '.join(known)}, got {text!r:.80}{did_you_mean(text, known)}"
        )


def _step(value: str | float) -> float:
    from vergence.hardware.jog import MOST_STEP_RAD

    try:
        step_rad = float(value)
    except ValueError:
        step_rad = math.nan
    if not 0.0 < step_rad <= MOST_STEP_RAD:
        raise ConfigurationError(
            f"step: expected radians above 0 up to {MOST_STEP_RAD:g} (is it in degrees?), got "
            f"{value!r:.80}"
        )
    return step_rad


def _say(text: str) -> None:
    print(text, flush=True)


def _execute_all(session: JogSession, stream: TextIO) -> None:
    """Carry out the lines of a stream until its end, with a prompt on a terminal."""
    while True:
        if stream.isatty():
            print(f"{session.name}> ", end="", file=sys.stderr, flush=True)
        line = stream.readline()
        if not line or not session.execute_line(line):
            return
