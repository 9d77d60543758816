"""All errors that vergence raises deliberately."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches


class VergenceError(Exception):
    """Base class of the package's errors; messages state the expected and the actual value.

    Examples:
        >>> import vergence
        >>> try:
        ...     vergence.load_head("turret")
        ... except vergence.VergenceError as error:
        ...     print(str(error).split(", ")[-1])
        got 'turret' (did you mean turrets?)
    """

    _lines: tuple[str, ...] = ()

    @property
    def lines(self) -> tuple[str, ...]:
        """The message, one line per problem."""
        return self._lines or (str(self),)

    def __reduce__(self) -> tuple[object, ...]:
        # pickled with message and attributes, and made again without a call of `__init__`
        return type(self).__new__, (type(self), *self.args), vars(self)


class VergenceWarning(UserWarning):
    """An argument that is valid but probably not intended.

    Examples:
        >>> import warnings, vergence
        >>> head = vergence.load_head("simulated")
        >>> with warnings.catch_warnings(record=True) as caught:
        ...     warnings.simplefilter("always")
        ...     q = head.fixate([0.0, -100.0, 1000.0])
        >>> print(str(caught[0].message).split(": ")[-1])
        is it in millimetres?
    """


class HeadFileError(VergenceError):
    """An invalid head preset or TOML file; without a single key at fault, `key` is its path."""

    def __init__(self, key: str, value: object, expected: str, file: str = "") -> None:
        where = f"{file}: {key}" if file else key
        super().__init__(f"{where}: expected {expected}, got {_shown(value)}")
        self.key, self.value, self.expected, self.file = key, value, expected, file


class UnquotedText(str):
    """Text that a message shows in place of a value, without quotes."""

    def __repr__(self) -> str:
        return str(self)


class UnreadableFileError(VergenceError):
    """A file that is missing or cannot be read."""

    def __init__(self, path: str, reason: object, expected: str) -> None:
        super().__init__(f"{path}: {reason}; expected {expected}")
        self.path, self.reason, self.expected = path, reason, expected


class MistakesError(HeadFileError):
    """Several mistakes in one file."""

    def __init__(self, file: str, mistakes: Sequence[VergenceError]) -> None:
        super().__init__(file, UnquotedText(f"{len(mistakes)} mistakes"), "a file without mistakes")
        self.mistakes = tuple(mistakes)
        self._lines = tuple(line for mistake in mistakes for line in mistake.lines)
        self.args = ("\n".join(self._lines),)


class UnknownNameError(VergenceError):
    """A name that is not in a registry: a preset, a plant, a controller, a target."""

    def __init__(self, kind: str, name: object, known: list[str]) -> None:
        super().__init__(
            f"{kind}: expected one of {', '.join(known)}, got {name!r}{did_you_mean(name, known)}"
        )
        self.kind, self.name, self.known = kind, name, known


class ConfigurationError(VergenceError):
    """An argument or option with an invalid value."""


class UnexpectedArgumentError(ConfigurationError, TypeError):
    """A keyword argument that a callable does not take; a `TypeError` in Python's words as well."""


class UnreachableTargetError(ConfigurationError):
    """A target that a head cannot look at, or that is not visible at the start of a trial."""


class PointRefusedError(ConfigurationError):
    """A point of an image that cannot be followed or found in the other eye, and the reason."""


class TrainingDivergedError(VergenceError):
    """Training has diverged: the network holds or outputs nan or infinity."""


class HardwareError(VergenceError):
    """A robot that does not answer, or that reports a fault."""


class ServoRefusalError(HardwareError):
    """A servo that answers an instruction with an error."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A problem of a robot, found by a check before it moves."""

    part: str  # the part at fault, such as "servos: left_pan", "bus" or "cameras.left"
    problem: str
    cure: str = ""
    warning: bool = False  # true if the robot may move nevertheless

    def __str__(self) -> str:
        cure = f"; cure: {self.cure}" if self.cure else ""
        return f"{self.part}: {self.problem}{cure}"


class ChecksFailedError(HardwareError):
    """A robot that must not move yet; its findings begin with errors, of which there is one."""

    def __init__(self, findings: Iterable[Finding]) -> None:
        self.findings = tuple(sorted(findings, key=lambda finding: finding.warning))
        self._lines = tuple(f"{'warning: ' * one.warning}{one}" for one in self.findings)
        super().__init__("\n".join(self._lines))


class MujocoUnavailableError(VergenceError):
    """MuJoCo is missing, of another version, or damaged; the message has the cure."""


class RenderingUnavailableError(VergenceError):
    """Software or hardware for rendering a picture is missing."""


class BundleError(VergenceError):
    """A bundle or network file that is damaged, not allowed, or made for something else."""


class OtherHeadError(BundleError, ConfigurationError):
    """A network that was trained for another head."""


class UserControllerError(VergenceError):
    """A user's own controller that cannot be created, raises an error, or returns invalid values.

    The message names the place in that controller's code.
    """


def _shown(value: object) -> str:
    try:
        text = repr(value)
    except ValueError:  # Python refuses to write out integers of thousands of digits
        return "a number of thousands of digits"
    except RecursionError:
        return "values nested too deep"
    return text if len(text) <= 200 else f"{text[:200]} ..."  # (chosen: detail against length)


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Question that suggests the known name most similar to a name; empty if none is similar."""
    close = get_close_matches(str(name), list(known), n=1, cutoff=0.7)
    return f" (did you mean {close[0]}?)" if close else ""


def how_to_install(extra: str) -> str:
    """Command that installs an optional part, from a registry or from a clone."""
    return f"pip install 'vergence[{extra}]' (in a clone: pip install '.[{extra}]')"


def refuse_unknown(owner: str, fields: Mapping[str, object], known: Iterable[str]) -> None:
    """Raise a `ConfigurationError` for a field of an owner that is not among the known names."""
    names = list(known)
    for name, value in fields.items():
        if name not in names:
            raise ConfigurationError(
                f"{owner}.{name}: expected one of {', '.join(names)}, got {name!r} = {value!r}"
                f"{did_you_mean(name, names)}"
            )
