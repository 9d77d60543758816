"""The choices of a training run: a recipe's, and over them the user's."""

import dataclasses
import tomllib
from collections.abc import Sequence
from typing import Any, Final, get_type_hints

from vergence.controllers.networks.inputs import Inputs
from vergence.errors import ConfigurationError
from vergence.eval.trials.scenarios import load_scenario
from vergence.models.files.head_file import load_head
from vergence.models.head import HeadModel
from vergence.training.config import TrainConfig
from vergence.training.recipes import recipe

_GROUPS: Final = ("algorithm",)
"""Fields of the configuration that are themselves mappings: `algorithm.gamma=0.95`."""
_ACCEPTED: Final[dict[Any, tuple[type, ...]]] = {
    int: (int,),
    bool: (bool,),
    str: (str,),
    float: (float, int),
    float | None: (float, int),
}
_OWN: Final = ("kind", "algo", "head", "scenario", "plant", "seed")
"""Fields that have a word of their own on the command line."""


def choose(
    kind: str,
    *,
    algo: str = "ppo",
    head: str | None = None,
    scenario: str = "workspace",
    plant: str = "kinematic",
    seed: int = 0,
    steps: int | None = None,
    envs: int | None = None,
    inputs: str | None = None,
    randomise: bool = False,
    changes: Sequence[str] = (),
) -> tuple[TrainConfig, HeadModel]:
    """A run's configuration, with everything resolved.

    Args:
        kind: `gain-schedule` or `policy`.
        algo: `ppo` or `sac`.
        head: a preset's name or the path of a TOML file; None for the scenario's.
        scenario: what to learn in.
        plant: what moves the heads.
        seed: of everything.
        steps: control steps to learn from; None for the recipe's, as with the next two.
        envs: environments side by side.
        inputs: what the network sees.
        randomise: whether to learn with the hidden variation of scenario `robust`.
        changes: `field=value` with a value as in TOML, over all else.

    Returns:
        The configuration and the head.

    Raises:
        VergenceError: a name is unknown or a value cannot be.
    """
    named = load_scenario(scenario)
    words = {
        "algo": algo,
        "head": named.head if head is None else head,
        "scenario": scenario,
        "plant": plant,
        "seed": seed,
        "steps": steps,
        "envs": envs,
        "inputs": inputs,
        "randomise": randomise or None,
    }
    fields = {**vars(recipe(kind, algo)), **{k: v for k, v in words.items() if v is not None}}
    known = [field.name for field in dataclasses.fields(TrainConfig) if field.name not in _OWN]
    for change in changes:
        _apply(change, fields, known)
    for name in ("network", "critic"):
        fields[name] = tuple(fields[name])
    model = load_head(fields["head"])
    # inputs that are not told joint by joint cannot be learned from joint by joint
    shared = fields["shared"] and Inputs.of(fields["inputs"], model).by_joint is not None
    return TrainConfig(kind=kind, **{**fields, "shared": shared}), model


def _apply(change: str, fields: dict[str, Any], known: list[str]) -> None:
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
        fields[group] = _checked(group, value)


def _checked(name: str, value: Any) -> Any:
    """A value of the field's type."""
    hint = get_type_hints(TrainConfig)[name]
    expected = _ACCEPTED.get(hint, (list,))
    if not isinstance(value, expected) or (isinstance(value, bool) and hint is not bool):
        words = " or ".join(one.__name__ for one in expected)
        raise ConfigurationError(f"{name}: expected a value of type {words}, got {value!r}")
    return value
