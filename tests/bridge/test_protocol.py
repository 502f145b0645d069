"""The protocol has one owner: what is generated from it is up to date, and the servo table is the
model's. The codec is the inverse of itself, equal to the C codec, and deaf to whatever is not a frame of
ours.

The test vectors of docs/wire_vectors.csv are what the Python codec says here and the C codecs in
the firmware's tests."""

import csv
import dataclasses

import numpy as np
import pytest
from hypothesis import given, strategies as st

from hpac_gym.bridge import FrameError
from hpac_gym.bridge.hands import Config, config_of, load_library
from hpac_gym.bridge.limits import limits_hash, servo_limits
from hpac_gym.bridge.protocol import (
    ANGLE_UNIT,
    FRAME_MAX,
    MESSAGE_BY_CODE,
    MESSAGES,
    Frame,
    FrameSplitter,
    cobs_decode,
    cobs_encode,
    decode,
    encode,
)
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, SERVOS, hand_to_toml
from tools import generate
from tools.wire_files import VECTORS


def test_generated_files_are_up_to_date(capsys, tmp_path):
    (tmp_path / "hand.toml").write_text(hand_to_toml(HPAC))
    assert generate.main(["--check", "--hand", str(tmp_path / "hand.toml")]) == 0
    (tmp_path / "hand.toml").write_text(
        hand_to_toml(dataclasses.replace(HPAC, rate_limit=HPAC.rate_limit / 2))
    )
    assert generate.main(["--check", "--hand", str(tmp_path / "hand.toml")]) == 1
    assert "firmware/core/hpac_protocol.h: out of date" in capsys.readouterr().out


def test_servo_limits_are_the_models_to_half_a_step_of_the_wire():
    limits = servo_limits()
    assert [servo.name for servo in limits] == list(SERVOS)
    half_step = 0.5 * ANGLE_UNIT + 1e-12
    np.testing.assert_allclose([s.min_urad * 1e-6 for s in limits], HPAC.servo_min, atol=half_step)
    np.testing.assert_allclose([s.max_urad * 1e-6 for s in limits], HPAC.servo_max, atol=half_step)
    np.testing.assert_allclose([s.rate_urad_s * 1e-6 for s in limits], HPAC.servo_rate_limit)


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"rate_limit": 1e-7}, "1e-07 rad/s; a board knows none below 1e-06 rad/s"),
        (
            {"workspace": HPAC.workspace | {"thumb_cmc": (-1.0, 2.3)}},
            "servo thumb_cmc: a range of 3.3 rad; the pulses of a servo reach 3.142 rad",
        ),
    ],
)
def test_a_hand_that_no_board_can_drive_has_no_servo_table(changed, named):
    with pytest.raises(ParameterError, match=named):
        servo_limits(dataclasses.replace(HPAC, **changed))


def test_firmware_was_compiled_with_this_servo_table():
    table = (Config * 2)()  # one more, to see where the first ends
    load_library().hpac_config_default(table)
    assert bytes(table) == bytes(config_of(HPAC)) + bytes(Config())


def test_limits_hash_changes_with_any_limit(monkeypatch):
    before = limits_hash()
    hashes = set()
    for i in range(len(SERVOS)):
        table = list(servo_limits())
        table[i] = dataclasses.replace(table[i], max_urad=table[i].max_urad - 100)
        monkeypatch.setattr("hpac_gym.bridge.limits.servo_limits", lambda _hand, table=table: table)
        hashes.add(limits_hash())
    assert len(hashes) == len(SERVOS)
    assert before not in hashes


def test_codes_tell_host_from_hand():
    assert all((message.code < 0x80) == message.from_host for message in MESSAGES.values())
    assert len(MESSAGE_BY_CODE) == len(MESSAGES)


# --- the codec
# ------------------------------------------------------------------------------------------

ROWS = list(csv.DictReader(VECTORS.read_text().splitlines()))
COMPLAINTS = {
    "crc": "damaged",
    "cobs": "not COBS",
    "short": "a frame of 4 bytes",
    "overrun": f"to {FRAME_MAX}",
    "length": "17 bytes of payload",
    "type": "unknown message type 0x(70|08)",
    **dict.fromkeys(("version", "look", "estop"), "protocol version [139]"),
}
"""What `decode` says to a frame that no hand takes, or of another version. Flags and sessions are
not the codec's business.
"""


