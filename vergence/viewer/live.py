"""The live viewer of a robot: it reads the log that `vergence deploy` writes, and nothing else."""

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np
import viser

from vergence.envs.reading import Truth
from vergence.envs.task import EyeImages
from vergence.errors import VergenceError
from vergence.models.parts import FloatArray
from vergence.recording.events import LoopHealth
from vergence.recording.follow import (
    Click,
    FollowedImage,
    FollowedReading,
    LogFollower,
    NewEvents,
    newest_log,
    write_click,
)
from vergence.recording.log import read_jpeg
from vergence.viewer.head_view import SHOWN_HZ, HeadView
from vergence.viewer.moment import Moment, moment_of_reading

_SILENT_S: Final = 1.0
"""Time without news after which it is stated, s (chosen: far beyond the writer's 50 ms)."""
_MOST_REMARKS: Final = 6
"""Most faults and warnings shown (chosen: legible)."""
_SEARCH_PERIOD_S: Final = 0.5
"""Time between two searches for a log, s (chosen: prompt against load)."""
_UNKNOWN: Final = Truth._make(part[0] for part in Truth.unknown(1))


class LiveView:
    """A running robot in the browser, read from its log.

    Args:
        server: server of the browsers.
        path: the log, or a folder whose newest log is followed, also a newer one later.
        clock: a monotonic clock, s, the robot's own on the same machine.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        path: Path,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._server, self._path, self._clock = server, path, clock
        self._words = server.gui.add_markdown(f"waiting for a log at {path}")
        self._followed: _FollowedRobot | None = None
        self._searched_s = -np.inf

    @property
    def words(self) -> str:
        """State in words, as shown, in Markdown."""
        return str(self._words.content)

    @property
    def shown(self) -> int:
        """Number of moments shown of the present log."""
        view = None if self._followed is None else self._followed.view
        return 0 if view is None else view.shown

    def run(self, until: Callable[[], bool] = lambda: False) -> None:
        """Follow until told otherwise.

        Args:
            until: called at least 30 times a second; True ends the following.
        """
        while not until():
            begun_s = self._clock()
            if begun_s - self._searched_s > _SEARCH_PERIOD_S:
                self._searched_s = begun_s
                self._search()
            if self._followed is not None:
                self._words.content = "  \n".join(self._followed.update())
            time.sleep(max(0.0, 1.0 / SHOWN_HZ - (self._clock() - begun_s)))
        if self._followed is not None:
            self._followed.close()

    def _search(self) -> None:
        """Go over to a log that has appeared, as soon as its head can be read."""
        found = newest_log(self._path) if self._path.is_dir() else self._path
        followed = self._followed
        try:
            if found is None or (followed is not None and not followed.is_older_than(found)):
                return
            with LogFollower(found) as later:
                later.poll()
            if later.head is None:
                return
            view = None if followed is None else followed.view
            self._followed = _FollowedRobot(self._server, found, self._clock, view)
        except (OSError, VergenceError) as error:  # such as a file that is something else
            if followed is None:
                self._words.content = f"waiting for a log at {self._path}  \n**{error}**"
            return
        if followed is not None:
            followed.close()


class _FollowedRobot:
    """A log that is followed, and the page that shows it.

    Args:
        server: server of the browsers.
        path: the log.
        clock: the robot's clock, s.
        view: the page of the log before; None for the first.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        path: Path,
        clock: Callable[[], float],
        view: HeadView | None,
    ) -> None:
        self.path, self._server, self._clock = path, server, clock
        self._log = LogFollower(path)
        self._inode, self._written_ns = path.stat().st_ino, 0
        self.view, self._begun = view, False
        self._health: LoopHealth | None = None
        self._newest: FollowedReading | None = None
        self._first_s = np.nan
        self._truth = _UNKNOWN
        self._images: list[tuple[float, Any] | None] = [None, None]
        self._faults: list[str] = []
        self._warnings: dict[str, str] = {}

    def is_older_than(self, path: Path) -> bool:
        """True if a file is another log than this one, written to later.

        Raises:
            OSError: there is no such file.
        """
        with suppress(OSError):  # deleted
            own = self.path.stat()
            if own.st_ino == self._inode:
                self._written_ns = own.st_mtime_ns
        other = path.stat()
        return other.st_ino != self._inode and other.st_mtime_ns > self._written_ns

    def close(self) -> None:
        """Stop following; the page stays."""
        self._log.close()

    def update(self) -> list[str]:
        """Show what is new, and return the state in lines of Markdown."""
        try:
            events = self._log.poll()
        except VergenceError as error:
            events = None
            self._faults.append(str(error))
        head = self._log.head
        if head is None:
            return [f"waiting for the head in {self.path.name}", *self._faults]
        if self._health is None:
            self._health = LoopHealth(head)
        if events is not None:
            self._take(events)
            shown = self._moment()
            if shown is not None:
                if self.view is None:  # not before there is something to draw
                    self.view = HeadView(self._server, head, self._look_at)
                elif not self._begun:
                    self.view.change_head(head)
                self._begun = True
                self.view.show(shown, [])
        return self._describe()

    def _look_at(self, eye: int, pixel: FloatArray) -> None:
        """Leave a click in an eye's newest image for the robot, see `vergence deploy`."""
        image = self._images[eye]
        exposed_s = self._now_s() if image is None else image[0]
        with suppress(OSError):
            write_click(self.path, Click(eye, pixel, exposed_s))

    def _take(self, events: NewEvents) -> None:
        assert self._health is not None
        for one in events.readings:
            self._health.add(one.reading)
            self._newest = one
        if events.truths:
            self._truth = events.truths[-1]
        for eye, image in enumerate(events.images):
            if image is not None:
                self._images[eye] = _decoded(image) or self._images[eye]
        self._faults += [f"fault: {reason}" for reason in events.stop_reasons]
        said = " ".join(self._faults)  # a fault is noted by the robot's loggers, too
        for note in events.notes:
            kind, _, rest = note.message.partition(": ")
            if not rest or rest not in said:
                self._warnings.pop(kind, None)
                self._warnings[kind] = note.message  # the newest of a kind, such as missed periods

    def _moment(self) -> Moment | None:
        """The newest moment; None before the first reading."""
        if self._newest is None or self._log.head is None:
            return None
        reading, now_s = self._newest.reading, self._now_s()
        left, right = self._images
        images, age_s = None, 0.0
        if left is not None and right is not None:
            images = EyeImages(left[1], right[1], False)
            age_s = max(0.0, now_s - min(left[0], right[0]))
        truth = self._truth
        if abs(float(truth.time_s) - float(reading.time_s)) > self._log.head.timing.period_s:
            truth = _UNKNOWN
        shown = moment_of_reading(self._log.head, reading, truth, images, age_s)
        if np.isnan(self._first_s):
            self._first_s = now_s
        return shown._replace(time_s=now_s - self._first_s)

    def _describe(self) -> list[str]:
        assert self._health is not None
        facts = self._log.facts
        lines = [f"**{self.path.name}**: {facts.get('controller', '?')}, read-only"]
        if self._newest is not None:
            number = f"gaze {self._newest.trial}, " if self._newest.trial else ""
            lines.append(f"{number}{self._newest.reading.time_s:.1f} s")
            silent_s = self._clock() - self._now_s()
            if self._log.closed:
                lines.append("the log is closed")
            elif silent_s > _SILENT_S:
                lines.append(f"**no reading for {silent_s:.0f} s**")
        lines += self._health.words()
        shown_s = 0.0 if self._newest is None else self._now_s() - self._first_s
        if self._images == [None, None] and shown_s > _SILENT_S:
            lines.append("no images in the log: deploy --images logs them")
        remarks = [*self._faults, *self._warnings.values()][:_MOST_REMARKS]
        return lines + [f"**{remark}**" for remark in remarks]

    def _now_s(self) -> float:
        """Time of the newest reading, s of the robot's clock."""
        assert self._newest is not None
        return self._newest.begun_s + float(self._newest.reading.time_s)


def _decoded(image: FollowedImage) -> tuple[float, Any] | None:
    pixels = read_jpeg(image.jpeg)
    return None if pixels is None else (image.exposed_s, pixels)
