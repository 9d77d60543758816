"""Resolve the configuration of a training run: the recipe's values, overridden by the user's."""

import dataclasses
import tomllib
from typing import Any, Final

from vergence.controllers.networks.inputs import Inputs
from vergence.errors import ConfigurationError
from vergence.eval.trials.scenarios import load_scenario
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.training.config import TrainConfig, check_kind, check_type
from vergence.training.options import TrainOptions
from vergence.training.recipes import default_recipe

_GROUPS: Final = ("algorithm",)
"""Fields of the configuration that are themselves mappings: `algorithm.gamma=0.95`."""
_OWN: Final = ("kind", "head", "scenario", "plant", "seed")
"""Fields with an option of their own on the command line, which `--set` does not take."""


def resolve_config(options: TrainOptions) -> tuple[TrainConfig, HeadModel]:
    """Resolve a run's configuration.

    Args:
        options: the user's choices.

    Returns:
        The configuration and the head.

    Raises:
        VergenceError: no kind is given, a name is unknown or a value is invalid.
    """
    if options.kind is None:
        raise ConfigurationError(
            "train: expected gain-schedule or policy, or --resume RUN, got neither"
        )
    check_kind(options.kind)
    scenario = load_scenario(options.scenario)
    # fields that the user has not set are the recipe's
    fields = {**vars(default_recipe(options.kind)), "head": ""}
    fields |= {name: value for name, value in vars(options).items() if value is not None}
    del fields["set"]
    known = [field.name for field in dataclasses.fields(TrainConfig) if field.name not in _OWN]
    asked = [_apply(change, fields, known) for change in options.set]
    # the scenario's head may differ from the preset of that name in its encoder quantisation
    model = load_head(fields["head"]) if fields["head"] else scenario.model()
    if "shared" not in asked and Inputs(fields["inputs"], model).by_joint is None:
        # a network shared by the joints needs inputs that are given per joint
        fields["shared"] = False
    return TrainConfig(**fields), model


def _apply(change: str, fields: dict[str, Any], known: list[str]) -> str:
    """Apply `FIELD=VALUE` to the fields; return the field's name."""
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
