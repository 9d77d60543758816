"""Line-up of an evaluation: controllers with their options, by scenario and plant."""

import shlex
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from vergence.controllers.controller import Controller
from vergence.controllers.tuned import user_table_path
from vergence.entry_points import is_entry_point
from vergence.envs.plant import plant_type
from vergence.envs.streams import as_seed
from vergence.errors import ConfigurationError
from vergence.eval.comparison.config import ROBOT, EvaluateConfig
from vergence.eval.comparison.contestants import (
    BASELINE,
    UNTUNED,
    Contestant,
    GivenOptions,
    ResolvedOptions,
    available_contestants,
    make_contestants,
    resolve_options,
)
from vergence.eval.trials.loops import TICK_RAD_S
from vergence.eval.trials.scenarios import Scenario, load_scenario
from vergence.eval.tuning.objective import tune_baseline
from vergence.hardware.config import HardwareConfig, load_hardware, loop_variation
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head, presets
from vergence.reporting.jobs import Mapper

MOST_TRIALS: Final = 100_000
"""Most trials of a controller in a scenario (chosen: a bound on memory, as all trials are held at
once and the errors alone of a trial of 2 s take 8 kB)."""


@dataclass(frozen=True, kw_only=True)
class Lineup:
    """Controllers, scenarios and plants of an evaluation."""

    head: HeadModel | None
    """The head that replaces the scenarios' heads, if any."""
    hardware: HardwareConfig | None
    """The robot, if any."""
    scenario_plant_pairs: list[tuple[Scenario, str]]
    """Each scenario with each plant that it runs on."""
    contestants_by_scenario: dict[str, list[tuple[Contestant, ResolvedOptions]]]
    """Contestants that can be made, with their options, by scenario."""
    notes: list[str]
    """Notes on controllers and plants that are left out, and on untuned controllers."""


def resolve_lineup(
    config: EvaluateConfig,
    extra_controllers: Mapping[str, Controller] | None,
    mapper: Mapper,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    *,
    include_baseline: bool = True,
) -> Lineup:
    """Resolve and check the line-up before any trial runs, and tune the baseline on request.

    `include_baseline` is true if `ibvs-tuned` takes part even without a request.
    """
    as_seed(config.seed)
    if config.trials < 1:
        raise ConfigurationError(f"episodes: expected at least 1, got {config.trials}")
    if config.trials > MOST_TRIALS:
        raise ConfigurationError(
            f"episodes: expected up to {MOST_TRIALS} trials of each controller in each scenario, "
            f"whose results the memory has to hold, got {config.trials}"
        )
    hardware = _hardware(config)
    head = _head(config, hardware)
    pairs, notes = _pairs(config, hardware)
    extra_controllers = extra_controllers or {}
    words = config.controllers or ((BASELINE,) if extra_controllers else ())
    given = _given(config, options)
    everyone = make_contestants(words, extra_controllers, given)
    if not include_baseline and (config.controllers or extra_controllers):
        asked = {*config.controllers, *extra_controllers}
        everyone = [one for one in everyone if one.label != BASELINE or BASELINE in asked]
    notes += given.check_names(name for one in everyone for name in one.names)
    if config.tune:
        tune_baselines(config, mapper, options)
    named = {*config.controllers, *extra_controllers, BASELINE}
    available = {}
    for scenario in {scenario.name: scenario for scenario, _ in pairs}.values():
        model = scenario.model() if head is None else head
        if hardware is not None:
            model = _with_command_quantisation(hardware)
        available[scenario.name], missing = available_contestants(everyone, model, scenario, named)
        notes += missing
        notes += _untuned(available[scenario.name], model, scenario, config, hardware)
    notes = list(dict.fromkeys(notes))
    return Lineup(
        head=head,
        hardware=hardware,
        scenario_plant_pairs=pairs,
        contestants_by_scenario=available,
        notes=notes,
    )


def tune_baselines(
    config: EvaluateConfig,
    mapper: Mapper,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    report: Callable[[str], None] = lambda text: None,
) -> None:
    """Tune the baseline for each scenario's head for which it is untuned, and report on it."""
    given, hardware = _given(config, options), _hardware(config)
    if hardware is not None:
        raise ConfigurationError(
            f"tune: expected none with --config: vergence evaluate --tune --head "
            f"{_source(config, hardware)} tunes for the head alone"
        )
    for scenario in {scenario.name: scenario for scenario, _ in _pairs(config, None)[0]}.values():
        head = scenario.model() if config.head is None else load_head(config.head)
        found = resolve_options(
            BASELINE, head, scenario.name, given.for_controller((BASELINE,), scenario.name)
        )
        if found.tuned is False:
            report(f"tuning {BASELINE} for the head {head.name} in {scenario.name}")
            entry = tune_baseline(scenario, head, config.head, mapper)
            report(f"{BASELINE}: gain {entry.options['gain']:g}, kept in {user_table_path()}")


