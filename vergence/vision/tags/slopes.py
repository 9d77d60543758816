"""The blurred print at each pixel of a fit, and its derivatives with respect to all unknowns."""

from math import sqrt

from vergence.kernels import subroutine
from vergence.vision.tags.bend import bend_by_coefficient, bend_displacement
from vergence.vision.tags.printed import sample_print
from vergence.vision.tags.workspace import BEND_START, MAX_UNKNOWNS, FitBuffers, FitState, TagPrint


@subroutine
def evaluate_print(
    state: FitState, tag: TagPrint, buffers: FitBuffers, pixel_count: int, blocks_per_edge: int
) -> None:
    """Evaluate the print and its derivatives at all pixels, and their sums by block.

    Args:
        state: the tag's current pose, blurs and bend.
        tag: the print.
        buffers: its `samples` are read; its `pixel_rows` and its blocks' `sums` and `slopes` are
            the result. A pixel to which an unknown cell contributes gets block -1.
        pixel_count: number of pixels.
        blocks_per_edge: blocks along an edge.
    """
    G, blurs, spread_and_bend, cells = (
        state.G,
        state.blurs_px,
        state.white_spread_and_bend,
        tag.cells,
    )
    places, pixels, along_x, along_y = (
        buffers.samples,
        buffers.pixel_rows,
        buffers.cell_weights_x,
        buffers.cell_weights_y,
    )
    sums, slopes = buffers.blocks.moments, buffers.blocks.derivative_sums
    half, start = 0.5 * tag.side_cells, 0.5 * (len(cells) - tag.side_cells)
    for k in range(blocks_per_edge * blocks_per_edge):
        for j in range(5):
            sums[k, j] = 0.0
        for j in range(MAX_UNKNOWNS):
            slopes[k, 0, j] = slopes[k, 1, j] = 0.0
    for n in range(pixel_count):
        u, v, grey = places[n, 0], places[n, 1], places[n, 2]
        w = G[2, 0] * u + G[2, 1] * v + G[2, 2]
        x = (G[0, 0] * u + G[0, 1] * v + G[0, 2]) / w
        y = (G[1, 0] * u + G[1, 1] * v + G[1, 2]) / w
        a, b = G[0, 0] - x * G[2, 0], G[0, 1] - x * G[2, 1]
        c, d = G[1, 0] - y * G[2, 0], G[1, 1] - y * G[2, 1]
        s_x = blurs[0] * half * sqrt(a * a + b * b) / abs(w)
        s_y = blurs[1] * half * sqrt(c * c + d * d) / abs(w)
        flat_x, flat_y = x, y
        dx, dy = bend_displacement(spread_and_bend, flat_x, flat_y)
        x, y = x + dx, y + dy
        at = sample_print(
            cells, (x + 1.0) * half + start, (y + 1.0) * half + start, s_x, s_y, along_x, along_y
        )
        if not at.cells_known:
            pixels[n, 1] = -1.0
            continue
        by_x, by_y = half * at.by_x, half * at.by_y
        turn = -(by_x * x + by_y * y)
        pixels[n, 0] = grey
        ridge = at.by_white_spread_x / blurs[0] + at.by_white_spread_y / blurs[1]
        value = at.value + spread_and_bend[0] * ridge
        pixels[n, 2] = value
        pixels[n, 3], pixels[n, 4], pixels[n, 5] = by_x * x, by_x * y, by_x
        pixels[n, 6], pixels[n, 7], pixels[n, 8] = by_y * x, by_y * y, by_y
        pixels[n, 9], pixels[n, 10] = turn * x, turn * y
        pixels[n, 11], pixels[n, 12], pixels[n, 13] = at.by_log_blur_x, at.by_log_blur_y, ridge
        for k in range(MAX_UNKNOWNS - BEND_START):
            dx, dy = bend_by_coefficient(k, flat_x, flat_y)
            pixels[n, 3 + BEND_START + k] = by_x * dx + by_y * dy
        share = 0.5 * blocks_per_edge / (half + 1.0)
        column = min(max(int((x * half + half + 1.0) * share), 0), blocks_per_edge - 1)
        row = min(max(int((y * half + half + 1.0) * share), 0), blocks_per_edge - 1)
        k = row * blocks_per_edge + column
        pixels[n, 1] = k
        own = sums[k]
        own[0] += 1.0
        own[1] += value
        own[2] += value * value
        own[3] += grey
        own[4] += value * grey
        for j in range(MAX_UNKNOWNS):
            slopes[k, 0, j] += pixels[n, 3 + j]
            slopes[k, 1, j] += value * pixels[n, 3 + j]
