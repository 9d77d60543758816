"""Packets survive the wire, and nothing else does; registers are those of the SDK."""

from itertools import pairwise

import pytest
from dynamixel_easy_sdk import control_table as sdk
from dynamixel_sdk import Protocol2PacketHandler
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.naming import named, refused
from vergence.errors import ConfigurationError
from vergence.hardware.dynamixel import control_table
from vergence.hardware.dynamixel.packets import (
    BROADCAST,
    HEADER,
    MOST_LENGTH,
    Instruction,
    Packet,
    PacketParser,
    Status,
    crc16,
    instruction_packet,
    status_packet,
)

# what makes trouble: pieces of headers and of stuffing
PIECES = st.sampled_from([b"\xff", b"\xfd", b"\x00", b"\xff\xff\xfd", b"\xff\xff\xfd\xfd", HEADER])
TROUBLE = st.lists(PIECES | st.binary(max_size=4), max_size=40).map(b"".join)
IDS = st.integers(0, 252) | st.just(BROADCAST)
PACKETS = st.builds(Packet, IDS, st.sampled_from(list(Instruction)), TROUBLE)


def bytes_of(packet):
    return instruction_packet(*packet)


@given(packet=PACKETS)
def test_no_header_stands_inside_a_packet_before_its_checksum(packet):
    assert HEADER not in bytes_of(packet)[1:-2]


@pytest.mark.slow
@given(packets=st.lists(PACKETS, min_size=1, max_size=4), cuts=st.lists(st.integers(0, 400)))
def test_packets_come_whole_whatever_the_pieces(packets, cuts):
    stream = b"".join(bytes_of(packet) for packet in packets)
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    parser = PacketParser()
    found = [p for a, b in pairwise(edges) for p in parser.feed(stream[a:b])]
    assert found == packets


@pytest.mark.slow
@given(garbage=TROUBLE, packet=PACKETS)
def test_a_good_packet_is_found_at_once_behind_any_garbage(garbage, packet):
    assert PacketParser().feed(garbage + bytes_of(packet)) == [packet]


def test_a_header_that_announces_much_holds_nothing_back():
    parser, good = PacketParser(), Packet(2, Instruction.PING, b"")
    assert parser.feed(HEADER + bytes((1,)) + MOST_LENGTH.to_bytes(2, "little")) == []
    assert parser.feed(bytes_of(good)) == [good]
    assert parser.rejected == 1


def test_a_checksum_that_looks_like_a_header_is_none():
    # the last parameters are found so that the checksum continues FF FF with FD 00
    for value in range(1 << 16):
        sent = instruction_packet(1, Instruction.WRITE, value.to_bytes(2, "little") + b"\xff\xff")
        if sent.endswith(HEADER):
            break
    assert sent.endswith(HEADER)
    assert [packet.params[2:] for packet in PacketParser().feed(sent)] == [b"\xff\xff"]


@given(packet=PACKETS, data=st.data())
def test_a_damaged_packet_does_not_come_and_the_next_one_does(packet, data):
    sent = bytearray(bytes_of(packet))
    at = data.draw(st.integers(0, len(sent) - 1))
    sent[at] ^= data.draw(st.integers(1, 255))
    good = Packet(3, Instruction.STATUS, b"\x00\x01\x02\x03\x04")
    assert PacketParser().feed(bytes(sent) + bytes_of(good)) == [good]


@pytest.mark.slow
@given(packet=PACKETS, data=st.data())
def test_a_cut_packet_does_not_come_and_the_next_one_does(packet, data):
    sent = bytes_of(packet)
    cut = sent[: data.draw(st.integers(0, len(sent) - 1))]
    good = Packet(3, Instruction.STATUS, b"\x00\x01")
    # a checksum that ends in FF is whole again with the next header's first byte
    assume(not (cut + bytes_of(good)).startswith(sent))
    assert PacketParser().feed(cut + bytes_of(good)) == [good]


@given(data=st.binary(max_size=2000))
def test_what_waits_is_bounded(data):
    parser = PacketParser()
    parser.feed(HEADER + b"\x01" + MOST_LENGTH.to_bytes(2, "little") + data)
    assert len(parser) <= MOST_LENGTH + 6


def test_clear_forgets_a_beginning():
    parser = PacketParser()
    sent = instruction_packet(1, Instruction.PING)
    parser.feed(sent[:5])
    parser.clear()
    assert parser.feed(sent[5:]) == []
    assert parser.skipped == 5 + len(sent[5:])


@given(data=st.binary(min_size=1, max_size=300))
def test_checksums_are_those_of_the_sdk(data):
    assert crc16(data) == Protocol2PacketHandler().updateCRC(0, data, len(data))


def test_a_ping_is_that_of_the_manual():
    assert instruction_packet(1, Instruction.PING).hex(" ") == "ff ff fd 00 01 03 00 01 19 4e"


def test_a_status_tells_its_error_from_its_alert():
    (packet,) = PacketParser().feed(status_packet(7, b"\x2a", error=0x87))
    assert packet.status == Status(7, 7, True, b"\x2a")


def test_packets_that_cannot_be_are_refused():
    for id in (-1, 253, 255):
        with named(id), pytest.raises(ConfigurationError, match="expected 0 to 252 or 254"):
            instruction_packet(id, Instruction.PING)
    refused("at most 381 bytes", instruction_packet, 1, Instruction.WRITE, bytes(MOST_LENGTH))


# ---- registers ----


def table_of(model):
    try:
        table = sdk.ControlTable.getControlTable(model)
    except RuntimeError:  # the list names models whose table is not shipped
        return {}
    return {
        name.upper().replace(" ", "_"): (item.address, item.size) for name, item in table.items()
    }


def test_every_model_with_these_registers_is_listed():
    wanted = {(r.name, (r.address, r.length)) for r in control_table.REGISTERS}
    known = sdk.ControlTable.parsingModelList()
    having = {model for model in known if wanted <= set(table_of(model).items())}
    assert having == set(control_table.MODELS)


def test_models_have_the_names_and_units_of_the_sdk():
    for model, name in control_table.MODELS.items():
        file = name.lower().replace("-", "_") + ".model"
        assert sdk.ControlTable.getModelName(model) == file
        rows = (sdk.CONTROL_TABLE_PATH / file).read_text(encoding="utf-8").splitlines()
        cells = [row.split("\t") for row in rows]
        (speed,) = (float(row[1]) for row in cells if row[0] == "Present Velocity")
        with named(file):
            # the SDK took 0.229 rev/min as 0.02397 rad/s, which is 0.05 % off
            assert speed == pytest.approx(control_table.TICK_RAD_S, rel=1e-3)
            assert ["value_of_zero_radian_position", str(control_table.CENTRE_TICKS)] in cells


def test_a_tripped_watchdog_reads_as_all_ones():
    tripped = control_table.BUS_WATCHDOG.encode(control_table.WATCHDOG_TRIPPED)
    assert tripped == b"\xff"
