"""What counts as found, how far off it is, and what is false.

A tag is found when a detection with its id has its centre within `near_px` of where the tag is. A
detection is false when no known tag with its id is there. Known are the tags of the text file, and
those that two voters find in the unvaried photograph: the text files do not list every tag. A false
detection with an id that is known nowhere in the photograph is counted as wrong, the others as
stray. Where text files leave tags out, either may still be a tag: look at the list that ``--json``
keeps. Images without any tag are the business of `benchmarks.false_positives`.

Corners are compared in the order of the target; those of foreign methods in the order, either way
round, that fits best.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.tag_images.methods import Found, Method
from benchmarks.tag_images.photographs import KnownTag, Photograph, edge

NEAR_PX = 2.0
NEAR_EDGES = 0.1
"""A centre may be off by the larger of both."""
_VOTERS = 2
"""As many must have found a tag for their median to be its place."""


@dataclass(frozen=True)
class Score:
    """How a method did on one tag of one image."""

    found: bool
    centre_error_px: float
    """nan where it is not found."""
    corner_error_px: float
    """Root mean square distance over the four corners; nan where it is not found."""
    wrong: tuple[int, ...]
    """Ids of false detections that are known nowhere in the photograph."""
    stray: tuple[int, ...]
    """Ids of false detections that are known, but elsewhere."""


def near_px(edge_px: float) -> float:
    """How far off the centre of a tag may be."""
    return max(NEAR_PX, NEAR_EDGES * edge_px)


def ordered_as(
    corners_px: NDArray[np.float64], goal_px: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Corners in the order, either way round, that fits others best; both of shape (4, 2)."""
    orders = [np.roll(way, k, axis=0) for way in (corners_px, corners_px[::-1]) for k in range(4)]
    return min(orders, key=lambda order: float(np.sum((order - goal_px) ** 2)))


def score(found: Sequence[Found], tag: KnownTag, known: Sequence[KnownTag], ordered: bool) -> Score:
    """How a method did.

    Args:
        found: what it found in the image.
        tag: the tag in question, where it is in the image.
        known: all tags known to be there, where they are in the image.
        ordered: whether the method's corners have the order of the target.
    """
    same = [one for one in found if one.id == tag.id]
    off = [float(np.linalg.norm(one.centre_px - tag.centre_px)) for one in same]
    false = [one.id for one in found if not any(_is(one, other) for other in known)]
    ids = {other.id for other in known}
    stray = tuple(number for number in false if number in ids)
    wrong = tuple(number for number in false if number not in ids)
    if not off or min(off) > near_px(tag.edge_px):
        return Score(False, np.nan, np.nan, wrong, stray)
    best = same[int(np.argmin(off))]
    corners = best.corners_px if ordered else ordered_as(best.corners_px, tag.corners_px)
    square = np.sum((corners - tag.corners_px) ** 2, axis=1)
    return Score(True, min(off), float(np.sqrt(square.mean())), wrong, stray)


def _is(found: Found, tag: KnownTag) -> bool:
    near = max(near_px(tag.edge_px), 0.5 * edge(found.corners_px))
    return found.id == tag.id and float(np.linalg.norm(found.centre_px - tag.centre_px)) < near


def voted(photograph: Photograph, methods: Sequence[Method]) -> Photograph:
    """A photograph whose tags are where the median of the methods has them.

    Tags that the text file does not list, but two voters agree on, are put behind those of the
    file.
    """
    seen = [(method.voter, method.detect(photograph.image)) for method in methods]
    fine = [one for one, method in zip(seen, methods, strict=True) if method.refined]
    tags = [_voted(tag, fine) for tag in photograph.tags]
    for one in (one for _, found in seen for one in found):
        unlisted = KnownTag(one.id, one.corners_px, one.centre_px)
        if len(_votes(unlisted, seen)) >= _VOTERS and not any(_is(one, tag) for tag in tags):
            tags.append(_voted(unlisted, fine))
    return replace(photograph, tags=tuple(tags))


def _votes(
    tag: KnownTag, seen: Sequence[tuple[str, list[Found]]]
) -> dict[str, list[NDArray[np.float64]]]:
    """By voter, centre and corners of a tag of all its methods that find it, shape (5, 2) each."""
    votes: dict[str, list[NDArray[np.float64]]] = {}
    for voter, found in seen:
        same = [one for one in found if one.id == tag.id]
        same.sort(key=lambda one: float(np.linalg.norm(one.centre_px - tag.centre_px)))
        if same and np.linalg.norm(same[0].centre_px - tag.centre_px) <= near_px(tag.edge_px):
            corners = ordered_as(same[0].corners_px, tag.corners_px)
            votes.setdefault(voter, []).append(np.vstack([same[0].centre_px, corners]))
    return votes


def _voted(tag: KnownTag, seen: Sequence[tuple[str, list[Found]]]) -> KnownTag:
    votes = _votes(tag, seen)
    if len(votes) < _VOTERS:
        return tag
    points = np.median([np.median(voter, axis=0) for voter in votes.values()], axis=0)
    return replace(tag, centre_px=points[0], corners_px=points[1:])
