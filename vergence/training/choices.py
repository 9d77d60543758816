"""The choices of a training run: a recipe's, and over them the user's."""

import dataclasses
import tomllib
from typing import Any, Final

from vergence.controllers.networks.inputs import Inputs
from vergence.errors import ConfigurationError
from vergence.eval.trials.scenarios import load_scenario
from vergence.models.files.head_file import load_head
from vergence.models.head import HeadModel
from vergence.training.config import TrainConfig, check_kind, check_type
from vergence.training.options import TrainOptions
from vergence.training.recipes import recipe

_GROUPS: Final = ("algorithm",)
"""Fields of the configuration that are themselves mappings: `algorithm.gamma=0.95`."""
_OWN: Final = ("kind", "head", "scenario", "plant", "seed")
"""Fields that have a word of their own on the command line."""


def choose(options: TrainOptions) -> tuple[TrainConfig, HeadModel]:
    """A run's configuration, with everything resolved.

    Args:
        options: what a person has chosen.

    Returns:
        The configuration and the head.

    Raises:
        VergenceError: there is no kind, a name is unknown or a value cannot be.
    """
    if options.kind is None:
        raise ConfigurationError(
            "train: expected gain-schedule or policy, or --resume RUN, got neither"
        )
    check_kind(options.kind)
    scenario = load_scenario(options.scenario)
    # what was not asked for is the recipe's
    fields = {**vars(recipe(options.kind)), "head": ""}
    fields |= {name: value for name, value in vars(options).items() if value is not None}
    del fields["set"]
    known = [field.name for field in dataclasses.fields(TrainConfig) if field.name not in _OWN]
    asked = [_apply(change, fields, known) for change in options.set]
    # the scenario's head may differ from the preset of its name, by the steps of its encoders
    model = load_head(fields["head"]) if fields["head"] else scenario.model()
    if "shared" not in asked and Inputs.of(fields["inputs"], model).by_joint is None:
        # inputs that are not told joint by joint cannot be learned from joint by joint
        fields["shared"] = False
    return TrainConfig(**fields), model


def _apply(change: str, fields: dict[str, Any], known: list[str]) -> str:
    """Apply `FIELD=VALUE` to the fields; the field's name."""
    name, equals, text = change.partition("=")
    group, _, key = name.strip().partition(".")
    if not equals or group not in known or (group in _GROUPS) != bool(key):
        raise ConfigurationError(
            f"set: expected FIELD=VALUE with a field of {', '.join(known)} "
            f"(and algorithm.OPTION), got {change!r}"
        )
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    if key:
        fields[group] = {**fields.get(group, {}), key: value}
    else:
        fields[group] = tuple(value) if isinstance(value, list) else value
        check_type(group, fields[group])
    return group
