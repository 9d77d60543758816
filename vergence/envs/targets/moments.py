"""Random moments of a target's events: one per trial, drawn from the trial's stream."""

from typing import Final

import numpy as np

from vergence.envs.streams import IntArray, RandomStreams, StreamKeys, StreamPurpose, random_words
from vergence.envs.targets.placement import uniform_between
from vergence.kernels import compiled, untyped_tuple
from vergence.models.parts import FloatArray

_TASK: Final = int(StreamPurpose.TASK)
# lane of the random words (numerical); the first four are used for positions and speeds
_EVENT_TIME_LANE: Final = 5


def draw_event_times(
    streams: RandomStreams, ids: IntArray, earliest: float, latest: float
) -> FloatArray:
    """Draw a moment for each of some trials, uniform in a range.

    Args:
        streams: the trials' random streams.
        ids: (n,) environment indices.
        earliest: the range's beginning, s.
        latest: its end, s.

    Returns:
        (n,) s.
    """
    moments = np.empty(len(ids))
    _fill(
        untyped_tuple(StreamKeys(streams.seeds[ids], streams.trials[ids])),
        earliest,
        latest,
        moments,
    )
    return moments


@compiled
def _fill(keys: StreamKeys, earliest: float, latest: float, moments: FloatArray) -> None:
    keys = StreamKeys(*keys)
    for n in range(len(moments)):
        words = random_words(keys.seeds[n], keys.trials[n], _TASK, 0, _EVENT_TIME_LANE)
        moments[n] = uniform_between(words[0], earliest, latest)
