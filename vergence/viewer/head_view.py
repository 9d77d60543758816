"""One head in the browser: the scene, both eyes, the curves, and the state in words."""

from typing import Final

import numpy as np
import viser

from vergence.eval.gaze_trajectory import MM
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.viewer.moment import Moment
from vergence.viewer.panels import CurvePanel, EyePanel
from vergence.viewer.scene import HeadScene, OnLook
from vergence.vision.objects.scenes import Scene

SHOWN_HZ: Final = 30.0
"""Greatest number of moments shown per second (chosen: smooth; each costs two JPEGs)."""
_FIRST: Final = -1.0
"""Order of what stands above everything else in a panel (numerical)."""
_LEAST_LINES: Final = 10
"""Lines that the words take at least (chosen: so that controls below them do not move)."""
_PANEL_WIDTH_PX: Final = 330
"""Width of the panel with images and curves, px of the page (chosen: room for the scene)."""


class HeadView:
    """One head in the browser.

    Args:
        server: server of the browsers.
        head: the model of the head.
        on_look: called with the eye and the pixel of a click in an eye's image, see `HeadScene`;
            None if nothing can be clicked.
        room: the room in which the head stands; None for none.

    Attributes:
        scene: the head in 3D.
        curves: the errors and speeds over time.
        sigmas: size of the covariance ellipsoid, in standard deviations.
        shown: number of moments shown so far.
    """

    def __init__(
        self, server: viser.ViserServer, head: HeadModel, on_look: OnLook | None = None,
        room: Scene | None = None,
    ) -> None:  # fmt: skip
        self._server, self._on_look, self._room = server, on_look, room
        self.sigmas, self.shown = 3.0, 0
        self._words = server.gui.add_markdown("", order=_FIRST)
        self._lines = _LEAST_LINES
        panel = server.gui.add_panel()
        self._tab = panel.add_tab("Eyes")
        panel.dock_left()
        panel.set_width(_PANEL_WIDTH_PX)
        self.scene = HeadScene(server, head, on_look, room)
        with self._tab:
            self._eyes = EyePanel(server, head)
            self.curves = CurvePanel(server, head)
        server.on_client_connect(lambda client: self.scene.frame(client))

    def change_head(self, head: HeadModel) -> None:
        """Show another head from now on."""
        self._server.scene.reset()
        self.scene = HeadScene(self._server, head, self._on_look, self._room)
        self._eyes.head = head
        self.curves.set_head(head)

    def write(self, lines: list[str]) -> None:
        """Write lines of Markdown in place of those of the last moment, at once."""
        self._words.content = "  \n".join([*lines, *["&nbsp;"] * (self._lines - len(lines))])
        self._server.flush()

    def show(
        self,
        shown: Moment,
        words: list[str] | None,
        curves: FloatArray | None = None,
        *,
        moves_target: bool = True,
    ) -> None:
        """Show a moment.

        Args:
            shown: the moment.
            words: lines of text, in Markdown, before those about the moment; None to leave the
                text as it is.
            curves: rows of the curves, see `CurvePanel.rows_of`; None to go on from the last
                moment.
            moves_target: False while somebody drags the target, so that it stays in their hand.
        """
        with self._server.atomic():
            self.scene.show(shown, sigmas=self.sigmas, moves_target=moves_target)
            self.scene.show_screens(self._eyes.show(shown))
            if curves is None:
                self.curves.add(shown)
            else:
                self.curves.draw(curves)
            if words is not None:
                lines = [*words, *_describe(shown)]
                self._lines = max(self._lines, len(lines))  # controls below must not move
                lines += ["&nbsp;"] * (self._lines - len(lines))
                self._words.content = "  \n".join(lines)
        self.shown += 1


def _describe(shown: Moment) -> list[str]:
    """Lines of text about a moment."""
    blind = [name for name, sees in zip(EYE_NAMES, shown.visible, strict=True) if not sees]
    lines = [f"**the {blind[0]} eye does not see the target**"] if len(blind) == 1 else []
    lines += ["**neither eye sees the target**"] if len(blind) == 2 else []
    if not shown.fix.valid:
        return [*lines, "the optical axes do not cross"]
    lines += [
        f"fix by gaze {_three(MM * shown.fix.point, 1)} mm",
        f"1 sigma {_three(MM * shown.fix.sigma, 2)} mm",
        f"gap between the axes {MM * shown.fix.gap:.2f} mm",
    ]
    if shown.target_is_truth:
        off = MM * float(np.linalg.norm(shown.fix.point - shown.target))
        lines.append(f"fix to target {off:.1f} mm")
    return lines


def _three(values: object, decimals: int) -> str:
    return "(" + ", ".join(f"{value:.{decimals}f}" for value in np.asarray(values)) + ")"
