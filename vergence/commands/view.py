"""`vergence view`: a head in the browser, simulated, recorded or live."""

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Protocol

import tyro

from vergence.commands.console import print_to_stderr
from vergence.commands.extras import require_modules
from vergence.errors import ConfigurationError

if TYPE_CHECKING:
    from vergence.viewer.browser import Server

LOOPBACK: Final = "127.0.0.1"
"""Address that browsers of this machine alone can reach."""
RUNS: Final = Path("runs")
"""Folder of the logs that are followed if none is named."""
_LEAST_PRIORITY: Final = 19
"""Niceness of a process that gives way to all others (physical: POSIX)."""
_MAX_PORT: Final = 65535
"""Greatest number of a port (physical: TCP)."""


class Shown(Protocol):
    """Something shown in the browser until it is told to end."""

    def run(self) -> None:
        """Show."""


@dataclass(frozen=True, kw_only=True)
class View:
    """Show a head in the browser: simulated, with a target to drag; recorded; or live."""

    recording: Annotated[
        Path | None, tyro.conf.Positional, tyro.conf.arg(help_behavior_hint="", metavar="PATH")
    ] = None
    """Run folder of a gaze or log of a robot to look at; none for a simulated head."""
    follow: bool = False
    """Show a running deployment from its log: PATH, or the newest log in runs/, also a later one.
    The robot does not notice."""
    head: Annotated[str, tyro.conf.arg(metavar="HEAD")] = "simulated"
    """Simulated head at first: a preset's name (see `vergence info`) or the path of a TOML file."""
    controller: Annotated[str, tyro.conf.arg(metavar="CONTROLLER")] = "saccade"
    """Controller of the simulated head at first (see `vergence info`)."""
    target: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="TARGET")] = None
    """What the simulated head looks at, see `vergence gaze --help`: a tag by default. Click in an
    eye's image above the head, and it looks there: point follows a point of the room."""
    scene: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="SCENE")] = None
    """What stands at the target's place in the room: ball:#RRGGBB:MM, poster:MM, poster:FILE:MM or
    room (nothing)."""
    wall: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE")] = None
    """Photograph on the room's front wall."""
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = LOOPBACK
    """Address to listen on; by default browsers of this machine alone can see the page."""
    port: Annotated[int, tyro.conf.arg(metavar="INT")] = 8080
    """Port to listen on; the next free one if it is taken."""
    browser: bool = True
    """Open the page in the browser."""

    def run(self) -> int:
        """Run the command."""
        require_modules("view", "viser")
        if not 0 <= self.port <= _MAX_PORT:
            raise ConfigurationError(f"port: expected 0 to {_MAX_PORT}, got {self.port}")
        prepare = self._follow if self.follow else self._play if self.recording else self._simulate
        import webbrowser

        from vergence.viewer.browser import address_of, serving

        make = prepare()
        # Ctrl-C is the usual way to end, not a failure
        with suppress(KeyboardInterrupt), serving(self.host, self.port) as server:
            shown = make(server)
            print_to_stderr(f"showing on {address_of(server)} until Ctrl-C")
            if self.browser:
                webbrowser.open(address_of(server))
            shown.run()
        return 0

    def _simulate(self) -> "Callable[[Server], Shown]":
        from vergence.models.head_file import load_head
        from vergence.viewer.playground import Playground
        from vergence.viewer.simulated import Setup

        named = {"look": self.target, "scene": self.scene, "wall": self.wall}
        seen = {name: str(value) for name, value in named.items() if value is not None}
        if self.target == "point":
            seen.setdefault("scene", "room")
        setup = Setup(head=load_head(self.head), controller=self.controller, seen=seen)
        return lambda server: Playground(server, setup)

    def _play(self) -> "Callable[[Server], Shown]":
        from vergence.viewer.playback import Playback
        from vergence.viewer.recorded import load_recorded

        assert self.recording is not None
        recorded = load_recorded(self.recording)
        return lambda server: Playback(server, recorded)

    def _follow(self) -> "Callable[[Server], Shown]":
        require_modules("robot", "mcap")
        _yield_processors()
        from vergence.viewer.live import LiveView

        path = self.recording or RUNS
        return lambda server: LiveView(server, path)


def _yield_processors() -> None:
    """Let this process run only when no other needs a processor, such as a robot's loop."""
    if hasattr(os, "SCHED_IDLE"):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    elif hasattr(os, "nice"):
        os.nice(_LEAST_PRIORITY)
