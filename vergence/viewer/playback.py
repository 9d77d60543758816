"""The viewer of a recording: play, pause, scrub."""

import queue
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import numpy as np
import viser

from vergence.models.parts import FloatArray
from vergence.recording.events import LoopHealth
from vergence.viewer.head_view import SHOWN_HZ, HeadView
from vergence.viewer.panels import HISTORY_S
from vergence.viewer.recorded import Recorded

_HEALTH_MOMENTS: Final = 400
"""Moments before the present one by which its health is judged (chosen: some seconds)."""
_SLIDER_STEP_S: Final = 1e-3
"""Step of the slider of time, s (chosen: below every control period)."""
_SPEEDS: Final = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0)
"""Speeds of playing, by real time (chosen)."""


class Playback:
    """A recording in the browser.

    Args:
        server: server of the browsers.
        recorded: the recording.

    Attributes:
        view: the page.
    """

    def __init__(self, server: viser.ViserServer, recorded: Recorded) -> None:
        self._recorded = recorded
        self._end_s = float(recorded.times_s[-1])
        self.view = HeadView(server, recorded.head)
        self._rows = self.view.curves.rows_of(
            recorded.times_s, recorded.errors_px(), recorded.readings.velocities
        )
        self._health, self._judged = LoopHealth(recorded.head), -1
        self._time_s, self._shown = 0.0, (-1, 0.0)
        gui = server.gui
        with gui.add_folder("Playback"):
            self._playing: Any = gui.add_checkbox("Play", True)
            end_s = max(np.ceil(self._end_s / _SLIDER_STEP_S), 1.0) * _SLIDER_STEP_S
            self._slider: Any = gui.add_slider("Time (s)", 0.0, end_s, _SLIDER_STEP_S, 0.0)
            self._speed: Any = gui.add_dropdown(
                "Speed", tuple(f"{speed:g}" for speed in _SPEEDS), initial_value="1"
            )
            buttons = gui.add_button_group("Step", ("gaze back", "back", "on", "gaze on"))
            self._sigmas: Any = gui.add_slider("Ellipsoid (sigmas)", 1, 100, 1, 3)
        # browsers ask from threads of their own; the loop does what they ask
        self._asked: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._slider.on_update(self._scrub)
        buttons.on_click(lambda event: self._asked.put(partial(self._step, event.target.value)))

    @property
    def playing(self) -> bool:
        """True if time goes on."""
        return bool(self._playing.value)

    def run(self, until: Callable[[], bool] = lambda: False) -> None:
        """Play until told otherwise.

        Args:
            until: called for each moment that is shown; True ends the playing.
        """
        last_s = time.monotonic()
        while not until():
            while not self._asked.empty():
                self._asked.get()()
            now_s = time.monotonic()
            if self.playing:
                self._time_s += (now_s - last_s) * float(self._speed.value)
                if self._time_s > self._end_s:
                    self._time_s = 0.0
            last_s = now_s
            self._show()
            time.sleep(max(0.0, 1.0 / SHOWN_HZ - (time.monotonic() - now_s)))

    def _scrub(self, event: Any) -> None:
        if event.client is not None:  # not when the program moves the slider
            self._asked.put(partial(self._stop_at, float(self._slider.value)))

    def _stop_at(self, time_s: float) -> None:
        self._playing.value = False
        self._time_s = time_s

    def _step(self, which: str) -> None:
        """Go on, or back, by a control period or to the beginning of a gaze."""
        recorded, index = self._recorded, self._recorded.index_at(self._time_s)
        if which in ("back", "on"):
            index += 1 if which == "on" else -1
        else:
            gaze = recorded.gaze_at(index) - 1 + (1 if which == "gaze on" else -1)
            index = recorded.begins[min(max(gaze, 0), len(recorded.begins) - 1)]
        index = min(max(index, 0), len(recorded.times_s) - 1)
        self._stop_at(float(recorded.times_s[index]))

    def _show(self) -> None:
        index = self._recorded.index_at(self._time_s)
        self.view.sigmas = float(self._sigmas.value)
        if (index, self.view.sigmas) == self._shown:
            return
        self._shown = index, self.view.sigmas
        self.view.show(self._recorded.moment(index), self._words(index), self._curves(index))
        self._slider.value = float(self._recorded.times_s[index])

    def _curves(self, index: int) -> FloatArray:
        """Rows of the curves up to a moment."""
        times_s = self._rows[: index + 1, 0]
        return self._rows[np.searchsorted(times_s, times_s[-1] - HISTORY_S) : index + 1]

    def _words(self, index: int) -> list[str]:
        recorded = self._recorded
        if not self._judged < index <= self._judged + _HEALTH_MOMENTS:
            self._health, self._judged = LoopHealth(recorded.head), index - _HEALTH_MOMENTS
        for place in range(max(self._judged + 1, 0), index + 1):
            self._health.add(recorded.reading(place))
        self._judged = index
        return [
            f"**{recorded.path.name}**",
            f"gaze {recorded.gaze_at(index)} of {len(recorded.begins)}, "
            f"{recorded.times_s[index]:.3f} of {self._end_s:.3f} s",
            *(f"**{note}**" for note in recorded.notes),
            *self._health.words(),
        ]
