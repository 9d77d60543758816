"""True heads of a batch: as given, or drawn anew for each trial."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.envs.plants.conditions import TRIAL_CONDITIONS, Conditions, PackedConditions
from vergence.envs.plants.imperfections import (
    IMPERFECTIONS,
    PER_ACTUATOR,
    PER_TRIAL,
    is_valid_range,
    valid_range_text,
)
from vergence.envs.plants.variation import Variation, draw_conditions
from vergence.envs.saved_state import Arrays
from vergence.envs.streams import IntArray, KeyArray, RandomStreams
from vergence.envs.validation import real_number_array
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.kinematics import PACKED
from vergence.models.parts import FloatArray
from vergence.models.perturbation import DEVIATES

_HEADS_AHEAD: Final = 4
"""Heads kept per environment, of the running trial and the next (chosen: with 1,024 environments,
some hundred trials end before one of them needs more)."""


def _place(trials: KeyArray) -> IntArray:
    return (trials % np.uint64(_HEADS_AHEAD)).astype(np.int64)


class TrueHeadPrefetcher:
    """True heads of coming trials, made in advance: a few cost as much as a hundred.

    The environments of a batch usually go on to their next trials one by one. When one of them
    needs a head that is not made yet, the heads of all environments' next trials are made with it.

    Args:
        variation: variation that draws the heads' model errors.
        head: the model.
        num: number of environments.
    """

    def __init__(self, variation: Variation, head: HeadModel, num: int) -> None:
        self._variation = variation
        self._head = head
        shape = (num, _HEADS_AHEAD)  # a trial's place is its number's remainder
        self._deviates = np.zeros((*shape, DEVIATES))
        self._packed = np.zeros((*shape, PACKED))
        self._seeds, self._trials = np.zeros((2, *shape), dtype=np.uint64)
        self._ready = np.zeros(shape, dtype=np.bool_)

    def take(self, streams: RandomStreams, ids: IntArray) -> tuple[FloatArray, FloatArray]:
        """Take the heads of the trials of some environments.

        Args:
            streams: the trials' random streams.
            ids: (m,) environment indices.

        Returns:
            (m, DEVIATES) the deviates, and (m, PACKED) the heads.
        """
        seeds, trials = streams.seeds[ids], streams.trials[ids]
        own = ids, _place(trials)
        if not self._holds(own, seeds, trials).all():
            self._keep(own, seeds, trials)
            if len(ids) < len(self._ready):  # if a whole batch begins, it may have no next trials
                self._fill(streams)
        return self._deviates[own], self._packed[own]

    def _holds(self, places: Any, seeds: KeyArray, trials: KeyArray) -> NDArray[np.bool_]:
        same = (self._seeds[places] == seeds) & (self._trials[places] == trials)
        return np.asarray(self._ready[places] & same)

    def _fill(self, streams: RandomStreams) -> None:
        """Make the heads of the next trials of all environments."""
        ahead = np.arange(_HEADS_AHEAD, dtype=np.uint64)
        trials: KeyArray = np.add.outer(streams.trials, ahead)
        rows = np.arange(len(trials))[:, None]
        seeds = np.broadcast_to(streams.seeds[:, None], trials.shape)
        missing = ~self._holds((rows, _place(trials)), seeds, trials)
        missing[:, 0] = False  # the running trials
        rows = np.broadcast_to(rows, trials.shape)[missing]
        self._keep((rows, _place(trials[missing])), seeds[missing], trials[missing])

    def _keep(self, places: Any, seeds: KeyArray, trials: KeyArray) -> None:
        self._deviates[places], self._packed[places] = self._make(seeds, trials)
        self._seeds[places], self._trials[places] = seeds, trials
        self._ready[places] = True

    def _make(self, seeds: KeyArray, trials: KeyArray) -> tuple[FloatArray, FloatArray]:
        deviates = self._variation.draw_head_deviates(seeds, trials)
        return deviates, self._variation.make_true_heads(self._head, deviates).packed


class TrueHeadsAndConditions:
    """True heads of a batch, and the conditions of their running trials.

    Args:
        head: the model that a controller knows.
        num: number of heads.
        true_head: see `vergence.envs.plants.simulated.SimulatedPlant`, as for the rest.
        given: imperfections of the loop, by name.
        variation: conditions that each trial draws.

    Raises:
        ConfigurationError: an argument has an invalid shape or value.
    """

    def __init__(
        self,
        head: HeadModel,
        num: int,
        *,
        true_head: HeadModel | None,
        given: Mapping[str, ArrayLike | None],
        variation: Variation | None,
    ) -> None:
        self.variation = variation
        self._heads_vary = variation is not None and variation.model_errors is not None
        if self._heads_vary and true_head is not None:
            raise ConfigurationError(
                "expected one of variation.model_errors, model_errors and true_head, got two"
            )
        true_head = head if true_head is None else true_head
        if true_head.batch_shape not in ((), (1,), (num,)):
            raise ConfigurationError(
                f"true_head: expected one head or {num}, got shape {true_head.batch_shape}"
            )
        own, true = head.actuation, true_head.actuation
        if (own.direct, own.count) != (true.direct, true.count):
            raise ConfigurationError(
                f"true_head: expected actuators as the model has ({', '.join(own.names)}), got "
                f"{', '.join(true.names) or 'none'}"
            )
        self._head = head
        self._head_cache: TrueHeadPrefetcher | None = None
        self.given = true_head
        """True heads before model errors are drawn; they set the limits."""
        heads = np.array(true_head.packed.reshape(-1, PACKED))  # writable: kernels of one type
        if variation is not None and self._heads_vary:
            heads = np.repeat(heads, num, axis=0)
            self._deviates = np.zeros((num, DEVIATES))
            self._head_cache = TrueHeadPrefetcher(variation, true_head, num)
        self.packed = PackedConditions(
            np.empty((num, TRIAL_CONDITIONS)), np.empty((num, len(PER_ACTUATOR), 7)), heads
        )
        """Conditions of the running trials, in packed arrays that the next trials change."""
        self.conditions = _by_name(self.packed)
        """Conditions by name: views of the packed arrays."""
        drawn = variation or Variation()
        self._ranges = drawn.ranges(PER_TRIAL), drawn.ranges(PER_ACTUATOR)
        for name in IMPERFECTIONS:
            getattr(self.conditions, name)[:] = _values(num, name, given.get(name), true_head)
        self._derive()

    def __getstate__(self) -> dict[str, Any]:
        state = vars(self).copy()
        del state["conditions"]  # a copy would have separate arrays in place of views
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.conditions = _by_name(self.packed)

    def _derive(self) -> None:
        """Update the time between frames, which follows from clock drift and frame rate."""
        now = self.conditions
        self.packed.loop[:, len(PER_TRIAL)] = (1.0 + now.clock_drift) / now.frame_rate_hz

    @property
    def model(self) -> HeadModel:
        """The true heads: one, or a population of shape (num,)."""
        if self.variation is not None and self._heads_vary:
            return self.variation.make_true_heads(self.given, self._deviates)
        return self.given

    def largest_value(self, name: str) -> float:
        """Largest value of an imperfection in any trial."""
        given = float(getattr(self.conditions, name).max())
        return given if self.variation is None else self.variation.largest_value(name, given)

    def state_arrays(self) -> Arrays:
        """Conditions of the running trials, as state arrays."""
        arrays: Arrays = self.packed._asdict()
        if self._heads_vary:
            arrays["deviates"] = self._deviates
        else:
            del arrays["heads"]  # given once and for all
        return arrays

    def draw(self, streams: RandomStreams, ids: IntArray) -> None:
        """Draw the varying conditions of the trials of some environments.

        Args:
            streams: the trials' random streams.
            ids: (m,) environment indices.
        """
        variation, packed = self.variation, self.packed
        if variation is None:
            return
        keys = streams.seeds, streams.trials
        draw_conditions(*keys, ids, *self._ranges, packed.loop, packed.own)
        self._derive()
        if variation.backlash_rad is not None:
            _only_eyes(self.conditions.backlash_rad, self._head)
        if self._head_cache is not None:
            self._deviates[ids], self.conditions.heads[ids] = self._head_cache.take(streams, ids)


def _by_name(packed: PackedConditions) -> Conditions:
    """View packed conditions by name."""
    views = {name: packed.loop[:, i] for i, name in enumerate(PER_TRIAL)}
    views |= {name: packed.own[:, i] for i, name in enumerate(PER_ACTUATOR)}
    return Conditions(**views, heads=packed.heads)


def _only_eyes(backlash: FloatArray, head: HeadModel) -> None:
    """Set the backlash to zero in unused slots and in the neck, which is held."""
    backlash[:, :3] = 0.0
    backlash[:, 3 + head.actuation.count :] = 0.0


def _values(num: int, name: str, given: ArrayLike | None, head: HeadModel) -> FloatArray:
    """(num,) or (num, 7) values of an imperfection: as given, or the head's own."""
    one = IMPERFECTIONS[name]
    if given is None:
        return np.broadcast_to(one.nominal(head), (num, 7) if one.by_actuator else num)
    shape = "a number" if num == 1 else f"a number or {num} numbers"
    try:
        numbers = real_number_array(given)
        if one.by_actuator:
            shape += f", or ({num}, {head.actuation.count}) by actuator of the eyes"
            values = np.full((num, 7), one.default)
            eyes = values[:, 3 : 3 + head.actuation.count]
            eyes[:] = numbers[:, None] if numbers.ndim == 1 else numbers
        else:
            values = np.broadcast_to(numbers, (num,)).copy()
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"{name}: expected {shape}, got {given!r:.80}") from error
    if not (
        np.isfinite(values).all() and is_valid_range(name, float(values.min()), float(values.max()))
    ):
        raise ConfigurationError(f"{name}: expected {valid_range_text(name)}, got {given!r:.80}")
    return values
