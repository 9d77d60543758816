"""Every error that vergence raises on purpose."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches


class VergenceError(Exception):
    """Root of the package's errors: a message says what was expected and what came."""

    @property
    def lines(self) -> tuple[str, ...]:
        """The message, a line for each thing that is wrong."""
        return (str(self),)


class VergenceWarning(UserWarning):
    """An argument that has an answer, but hardly the one that was meant."""


class HeadFileError(VergenceError):
    """A head preset or TOML file that cannot be a head.

    Attributes:
        key: the dotted key at fault, or the file's path when it is not about one key.
        value: what stood there.
        expected: what should stand there.
        file: the file that the key is in; empty for text without a file.
    """

    def __init__(self, key: str, value: object, expected: str, file: str = "") -> None:
        where = f"{file}: {key}" if file else key
        super().__init__(f"{where}: expected {expected}, got {_shown(value)}")
        self.key = key
        self.value = value
        self.expected = expected
        self.file = file

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:
        return type(self), (self.key, self.value, self.expected, self.file)


class Words(str):
    """What a message says as it is, without quotes, in place of a value."""

    def __repr__(self) -> str:
        return str(self)


class UnreadableFileError(HeadFileError):
    """A file that is not there or cannot be read: its key is the path, its value the reason."""

    def __init__(self, key: str, value: object, expected: str, file: str = "") -> None:
        super().__init__(key, value, expected, file)
        self.args = (f"{key}: {value}; expected {expected}",)


class MistakesError(HeadFileError):
    """Several mistakes of one file.

    Attributes:
        mistakes: what each would raise alone.
    """

    def __init__(self, file: str, mistakes: Sequence[VergenceError]) -> None:
        super().__init__(file, Words(f"{len(mistakes)} mistakes"), "a file without mistakes")
        self.mistakes = tuple(mistakes)
        self.args = ("\n".join(self.lines),)

    @property
    def lines(self) -> tuple[str, ...]:
        """A line for each mistake."""
        return tuple(line for mistake in self.mistakes for line in mistake.lines)

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:
        return type(self), (self.key, self.mistakes)


class UnknownNameError(VergenceError):
    """A name that is not in a registry: a preset, a plant, a controller, a target.

    Attributes:
        kind: what was looked up.
        name: the name that was not found.
        known: the names that exist.
    """

    def __init__(self, kind: str, name: object, known: list[str]) -> None:
        super().__init__(
            f"{kind}: expected one of {', '.join(known)}, got {name!r}{did_you_mean(name, known)}"
        )
        self.kind = kind
        self.name = name
        self.known = known

    def __reduce__(self) -> tuple[type, tuple[str, object, list[str]]]:
        return type(self), (self.kind, self.name, self.known)


class ConfigurationError(VergenceError):
    """An argument or option with a value that cannot work."""


class TargetError(ConfigurationError):
    """A target that a head cannot look at, or not see when a trial begins."""


class DivergedError(VergenceError):
    """A training whose network has come to numbers that are not finite."""


class HardwareError(VergenceError):
    """A robot that does not answer, or that reports a fault."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that is wrong with a robot, found before it moves."""

    part: str
    """The part at fault, such as "servos: left_pan", "bus" or "cameras.left"."""
    problem: str
    """What was expected and what came."""
    cure: str = ""
    """What to do about it; empty where nothing is known."""
    warning: bool = False
    """Whether the robot may move all the same."""

    def __str__(self) -> str:
        cure = f"; cure: {self.cure}" if self.cure else ""
        return f"{self.part}: {self.problem}{cure}"


class ChecksFailedError(HardwareError):
    """A robot that must not move yet.

    Attributes:
        findings: all that was found, errors first; at least one is an error.
    """

    def __init__(self, findings: Iterable[Finding]) -> None:
        self.findings = tuple(sorted(findings, key=lambda finding: finding.warning))
        super().__init__("\n".join(self.lines))

    @property
    def lines(self) -> tuple[str, ...]:
        """A line for each finding; those of warnings say so."""
        return tuple(f"{'warning: ' if one.warning else ''}{one}" for one in self.findings)

    def __reduce__(self) -> tuple[type, tuple[tuple[Finding, ...]]]:
        return type(self), (self.findings,)


class RenderingUnavailableError(VergenceError):
    """A picture was asked for that needs software or hardware that is not there."""


class BundleError(VergenceError):
    """A bundle or network file that is damaged, not allowed, or made for something else."""


class ControllerError(VergenceError):
    """A controller of somebody's own that cannot be made, raises or answers what cannot be.

    The message names the place in that controller's code.
    """


_LONGEST = 200
"""Characters of a value that a message shows."""


def _shown(value: object) -> str:
    try:
        text = repr(value)
    except ValueError:  # Python refuses to write out integers of thousands of digits
        return "a number of thousands of digits"
    except RecursionError:
        return "values nested too deep"
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """A question about the known name that looks most like another one; empty if none does."""
    close = get_close_matches(str(name), list(known), n=1, cutoff=0.7)
    return f" (did you mean {close[0]}?)" if close else ""


def how_to_install(extra: str) -> str:
    """What to type for an optional part, from a registry or from a clone."""
    return f"pip install 'vergence[{extra}]' (in a clone: pip install '.[{extra}]')"


def refuse_unknown(owner: str, fields: Mapping[str, object], known: Iterable[str]) -> None:
    """Refuse a field that is not known.

    Args:
        owner: what has the fields, as a message calls it.
        fields: values by name.
        known: the names that there are.

    Raises:
        ConfigurationError: a field is another.
    """
    names = list(known)
    for name, value in fields.items():
        if name not in names:
            raise ConfigurationError(
                f"{owner}.{name}: expected one of {', '.join(names)}, got {name!r} = {value!r}"
                f"{did_you_mean(name, names)}"
            )
