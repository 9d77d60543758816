"""Draw the surfaces of a fuzzy PID: the factors of its gains over error and error rate.

Run ``python benchmarks/fuzzy_surface.py --out docs/images/fuzzy_surface``. All spans are one,
which shows the rules at full strength. See ``docs/controllers.md``.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from vergence.controllers.pid import FUZZY_SETS, FuzzyPID
from vergence.envs.observation import ObservationLayout
from vergence.models.head_file import load_head
from vergence.reporting.style import figure_style, new_figure, save_figure


def draw_surfaces(controller: FuzzyPID, points: int = 121) -> Figure:
    """Draw the factors of the gains over error and error rate, each normalised by its universe.

    Args:
        controller: fuzzy PID to draw.
        points: grid points along each axis.

    Returns:
        The figure: three panels, for kp, ki and kd.
    """
    error_px, rate_px_s = controller.universe
    x = np.linspace(-1.0, 1.0, points)
    factors = controller.factors(x[:, None] * error_px, x[None, :] * rate_px_s)
    away = max(float(np.abs(factors - 1.0).max()), 1e-9)
    with figure_style():
        figure = new_figure(10.0, 3.9)
        panels = figure.subplots(1, 3, sharex=True, sharey=True)
        for i, (panel, name) in enumerate(zip(panels, ("$k_p$", "$k_i$", "$k_d$"), strict=True)):
            levels = np.linspace(1.0 - away, 1.0 + away, 13)
            drawn = panel.contourf(x, x, factors[..., i].T, levels, cmap="RdBu_r")
            panel.contour(x, x, factors[..., i].T, [1.0], colors="#222222", linewidths=1.0)
            panel.set_title(name)
            panel.set_xticks(np.linspace(-1.0, 1.0, 7), FUZZY_SETS)
            panel.set_yticks(np.linspace(-1.0, 1.0, 7), FUZZY_SETS)
            panel.set_aspect("equal")
            panel.set_xlabel(f"error, ±{error_px:g} px")
        panels[0].set_ylabel(f"rate, ±{rate_px_s:g} px/s")
        bar = figure.colorbar(
            drawn, ax=panels, shrink=0.8, ticks=np.linspace(levels[0], levels[-1], 5)
        )
        bar.set_label("gain by its base value")
    return figure


def main(arguments: list[str] | None = None) -> int:
    """Draw the figure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="figure, without its suffix")
    out: Path = parser.parse_args(arguments).out
    head = load_head("simulated")
    layout = ObservationLayout.of(head)
    save_figure(
        draw_surfaces(FuzzyPID(head=head, layout=layout, span_p=1.0, span_i=1.0, span_d=1.0)), out
    )
    out.with_suffix(".svg").unlink()  # documents show the PNG
    return 0


if __name__ == "__main__":
    sys.exit(main())
