"""Pictures of photographs: titles that fit, views that far points do not spoil, no empty panels."""

from pathlib import Path

import numpy as np
import pytest

from tests.heads import head_of
from tests.perception.drawn import pose_at
from tests.perception.test_located import exact
from vergence.perception.finding import Photograph
from vergence.perception.locate import LocateResult, locate_target
from vergence.perception.pictures import (
    _AXIS_COLOURS,
    compose_detections,
    compose_located,
    shorten_to_width,
)
from vergence.vision.targets import AprilTag

HEAD = head_of("pair")
IMAGE = np.full((240, 320), 90, np.uint8)


def result_of(*places: tuple[str, AprilTag, tuple[float, float, float]], swap: bool = False):
    """Tags of 20 mm at places in N, located by exact pixels."""
    located, photographs = [], []
    for pair, tag, place in places:
        sides = exact(HEAD, HEAD.rest(), tag, pose_at(place))
        located.append(locate_target(HEAD, HEAD.rest(), pair, *sides[:: -1 if swap else 1]))
        photographs.append([Photograph(Path(pair), IMAGE, [side]) for side in sides])
    names = tuple(dict.fromkeys(pair for pair, _, _ in places)) or ("a.png",)
    nothing = [Photograph(Path("a.png"), IMAGE, [])] * 2
    return LocateResult(
        head=HEAD,
        angles=dict.fromkeys(names, HEAD.rest()), located=tuple(located), missed=(),
        remarks=(), unpaired=(), failures=(), shown=tuple((photographs or [nothing])[0]),
    )  # fmt: skip


def tags_at(*depths_m: float):
    return result_of(
        *((f"{i}.png", AprilTag(id=i, edge_m=0.02), (0.0, 0.0, z)) for i, z in enumerate(depths_m))
    )


def titles(figure):
    return [panel.get_title() for panel in figure.axes]


@pytest.mark.nightly
def test_a_point_far_away_leaves_the_others_their_scale_and_is_counted():
    usual, far = (compose_located(tags_at(0.5, 0.6, 0.7, *more)) for more in ((), (400.0,)))
    for one in (usual, far):
        one.draw_without_rendering()
    assert "outside" not in "".join(titles(usual))
    assert "4 points lie farther away, outside" in titles(far)[2]
    for before, after in zip(usual.axes[2:], far.axes[2:], strict=True):
        np.testing.assert_allclose(after.get_xlim(), before.get_xlim(), rtol=0.3, atol=30.0)
    # targets of one scene lie all in the views, a near and a distant one
    assert "outside" not in "".join(titles(compose_located(tags_at(0.4, 0.5, 2.0))))


def test_axes_are_drawn_in_the_images_and_in_space():
    figure = compose_located(tags_at(0.5))
    length = 0.65 * 0.02  # of a tag that faces the eyes
    for panel, across, up in zip(figure.axes[2:], (0, 2), (2, 1), strict=True):
        axes = [line.get_xydata() for line in panel.lines if line.get_color() in _AXIS_COLOURS]
        for axis, (start, end) in enumerate(axes):
            step = 1e3 * length * np.eye(3)[axis]
            np.testing.assert_allclose(start, [0.0, 500.0][:: 1 if across == 0 else -1], atol=1e-2)
            np.testing.assert_allclose(end - start, step[[across, up]], atol=1e-2)
        assert len(axes) == 3
    for panel in figure.axes[:2]:
        x, y, z = [line for line in panel.lines if line.get_color() in _AXIS_COLOURS]
        focal = HEAD.cameras.focal.mean()
        assert np.diff(x.get_xdata())[0] == pytest.approx(focal * length / 0.5, rel=0.05)
        assert np.diff(y.get_ydata())[0] == pytest.approx(focal * length / 0.5, rel=0.05)
        assert abs(np.diff(z.get_ydata())[0]) < 0.1


def test_without_a_point_there_are_the_images_alone_and_a_word():
    swapped = result_of(("a.png", AprilTag(edge_m=0.02), (0.0, 0.0, 0.5)), swap=True)
    for result, said in [
        (result_of(), "no target in both images, nothing located"),
        (swapped, "do not cross"),
    ]:
        figure = compose_located(result)
        assert len(figure.axes) == 2
        assert said in figure.get_suptitle()
        assert ["nothing found" in title for title in titles(figure)] == [not result.located] * 2


def boxes_apart(figure, texts):
    """Boxes of texts in a drawn figure, of which no two overlap."""
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in texts]
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
    return boxes


@pytest.mark.slow
def test_long_titles_do_not_overlap():
    tag = AprilTag(edge_m=0.02)
    name = "a_very_long_name_of_a_photograph_of_2024-05-06_at_12_13_14_by_the_camera_left.jpg"
    found = [exact(HEAD, HEAD.rest(), tag, pose_at((0.0, 0.0, 0.5)))[0]]
    for count in (1, 6):
        figure = compose_detections([Photograph(Path(name), IMAGE, found)] * count)
        boxes, page = boxes_apart(figure, [panel.title for panel in figure.axes]), figure.bbox
        assert all(page.x0 <= box.x0 and box.x1 <= page.x1 for box in boxes)
        assert all("1 tag" in title and "left.jpg" in title for title in titles(figure))


def test_numbers_of_small_tags_do_not_overlap():
    tags = [AprilTag(id=100 + i, edge_m=0.02) for i in range(3)]
    places = [pose_at((0.03 * i, 0.0, 1.0)) for i in range(3)]
    found = [exact(HEAD, HEAD.rest(), *one)[0] for one in zip(tags, places, strict=True)]
    figure = compose_detections([Photograph(Path("a.png"), IMAGE, found)])
    assert len(boxes_apart(figure, figure.axes[0].texts)) == 3


def test_a_text_loses_its_middle_where_it_is_too_wide():
    assert shorten_to_width("left1.jpg", 3.0, 10.0) == "left1.jpg"
    short = shorten_to_width("x" * 60 + "end.jpg", 3.0, 10.0)
    assert " … " in short
    assert short.endswith("end.jpg")
    assert len(short) <= 36
