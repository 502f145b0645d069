"""The test vectors of docs/wire_vectors.csv against the Python codec; the firmware's tests hold them against the C codecs."""

import csv

import pytest

from hpac_gym.bridge.errors import FrameError, VersionError
from hpac_gym.bridge.frame import decode, encode
from hpac_gym.bridge.protocol import FRAME_MAX, MESSAGES
from tools.wire_files import VECTORS

ROWS = list(csv.DictReader(VECTORS.read_text().splitlines()))
COMPLAINTS = {
    "crc": "damaged",
    "cobs": "not COBS",
    "short": "a frame of 4 bytes",
    "overrun": f"to {FRAME_MAX}",
    "length": "17 bytes of payload",
    "type": "unknown message type 0x(70|08)",
}
"""What `decode` says to a frame that no hand takes. Flags and sessions are not the codec's business."""


@pytest.mark.parametrize("row", ROWS, ids=[row["name"] for row in ROWS])
def test_the_python_codec_agrees_with_the_vector(row):
    wire = bytes.fromhex(row["wire"])
    assert wire[0] == wire[-1] == 0
    encoded = wire[1:-1]
    if row["verdict"] in ("version", "look", "estop"):
        with pytest.raises(VersionError):
            decode(encoded)
    elif row["verdict"] in COMPLAINTS:
        with pytest.raises(FrameError, match=COMPLAINTS[row["verdict"]]):
            decode(encoded)
    else:
        frame = decode(encoded)
        assert encode(frame) == wire
        assert row["verdict"] != "ok" or row["name"] == frame.name


def test_there_is_a_vector_of_every_message_and_of_every_way_to_refuse_a_frame():
    names = {row["name"] for row in ROWS}
    assert names >= set(MESSAGES)
    assert {row["verdict"] for row in ROWS} >= {*COMPLAINTS, "ok", "flags", "session", "version", "look", "estop"}
