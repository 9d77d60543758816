"""The viewer of a simulated head: controls, and the loop that keeps real time."""

import queue
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Final, get_args

import numpy as np
import viser

from vergence.controllers.controller import CONTROLLERS, default_options
from vergence.envs.plants.conditions import IMPERFECTIONS, LOOP_PARTS, Imperfection
from vergence.errors import VergenceError
from vergence.models.head_file import load_head, presets
from vergence.models.parts import FloatArray
from vergence.viewer.head_view import SHOWN_HZ, HeadView
from vergence.viewer.simulated import Setup, SimulatedHead, TargetMode

_MOST_LATE_S: Final = 0.1
"""Lateness after which simulated time stands still instead of catching up, s (chosen)."""
_PLANTS: Final = ("rendered", "mujoco", "kinematic")
"""Plants to choose from."""
_WORDS_EVERY: Final = 6
"""Number of moments shown per update of the text (chosen: legible)."""
_SLIDER_STEPS: Final = 100
"""Steps of a slider (chosen: fine enough for a hand)."""
_GAIN_RANGE: Final = (0.5, 30.0)
"""Ends of the slider for gains, 1/s (chosen: every tuned gain lies within)."""


class Playground:
    """A simulated head in the browser, with controls of its target, law and loop.

    Browsers ask from threads of their own; the loop does what they ask between two periods.

    Args:
        server: server of the browsers.
        setup: the head at first, with its law and loop.
        mode: motion of the target at first.
        seed: seed of all noise.

    Attributes:
        simulated: the simulated head.
        view: the page.

    Raises:
        VergenceError: the head or the law is not possible.
    """

    def __init__(
        self, server: viser.ViserServer, setup: Setup, mode: TargetMode = "step", seed: int = 0
    ) -> None:
        self._server = server
        self._heads = {setup.head.name: setup.head}
        self.simulated = SimulatedHead(setup, mode, seed)
        self._asked: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._speed, self._paused, self._dragging = 1.0, False, False
        self.view = HeadView(server, setup.head, self._look_at, self.simulated.room)
        self._add_target_controls(mode)
        self._add_head_controls(setup)
        self._sliders: dict[str, Any] = {}
        self._loop_asked: dict[str, float] = {}
        with server.gui.add_folder("Faults of the loop", expand_by_default=False):
            for part in LOOP_PARTS:
                self._add_loop_controls(part)
        self._show_setup()
        self._take_target()

    def run(self, until: Callable[[], bool] = lambda: False) -> None:
        """Simulate in real time, and show, until told otherwise.

        Args:
            until: called at least once in each control period; True ends the session.
        """
        due_s = shown_s = time.monotonic()
        while not until():
            self._do_what_is_asked()
            now_s = time.monotonic()
            if self._paused:
                due_s = now_s
            elif now_s >= due_s:
                self.simulated.step()
                due_s = max(due_s, now_s - _MOST_LATE_S) + self.simulated.period_s / self._speed
            if now_s >= shown_s:
                shown_s = max(shown_s, now_s - 1.0 / SHOWN_HZ) + 1.0 / SHOWN_HZ
                words = None if self.view.shown % _WORDS_EVERY else self._words()
                self.view.show(self.simulated.moment(), words, moves_target=not self._dragging)
            wait_s = min(shown_s, shown_s if self._paused else due_s) - time.monotonic()
            if wait_s > 0.0:
                time.sleep(wait_s)

    def ask(self, do: Callable[[], None]) -> None:
        """Have the loop do something between two control periods.

        Args:
            do: called by the loop's thread.
        """
        self._asked.put(do)

    def _do_what_is_asked(self) -> None:
        while not self._asked.empty():
            self._try(self._asked.get())
        if self._loop_asked:  # once for all that a slider passes on its way
            loop = {**self.simulated.setup.loop, **self._loop_asked}
            self._loop_asked = {}
            self._try(partial(self._change, loop=loop))

    def _try(self, do: Callable[[], None]) -> None:
        """Do something; if it is not possible, say so, and set the controls back."""
        try:
            do()
        except VergenceError as error:
            self._show_setup()
            for client in self._server.get_clients().values():
                client.add_notification("Not possible", str(error), color="red")

    def _show_setup(self) -> None:
        """Set the controls to what is simulated."""
        setup, own = self.simulated.setup, default_options(self.simulated.setup.controller)
        self._mode.value = self.simulated.mode
        self._head.value, self._law.value = setup.head.name, setup.controller
        self._plant.value = setup.plant
        self._gain.disabled = "gain" not in own
        self._gain.value = setup.gain or own.get("gain") or self._gain.value
        for name, slider in self._sliders.items():
            factor = IMPERFECTIONS[name].display_unit[1]
            given = setup.loop.get(name)
            slider.value = self._nominal(IMPERFECTIONS[name]) if given is None else factor * given

    def _words(self) -> list[str]:
        settled, bound = self.simulated.settled_s, self.simulated.bound_s
        ratio = f", ratio **{settled / bound:.2f}**" if settled and bound else ""
        return [
            f"settled to 1 px after **{1e3 * settled:.0f} ms**" if settled else "&nbsp;",
            f"time-optimal bound {1e3 * bound:.0f} ms{ratio}" if bound else "&nbsp;",
        ]

    def _look_at(self, eye: int, pixel: FloatArray) -> None:
        def look() -> None:
            self.simulated.look_at(eye, pixel)
            self._mode.value = self.simulated.mode

        self.ask(look)

    def _take_target(self) -> None:
        """Let browsers drag the target."""
        target = self.view.scene.target
        target.visible = not self.simulated.setup.point_in_room
        target.on_update(self._drag)

    async def _drag(self, event: "viser.TransformControlsEvent") -> None:
        # not in a thread, so that the end of a drag comes last
        self._dragging = event.phase != "end"
        self.ask(partial(self._move_target, np.array(event.target.position)))

    def _move_target(self, point: FloatArray) -> None:
        self.simulated.move_target(self.view.scene.point_in_n(point))
        self._mode.value = self.simulated.mode

    def _on_browser(self, handle: Any, do: Callable[[Any], None]) -> None:
        """Have the loop do something with a control's value when a browser changes it."""

        def ask(event: Any) -> None:
            if event.client is not None:  # not when the program sets it
                self.ask(lambda: do(handle.value))

        handle.on_update(ask)

    def _add_target_controls(self, mode: TargetMode) -> None:
        gui = self._server.gui
        with gui.add_folder("Target"):
            self._mode: Any = gui.add_dropdown(
                "Motion", tuple(get_args(TargetMode)), initial_value=mode, hint="or drag it"
            )
            ahead = gui.add_button("In front of the eyes")
            speed = gui.add_slider("Speed of time", 0.02, 1.0, 0.02, 1.0)
            paused = gui.add_checkbox("Paused", False)
            sigmas = gui.add_slider("Ellipsoid (sigmas)", 1, 100, 1, 3)
        self._on_browser(self._mode, self.simulated.set_mode)
        self._on_browser(speed, lambda value: setattr(self, "_speed", value))
        self._on_browser(paused, lambda value: setattr(self, "_paused", value))
        self._on_browser(sigmas, lambda value: setattr(self.view, "sigmas", value))
        ahead.on_click(lambda _event: self.ask(self._look_ahead))

    def _look_ahead(self) -> None:
        self.simulated.look_ahead()
        self._mode.value = self.simulated.mode

    def _add_head_controls(self, setup: Setup) -> None:
        gui = self._server.gui
        names = [*self._heads, *(name for name in presets() if name not in self._heads)]
        with gui.add_folder("Head and law"):
            self._head: Any = gui.add_dropdown("Head", tuple(names))
            self._law: Any = gui.add_dropdown("Law", tuple(CONTROLLERS))
            self._gain: Any = gui.add_slider("Gain (1/s)", *_GAIN_RANGE, 0.5, setup.gain or 4.0)
            self._plant: Any = gui.add_dropdown(
                "Plant", _PLANTS, hint="rendered: images and a detector; else pixels with noise"
            )
        self._on_browser(self._head, self._change_head)
        self._on_browser(self._law, lambda name: self._change(controller=name, gain=None))
        self._on_browser(self._gain, lambda value: self._change(gain=value))
        self._on_browser(self._plant, lambda name: self._change(plant=name))

    def _add_loop_controls(self, part: str) -> None:
        """Add a slider for each imperfection of a part of the loop."""
        gui = self._server.gui
        with gui.add_folder(part.capitalize(), expand_by_default=False):
            for name, one in IMPERFECTIONS.items():
                if one.part != part:
                    continue
                unit, factor = one.display_unit
                nominal = self._nominal(one)
                low, high = (factor * end for end in one.search_range)
                low, high = min(low, nominal), max(high, nominal)
                label = f"{one.label} ({unit})" if unit else one.label
                step = (high - low) / _SLIDER_STEPS
                slider = gui.add_slider(label, low, high, step, nominal, hint=one.description)
                self._sliders[name] = slider
                self._on_browser(slider, partial(self._change_loop, name))

    def _nominal(self, one: Imperfection) -> float:
        """Value of an imperfection by the head's own file, in its unit for display."""
        nominal = float(np.max(one.nominal(self.simulated.setup.head)))
        return float(f"{one.display_unit[1] * nominal:.4g}")

    def _change_head(self, name: str) -> None:
        head = self._heads[name] if name in self._heads else load_head(name)
        self._heads[name] = head
        self.view.write([f"loading {name} ..."])
        self._change(head=head, loop={})
        self.view.change_head(head)
        self._take_target()

    def _change_loop(self, name: str, value: float) -> None:
        self._loop_asked[name] = value / IMPERFECTIONS[name].display_unit[1]

    def _change(self, **fields: Any) -> None:
        self.simulated.change(replace(self.simulated.setup, **fields))
        self._show_setup()
