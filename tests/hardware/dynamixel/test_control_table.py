"""Registers and units are those that the SDK ships for each model."""

import pytest
from dynamixel_easy_sdk import control_table as sdk

from tests.naming import named
from vergence.hardware.dynamixel import control_table
from vergence.hardware.dynamixel.control_table import MODELS, REGISTERS, TICK_RAD_S


def table_of(model):
    table = sdk.ControlTable.getControlTable(model)
    return {
        name.upper().replace(" ", "_"): (item.address, item.size) for name, item in table.items()
    }


def test_every_model_with_these_registers_is_listed():
    wanted = {(r.name, (r.address, r.length)) for r in REGISTERS}
    known = sdk.ControlTable.parsingModelList()
    having = set()
    for model in known:
        try:
            table = table_of(model)
        except RuntimeError:  # the list names models whose table is not shipped
            continue
        if wanted <= set(table.items()):
            having.add(model)
    assert having == set(MODELS)


def test_models_have_the_names_of_the_sdk():
    for model, name in MODELS.items():
        file = name.lower().replace("-", "_") + ".model"
        assert sdk.ControlTable.getModelName(model) == file


def test_every_model_has_these_units():
    for model in MODELS:
        file = sdk.ControlTable.getModelName(model)
        rows = (sdk.CONTROL_TABLE_PATH / file).read_text(encoding="utf-8").splitlines()
        cells = [row.split("\t") for row in rows]
        units = {row[0]: row[1:] for row in cells if row[0] == "Present Velocity"}
        with named(file):
            # the SDK took 0.229 rev/min as 0.02397 rad/s, which is 0.05 % off
            assert float(units["Present Velocity"][0]) == pytest.approx(TICK_RAD_S, rel=1e-3)
            assert ["value_of_zero_radian_position", str(control_table.CENTRE_TICKS)] in cells


def test_a_tripped_watchdog_reads_as_all_ones():
    tripped = control_table.BUS_WATCHDOG.encode(control_table.WATCHDOG_TRIPPED)
    assert tripped == b"\xff"
