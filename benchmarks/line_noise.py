"""Count false packets that the Dynamixel parser reads from a noisy serial line.

Run ``python benchmarks/line_noise.py``. It feeds ten minutes' worth of bytes at 1 Mb/s, 60 MB:
status packets of four servos with random bytes between them. In every second packet, bytes are
changed, lost, doubled or inserted. It counts parsed packets that had not been sent. A 16-bit
checksum accepts one of 65,536 corrupted packets; such a packet rarely also has the id and the
length of an expected answer.
"""

import argparse
import random

from rich.console import Console
from rich.progress import track

from vergence.hardware.dynamixel.packets import Packet, PacketParser, status_packet

BYTES_PER_S = 100_000
ANSWER_BYTES = 9
"""Bytes of an answer to a read of speed and position, including its error byte."""
IDS = (1, 2, 3, 4)


def mutated(packet: bytes, rng: random.Random) -> bytes:
    """Packet with some of its bytes changed, lost, doubled or inserted."""
    data = bytearray(packet)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(data)) if data else 0
        what = rng.randrange(4)
        if what == 0 and data:
            data[at] ^= rng.randint(1, 255)
        elif what == 1 and data:
            del data[at : at + rng.randint(1, 3)]
        elif what == 2:
            data[at:at] = data[at : at + rng.randint(1, 3)]
        else:
            data[at:at] = rng.randbytes(rng.randint(1, 3))
    return bytes(data)


def main() -> None:
    """Feed the parser, count packets and print."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seconds", type=float, default=600.0, help="of line time")
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    rng, parser = random.Random(given.seed), PacketParser()
    whole = broken = found = wrong = as_answers = fed = 0
    chunks = int(given.seconds * BYTES_PER_S / 4096)
    for _ in track(range(chunks), "feeding", console=Console(stderr=True)):
        parts, sent = [], set()
        size = 0
        while size < 4096:
            id, data = rng.choice(IDS), rng.randbytes(ANSWER_BYTES - 1)
            packet = status_packet(id, data)
            sent.add(Packet(id, 0x55, b"\0" + data))
            if rng.random() < 0.5:
                broken += 1
                packet = mutated(packet, rng)
            else:
                whole += 1
            parts.append(packet)
            if rng.random() < 0.2:
                parts.append(rng.randbytes(rng.randint(1, 40)))
            size = sum(map(len, parts))
        stream = b"".join(parts)
        fed += len(stream)
        at = 0
        while at < len(stream):
            step = rng.randint(1, 64)
            for one in parser.feed(stream[at : at + step]):
                found += 1
                if one not in sent:
                    wrong += 1
                    answer = one.id in IDS and one.instruction == 0x55
                    as_answers += answer and len(one.params) == ANSWER_BYTES
            at += step
        parser.clear()
    print(f"{fed / 1e6:.0f} MB, {whole:,} whole packets and {broken:,} broken ones")
    print(f"{found:,} came out, {wrong} of them not sent, {as_answers} of these as answers")


if __name__ == "__main__":
    main()