def _field_values(field):
    bits = 8 * field.size
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if field.signed else (0, (1 << bits) - 1)
    integer = st.integers(low, high)
    return st.tuples(*[integer] * field.count) if field.count > 1 else integer


@st.composite
def frames(draw):
    message = draw(st.sampled_from(list(MESSAGES.values())))
    fields = {field.name: draw(_field_values(field)) for field in message.fields}
    return Frame(message.name, draw(st.integers(0, 0xFFFF)), draw(st.integers(0, 255)), fields)


MOVE = Frame(
    "move",
    7,
    0,
    {"session": 0x12345678, "duration_ms": 50, "servo": (0, 1, -1, 32767, -32768, 256)},
)


@given(frames())
def test_decode_is_the_inverse_of_encode(frame):
    data = encode(frame)
    assert data[0] == data[-1] == 0
    assert 0 not in data[1:-1]
    assert decode(data[1:-1]) == frame


@given(st.binary(max_size=253))
def test_cobs_decode_is_the_inverse_of_cobs_encode(data):
    encoded = cobs_encode(data)
    assert 0 not in encoded
    assert len(encoded) == len(data) + 1
    assert cobs_decode(encoded) == data


@given(st.lists(frames(), max_size=5), st.data())
def test_any_cut_of_a_stream_gives_the_same_frames(sent, data):
    stream = b"".join(encode(frame) for frame in sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    splitter = FrameSplitter()
    received = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        received += [frame for _, frame in splitter.push(stream[start:end])]
    assert received == sent


@pytest.mark.parametrize("row", ROWS, ids=[row["name"] for row in ROWS])
def test_the_python_codec_agrees_with_the_vector(row):
    wire = bytes.fromhex(row["wire"])
    assert wire[0] == wire[-1] == 0
    if row["verdict"] in COMPLAINTS:
        with pytest.raises(FrameError, match=COMPLAINTS[row["verdict"]]):
            decode(wire[1:-1])
    else:
        frame = decode(wire[1:-1])
        assert encode(frame) == wire
        assert row["verdict"] != "ok" or row["name"] == frame.name


def test_there_is_a_vector_of_every_message_and_of_every_way_to_refuse_a_frame():
    assert {row["name"] for row in ROWS} >= set(MESSAGES)
    assert {row["verdict"] for row in ROWS} >= {*COMPLAINTS, "ok", "flags", "session"}


MALFORMED = {
    row["name"]: bytes.fromhex(row["wire"])[1:-1] for row in ROWS if row["verdict"] in COMPLAINTS
} | {"empty": b""}


@pytest.mark.parametrize("by", ["whole", "byte by byte"])
@pytest.mark.parametrize("encoded", MALFORMED.values(), ids=MALFORMED)
def test_splitter_loses_nothing_but_the_malformed_piece(encoded, by):
    stream = encode(MOVE) + encoded + encode(MOVE)
    splitter = FrameSplitter()
    pieces = [stream] if by == "whole" else [bytes([byte]) for byte in stream]
    received = [frame for piece in pieces for _, frame in splitter.push(piece)]
    assert received == [MOVE, MOVE]


def test_splitter_forgets_a_flood_without_zeros():
    splitter = FrameSplitter()
    for _ in range(1000):
        assert splitter.push(b"x" * 1000) == []
    assert len(splitter._pending) < 100
    assert [frame for _, frame in splitter.push(encode(MOVE))] == [MOVE]


@pytest.mark.parametrize(
    "frame",
    [
        Frame("move", 1, 0, {"session": 1, "duration_ms": 50, "servo": (0,) * 5}),
        Frame("move", 1, 0, {"session": 1, "duration_ms": 50, "servo": (32768, 0, 0, 0, 0, 0)}),
        Frame("move", 1, 0, {"session": 1, "duration_ms": 65536, "servo": (0,) * 6}),
        Frame("move", 70000, 0, {"session": 1, "duration_ms": 50, "servo": (0,) * 6}),
    ],
    ids=["five servos", "angle overflow", "duration overflow", "sequence overflow"],
)
def test_encode_refuses_what_does_not_fit(frame):
    with pytest.raises(FrameError):
        encode(frame)
