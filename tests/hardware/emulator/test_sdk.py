"""ROBOTIS's own client finds in the emulated servos what it finds in real ones."""

import pytest
from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler

from tests.hardware.line import make_servo
from vergence.hardware.dynamixel.control_table import VELOCITY_MODE

PACKETS = PacketHandler(2.0)


class PatientPort(PortHandler):
    """A port whose answers may take longer than on a wire, on a machine that is busy."""

    def setPacketTimeout(self, packet_length):
        self.setPacketTimeoutMillis(2000.0)


@pytest.fixture
def port(serve):
    port = PatientPort(serve([make_servo(1), make_servo(2, position_rad=0.5)]).port)
    assert port.openPort()
    yield port
    port.closePort()


def test_a_ping_finds_the_model(port):
    assert PACKETS.ping(port, 2) == (1060, COMM_SUCCESS, 0)


def test_bytes_that_look_like_a_header_are_written_and_read(port):
    assert PACKETS.writeTxRx(port, 1, 224, 6, [255, 255, 253, 255, 255, 253])[0] == COMM_SUCCESS
    assert PACKETS.readTxRx(port, 1, 224, 6)[0] == [255, 255, 253, 255, 255, 253]


def test_a_sync_read_brings_each_position(port):
    reader = GroupSyncRead(port, PACKETS, 132, 4)
    for id in (1, 2):
        assert reader.addParam(id)
    assert reader.txRxPacket() == COMM_SUCCESS
    assert [reader.getData(id, 132, 4) for id in (1, 2)] == [2048, 2374]


def test_a_sync_write_reaches_each_servo(port):
    writer = GroupSyncWrite(port, PACKETS, 104, 4)
    for id in (1, 2):
        assert writer.addParam(id, [10 * id, 0, 0, 0])
    assert writer.txPacket() == COMM_SUCCESS
    assert [PACKETS.read4ByteTxRx(port, id, 104)[0] for id in (1, 2)] == [10, 20]


def test_the_eeprom_is_locked_under_torque(port):
    assert PACKETS.write1ByteTxRx(port, 1, 64, 1) == (COMM_SUCCESS, 0)
    result, error = PACKETS.write1ByteTxRx(port, 1, 11, VELOCITY_MODE)
    assert result == COMM_SUCCESS
    assert "not available" in PACKETS.getRxPacketError(error)
