"""Making of a recording: a head looks at a board from many postures, each frame kept at once."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.head.gathered import Gathered
from vergence.calibration.head.logged import (
    AT_REST,
    LOOKS,
    PLACEMENT,
    SUFFIX,
    TARGET,
    logs_in,
    read_logs,
)
from vergence.calibration.head.outlook import Outlook, outlook
from vergence.calibration.head.plan import Plan, Scene, scene_of
from vergence.calibration.head.recording import in_order
from vergence.calibration.head.search import find_board, sees
from vergence.errors import ConfigurationError
from vergence.locks import locked
from vergence.models.boards import PlanarTarget
from vergence.models.joints import EYE_NAMES
from vergence.perception.located import orders_alike
from vergence.recording.looking import Looker, Sight
from vergence.recording.schema import LoggedDetection
from vergence.recording.writer import LogWriter

_DITHER_RAD: Final = np.deg2rad(0.3).item()
"""By how much an actuator is moved at most between the frames of a pose: several steps of a 12-bit
encoder, which scatters their errors, and little enough for the board to stay in view."""
_JUDGED: Final = 10
"""Poses after which the recording is judged again."""
_MOST_LOST: Final = 12
"""Poses one after the other without the board, after which it is taken to be gone."""
_GIVEN_UP: Final = 2
"""Looks of a pose without the board, after which the next pose is tried."""
_MOVED: Final = 0.01
"""Share of the image's width by which a board appears beside where it was that has been moved: a
fit to ten poses has it within a pixel or two."""


@dataclass(frozen=True, kw_only=True)
class CollectOptions:
    """How much is collected."""

    poses: int = 60
    """Poses of one place of the board, those of earlier runs among them."""
    frames: int = 8
    """Frames of a pose, in each of which all joints stand a little otherwise."""
    seed: int = 0
    """Seed of the postures; every run of a folder has a stream of its own."""
    until: float | None = None
    """Uncertainty of depth, in per cent, at which it is enough; None for all poses."""
    moved: bool = False
    """Whether the board has been moved since the last run of this folder."""

    def __post_init__(self) -> None:
        for name, value, most in (("poses", self.poses, 10_000), ("frames", self.frames, 100)):
            if not 1 <= value <= most:
                raise ConfigurationError(f"{name}: expected 1 to {most}, got {value}")
        if self.seed < 0:
            raise ConfigurationError(f"seed: expected a whole number from 0 on, got {self.seed}")
        if self.until is not None and not self.until > 0.0:
            raise ConfigurationError(f"until: expected a percentage above 0, got {self.until}")


@dataclass
class Collected:
    """What a recording holds by now."""

    folder: Path
    target: PlanarTarget
    placement: int
    """Number of the board's present place."""
    sights: list[Sight] = field(default_factory=list)
    places: list[int] = field(default_factory=list)
    """Of each sight, the number of the board's place."""
    poses: int = 0
    """Of the present place, those of earlier runs among them."""
    unseen: int = 0
    """Looks of this run in which neither eye saw the board."""
    outlook: Outlook | None = None
    """What the recording would tell; None while that is unknown."""

    def frames(self) -> HeadFrames:
        """All frames in their order."""
        return in_order(Gathered(self.target, self.sights, self.places, ()).frames())


def collect(
    looker: Looker,
    folder: Path,
    options: CollectOptions,
    facts: Mapping[str, str],
    *,
    progress: Callable[[float], None] = lambda fraction: None,
    judged: Callable[[Collected], None] = lambda found: None,
) -> Collected:
    """Make a recording, or go on with one.

    Args:
        looker: the head before the board.
        folder: of the recording; logs are added to those that are in it.
        options: how much.
        facts: what else the log is of.
        progress: called with the share of the poses done.
        judged: called each time that it is known what the recording would tell.

    Raises:
        VergenceError: there is no board, it has been moved, or the head fails; frames that were
            taken before are kept.
    """
    if not looker.head.actuation.count:
        raise ConfigurationError(
            f"expected a head whose eyes move, got {looker.head.name!r}, a fixed pair: "
            "vergence calibrate stereo is for such"
        )
    if not looker.target.size_known:
        raise ConfigurationError(
            f"target: expected a size in mm, which all lengths come from, got {looker.target}"
        )
    with locked(folder):
        found, number = _earlier(looker, folder, options.moved, facts.get(LOOKS, ""))
        if found.poses < options.poses and not _enough(found, options):
            _Run(looker, options, found, number).go(facts, progress, judged)
    return found


def _earlier(looker: Looker, folder: Path, moved: bool, looks: str) -> tuple[Collected, int]:
    """What a folder holds already, and the number of its next log."""
    if folder.exists() and not folder.is_dir():
        raise ConfigurationError(f"{folder}: expected a folder, got a file")
    logs = logs_in(folder) if any(folder.glob(f"*{SUFFIX}")) else []
    number = 1 + max((int(log.stem) for log in logs if log.stem.isdecimal()), default=0)
    found = Collected(folder, looker.target, 0)
    if logs:
        before = read_logs(logs, looker.head, looker.target)
        if before.looks != looks:
            raise ConfigurationError(
                f"{folder}: expected the head that it holds frames of ({before.looks.strip()}), "
                f"got another ({looks.strip()}): other --plant, --errors or --seed"
            )
        found.sights, found.places = list(before.sights), list(before.placement)
        found.placement = max(found.places, default=0) + (moved and bool(found.places))
        frames = in_order(before.frames())
        here = np.unique(before.placement).tolist()
        if found.placement in here:
            own = frames.placement == here.index(found.placement)
            found.poses = len(np.unique(frames.pose[own]))
        if len(np.unique(frames.pose)) >= _JUDGED:
            found.outlook = outlook(looker.head, frames)
    return found, number


