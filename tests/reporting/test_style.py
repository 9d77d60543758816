"""The common style of figures."""

from vergence.reporting.style import figure_style, legend_below, new_figure


def test_the_legend_of_a_panel_lies_below_its_axis_and_within_the_figure():
    with figure_style():
        figure = new_figure(6.0, 3.0)
        for panel in figure.subplots(1, 2):
            panel.plot([0.0, 1.0], label="one")
            panel.plot([1.0, 0.0], label="other")
            panel.set_xlabel("time (s)")
            legend_below(panel, 1)
        figure.draw_without_rendering()
        for panel in figure.axes:
            legend, label = panel.get_legend(), panel.xaxis.label
            assert legend is not None
            assert legend.get_window_extent().y0 >= 0.0
            assert legend.get_window_extent().y1 <= label.get_window_extent().y0