def _hardware(config: EvaluateConfig) -> HardwareConfig | None:
    """The robot of `--config`, if any."""
    if config.stage is not None and not config.on_robot:
        raise ConfigurationError(
            f"stage: expected none without --plant {ROBOT}, got {config.stage}"
        )
    if config.hardware is None:
        if ROBOT in config.plants:
            raise ConfigurationError(
                f"config: expected the file that describes the robot of --plant {ROBOT}, got none "
                "(vergence emulate --out FILE writes one for an emulated head)"
            )
        return None
    if config.head is not None:
        raise ConfigurationError(
            f"head: expected none with --config, whose head is the robot's, got {config.head}"
        )
    return load_hardware(config.hardware)


def _head(config: EvaluateConfig, hardware: HardwareConfig | None) -> HeadModel | None:
    """The head that replaces the scenarios' heads, if any."""
    if hardware is not None:
        return hardware.head
    return None if config.head is None else load_head(config.head)


def _with_command_quantisation(hardware: HardwareConfig) -> HeadModel:
    """A robot's head with its servos' command quantisation, which the scenarios' heads include."""
    step = TICK_RAD_S / min(servo.gear_ratio for servo in hardware.servos)
    return hardware.head.replace(sensor={"command_resolution_rad_s": step})


def _source(config: EvaluateConfig, hardware: HardwareConfig | None) -> str | None:
    """Preset or file of the head that replaces the scenarios' heads."""
    if hardware is None:
        return config.head
    name = str(tomllib.loads(hardware.text)["head"])
    return name if name in presets() else str(Path(hardware.path).parent / name)


def _given(config: EvaluateConfig, options: Mapping[str, Mapping[str, Any]] | None) -> GivenOptions:
    if options is not None:
        return GivenOptions(options)
    return GivenOptions() if config.options is None else GivenOptions.read(config.options)


def _untuned(
    available: list[tuple[Contestant, ResolvedOptions]],
    head: HeadModel,
    scenario: Scenario,
    config: EvaluateConfig,
    hardware: HardwareConfig | None,
) -> list[str]:
    """Note on controllers that are untuned for this head."""
    names = [one.label for one, resolved in available if resolved.tuned is False]
    if not names:
        return []
    source = _source(config, hardware)
    which = "" if source is None else f" --head {shlex.quote(source)}"
    how = f"vergence tune NAME --scenario {scenario.name}{which} --write tunes one"
    if BASELINE in names:
        tune = "--tune" if hardware is None else f"vergence evaluate --tune{which}"
        how = f"{tune} tunes {BASELINE} first, {how}"
    return [f"{', '.join(names)}: {UNTUNED}, {head.name}, in {scenario.name}; {how}"]


def _pairs(
    config: EvaluateConfig, hardware: HardwareConfig | None
) -> tuple[list[tuple[Scenario, str]], list[str]]:
    """Pairs of scenario and plant that can run, and a note for each pair that cannot."""
    words_of = config.chosen_scenarios
    for name, words in (("scenario", words_of), ("plant", config.plants)):
        if not words:
            raise ConfigurationError(f"{name}: expected at least one, got none")
    scenarios = [load_scenario(name) for name in dict.fromkeys(words_of)]
    for plant in config.plants:
        plant_type(plant)  # raises for an unknown plant
    pairs, notes = [], []
    if hardware is not None:
        loop = loop_variation(hardware)
        scenarios = [replace(one, variation=loop) for one in scenarios]
    for scenario in scenarios:
        for plant in dict.fromkeys(config.plants):
            if plant in (ROBOT, *scenario.plants) or is_entry_point(plant):
                pairs.append((scenario, plant))
            else:
                where = f"{scenario.name}, which runs on {', '.join(scenario.plants)}"
                notes.append(f"{plant} is left out of {where}")
    if not pairs:
        raise ConfigurationError(
            f"plant: expected one on which a scenario runs, got {plant} for {where}"
        )
    return pairs, notes