def _enough(found: Collected, options: CollectOptions) -> bool:
    if options.until is None or found.outlook is None or found.poses < _JUDGED:
        return False
    return bool(found.outlook.depth_percent.max() <= options.until)


class _Run:
    """One run of a collection, with a log of its own."""

    def __init__(
        self, looker: Looker, options: CollectOptions, found: Collected, number: int
    ) -> None:
        self._looker, self._options, self._found, self._number = looker, options, found, number
        self._rng = np.random.default_rng([options.seed, number])
        used = [
            sight.positions
            for sight, place in zip(found.sights, found.places, strict=True)
            if place == found.placement
        ]
        self._plan = Plan(self._rng, _DITHER_RAD, np.array(used).reshape(-1, 7))
        # where the board was seen before is where it will be seen again
        self._first = self._last = find_board(looker, [looker.head.rest(), *used[-1:]])
        self._refuse_moved(self._last)
        # a looker's clock begins anew, and the frames of this run come after all others
        ended_s = max((sight.time_s for sight in found.sights), default=0.0)
        self._later_s = ended_s + 1.0 - float(self._last.time_s[0])

    def go(
        self,
        facts: Mapping[str, str],
        progress: Callable[[float], None],
        judged: Callable[[Collected], None],
    ) -> None:
        """See `collect`."""
        looker, options, found = self._looker, self._options, self._found
        facts = {
            TARGET: str(looker.target), PLACEMENT: str(found.placement), AT_REST: str(True), **facts
        }  # fmt: skip
        path = found.folder / f"{self._number:04d}{SUFFIX}"
        lost = 0
        with LogWriter(path, head=looker.head, facts=facts) as log:
            while found.poses < options.poses and not _enough(found, options):
                if self._pose(log):
                    lost, found.poses = 0, found.poses + 1
                    if found.poses % _JUDGED == 0 or found.poses == options.poses:
                        self._judge()
                        judged(found)
                    progress(found.poses / options.poses)
                else:
                    lost += 1
                if lost == _MOST_LOST:
                    raise ConfigurationError(
                        f"expected {looker.target} where it was, found it in none of the last "
                        f"{lost} poses: has it been moved (--moved), or covered?"
                    )

    def _pose(self, log: LogWriter) -> bool:
        """Look from the next posture; whether the board was there."""
        own = self._looker.head.actuation
        base = own.actuators_of(self._plan.next(self._scene()))
        moves = own.upper > own.lower
        kept: list[Sight] = []
        for number in range(self._options.frames):
            dither = self._rng.uniform(-_DITHER_RAD, _DITHER_RAD, 7) * moves
            q = own.joints_of(np.clip(base + dither, own.lower, own.upper))
            sight = self._looker.look(q)
            if sees(self._looker, sight):
                _keep(log, sight)
                kept.append(sight)
            else:
                self._found.unseen += 1
            if number + 1 == _GIVEN_UP and not kept:
                break
        self._found.sights += [one._replace(time_s=one.time_s + self._later_s) for one in kept]
        self._found.places += [self._found.placement] * len(kept)
        self._last = self._first  # where nothing was, what was seen last was another thing
        if kept:
            self._last = Gathered(self._looker.target, kept, [0] * len(kept), ()).frames()
        return bool(kept)

    def _scene(self) -> Scene:
        """Where the board stands: as all frames tell, or else as the last ones do."""
        fitted = self._fitted()
        return scene_of(self._looker.head, self._last) if fitted is None else fitted

    def _fitted(self) -> Scene | None:
        """Where a fit to all frames has the board; None without one of this place."""
        found = self._found
        here = np.unique(found.places).tolist()
        if found.outlook is None or found.placement not in here:
            return None
        place = here.index(found.placement)
        if place >= len(found.outlook.boards.translation):
            return None
        boards = found.outlook.boards
        corners = self._last.corners @ boards.rotation[place].T + boards.translation[place]
        return Scene(found.outlook.head, np.stack([corners, corners]), True)

    def _judge(self) -> None:
        found = self._found
        known = outlook(self._looker.head, found.frames(), found.outlook)
        found.outlook = known if known is not None else found.outlook

    def _refuse_moved(self, frame: HeadFrames) -> None:
        """Refuse a board that is not where the earlier frames of its place have it."""
        fitted, looker = self._fitted(), self._looker
        if fitted is None:
            return
        expected, looks = fitted.pixels(frame.positions[0]), frame.pixels[:, 0]
        # a board that looks the same when it is turned may be read in any of its orders
        orders = orders_alike(looker.target)
        away = min(float(np.nanmax(np.abs(looks[:, order] - expected))) for order in orders)
        if away > _MOVED * looker.head.cameras.size.max():
            raise ConfigurationError(
                f"expected {looker.target} where the frames in {self._found.folder} have it, "
                f"found it {away:.0f} px beside: has it been moved (--moved)?"
            )


def _keep(log: LogWriter, sight: Sight) -> None:
    """Put a sight on disk.

    Raises:
        ConfigurationError: that could not be done.
    """
    nothing, unknown = np.empty((0, 2)), np.full(2, np.nan)
    for eye, name in enumerate(EYE_NAMES):
        corners, sigma = sight.corners_px[eye], sight.sigma_px[eye]
        log.detection(
            LoggedDetection(
                eye=name,
                exposed_s=sight.time_s,
                ready_s=sight.time_s,
                positions=sight.positions,
                point_px=unknown,
                sigma_px=unknown,
                corners_px=nothing if corners is None else corners,
                corners_sigma_px=nothing if sigma is None else sigma,
            )
        )
    log.sync()
    if log.fault:
        raise ConfigurationError(log.fault)
