"""The evidence itself: it holds for the hand that ships, and goes red for hands that break one promise each."""

import json
import os
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from hpac_gym.bridge import HostBoard, VirtualHand
from hpac_gym.bridge.evidence import judged_hand, oracle, safety, sessions
from hpac_gym.bridge.evidence.conform import RULES, conform
from hpac_gym.bridge.evidence.device import SESSION, BrokenRule, Device
from hpac_gym.bridge.evidence.oracle import unseal
from hpac_gym.bridge.hands import BUILD_VARIABLE
from hpac_gym.bridge.protocol import Fault, State
from hpac_gym.model import HPAC
from tests.bridge.test_commands import run

FIRMWARE = Path(__file__).parents[2] / "firmware"

# --- the safety case ------------------------------------------------------------------------------------------------


def check(claims):
    """On the wall clock a busy machine may be later than the limit; there it counts that the control is later still."""
    for claim in claims:
        limit = claim.control if "wall clock" in claim.claim else claim.limit
        assert claim.tried > 0, claim
        assert claim.figure <= limit, claim
        assert claim.control > claim.limit, claim


@pytest.mark.parametrize("row", safety._PLAYED, ids=lambda row: row[0])
def test_every_claim_about_a_hand_holds_beside_a_control_that_does_not(row):
    *given, play = row[:5]
    words = {safety._hostile: [2_000], safety._random_moves: [*row[5:], 150]}.get(play, row[5:])
    check([safety._played(*given, play, *words)])


def test_every_other_claim_holds_beside_a_control_that_does_not():
    driver, wall_clock = list(safety._driver(frames=20_000, seed=1)), list(safety._wall_clock(trials=2))
    assert (len(driver), len(wall_clock)) == (3, 2)
    check(driver + wall_clock)


@pytest.mark.slow
def test_every_safety_claim_is_one_row_of_the_command(capsys):
    run("safety", "--json", "--frames", "20000", "--trials", "5", "--sessions", "200")
    claims = json.loads(capsys.readouterr().out)
    assert len(claims) == len({claim["claim"] for claim in claims}) == len(safety._PLAYED) + 9
    check(safety.Claim(*list(claim.values())[:-1]) for claim in claims)


def test_a_claim_that_was_not_tried_does_not_hold(capsys, monkeypatch):
    assert not safety.Claim("it is safe", 0.0, 0.0, "ms", tried=0, control=1.0).holds
    assert not safety.Claim("it is safe", 0.0, 0.0, "ms", tried=5, control=0.0).holds
    assert safety.Claim("it is safe", 0.0, 0.0, "ms", tried=5, control=1.0).holds
    few = [claim for claim in safety._driver(frames=10, seed=1) if not claim.tried]
    assert few
    assert not any(claim.holds for claim in few)
    monkeypatch.setattr(safety, "measure", lambda *_: iter(few))
    assert run("safety") == 1
    assert "NOT TRIED" in capsys.readouterr().out


def test_a_broken_claim_is_told_and_ends_in_status_1(capsys, monkeypatch):
    monkeypatch.setattr(safety, "measure", lambda *_: iter([safety.Claim("it is safe", 21.0, 20.0, "ms", 1, 30.0)]))
    assert run("safety") == 1
    assert "BROKEN" in capsys.readouterr().out
    assert run("safety", "--json") == 1
    (row,) = json.loads(capsys.readouterr().out)
    assert row["claim"] == "it is safe"
    assert list(row.values())[1:] == [21.0, 20.0, "ms", 1, 30.0, False]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "was", "becomes", "claim"),
    [
        ("hpac_state.c", "        hpac_motion_stop(hand);\n    }\n", "    }\n", "hold for 30 s"),
        ("hpac_dispatch.c", "if (type == HPAC_ESTOP) {", "if (type == 99u) {", "e-stop"),
        ("hpac_state.c", "hand->repeatable = false;\n", "", "comes again"),
    ],
    ids=["hold with the motion running on", "no e-stop", "repeats after CLEAR"],
)
def test_a_firmware_that_breaks_a_promise_breaks_its_claim(tmp_path, file, was, becomes, claim):
    copy = tmp_path / "firmware"
    shutil.copytree(FIRMWARE, copy, ignore=shutil.ignore_patterns("build"))
    source = copy / "core" / file
    text = source.read_text()
    assert was in text
    source.write_text(text.replace(was, becomes))
    subprocess.run(["make", "-s", "-C", copy], check=True)
    program = (
        "from hpac_gym.bridge.evidence import safety\n"
        "from hpac_gym.bridge.errors import BridgeError\n"
        "for name, limit, unit, control, play, *words in safety._PLAYED:\n"
        "    try: figure = play(safety.JudgedHand, *words)[0]\n"
        "    except BridgeError: figure = limit + 1\n"
        "    print(figure <= limit, name)"
    )
    environment = os.environ | {BUILD_VARIABLE: str(copy / "build")}
    answer = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert [line for line in answer.stdout.splitlines() if line.startswith("False") and claim in line], answer.stdout


# --- random sessions ------------------------------------------------------------------------------------------------


def check_sessions(result: sessions.Sessions) -> None:
    assert result.powered == result.untold == result.swallowed == 0, result
    assert all(result.longest_cut_off[action] <= bound for action, bound in sessions.BOUND.items()), result
    assert result.with_pulses > 0.6 * result.sessions, result
    assert min(result.interrupted, result.cut_off.total(), result.lossy, result.unconfirmed) > 0.03 * result.sessions, result
    assert result.interrupted_twice > 0.01 * result.sessions, result


def test_no_random_session_leaves_the_hand_powered_and_those_without_last_words_are_found_out(monkeypatch):
    ran = []

    def run_sessions(count, seed, **how):
        ran.append(sessions.run_sessions(max(count, 60), seed, **how))
        return ran[-1]

    monkeypatch.setattr(safety, "run_sessions", run_sessions)
    claims = list(safety._sessions(120, seed=1))
    assert len(claims) == 4
    check(claims)
    seen, mute, _ = ran
    check_sessions(seen)
    assert mute.powered > 30
    assert mute.untold > 30


@pytest.mark.slow
def test_none_of_ten_thousand_random_sessions_leaves_the_hand_powered():
    check_sessions(sessions.run_sessions(10_000, seed=2))


# --- conformance ----------------------------------------------------------------------------------------------------


class Mute(VirtualHand):
    def transmit(self):
        super().transmit()
        return b""


class LosesStep(judged_hand.JudgedHand):
    """A hand that misses the frame after a damaged one."""

    lost = False

    def heard(self, data):
        pieces = list(filter(None, data.split(b"\0")))[self.lost :]
        self.lost = any(unseal(piece) is None for piece in pieces)
        return b"".join(b"\0" + piece + b"\0" for piece in pieces)


def rewriting(name, heard=lambda body: body, said=lambda body: body):
    """A hand that changes the frames that it hears or says: header and payload of each, without its CRC."""

    class Hand(judged_hand.JudgedHand):
        def heard(self, data):
            return judged_hand._rewritten(data, heard)

        def transmit(self):
            return judged_hand._rewritten(super().transmit(), said)

    Hand.__name__ = name
    return Hand


def put(body, when, at, value):
    """Put a byte into a frame's payload if a condition holds."""
    if when:
        body[5 + at] = value
    return body


def is_move_ack(body):
    return body[1] == oracle.ACK and body[5] == oracle.MOVE


OURS = struct.pack("<I", SESSION)
SILENCE = {"silence: detach", "silence: relax", "silence: hold, then relax"}
REPEATS = {"a MOVE comes once; old numbers are refused", "a MOVE from before CLEAR is refused"}
WRONG = {
    judged_hand.DeafToEstop: {"ESTOP is accepted from any sender, with any contents", "a fault is latched until CLEAR"},
    judged_hand.NoWatchdog: SILENCE | {"counters", "messages that feed the watchdog, and others"},
    judged_hand.Renumbering: REPEATS,
    judged_hand.Forgiving: {
        "a damaged frame is counted and not answered",
        "ARM, MOVE, HEARTBEAT and CLEAR belong to the session",
        "order of the checks of a frame",
    },
    LosesStep: {"junk does not affect later frames", "a lost byte costs at most one frame"},
    rewriting("Chatty", heard=lambda body: body[:4] + bytes([body[4] & ~2 if body[1] in (3, 4) else body[4]]) + body[5:]): {
        "no ACK where none is wanted, refusals always"
    },
    rewriting("WrongSequence", said=lambda body: put(body, is_move_ack(body), -3, body[2] ^ 1)): {"MOVE arrives; minimum jerk"},
    rewriting("AgreesToAll", said=lambda body: put(body, body[1] == oracle.ACK, 1, 0)): REPEATS
    | {
        "another version: HELLO is answered, all else but ESTOP refused",
        "length and type are checked",
        "flags are checked",
        "ARM checks hash, action and watchdog",
        "servos start one after the other; MOVE waits for them",
        "MOVE out of limits, too fast, too short, too long is refused",
        "a fault is latched until CLEAR",
        "periodic STATUS",
    },
    rewriting("BlamesAnother", said=lambda body: put(body, body[1] == oracle.ACK, 2, 5)): {
        "MOVE out of limits, too fast, too short, too long is refused"
    },
    rewriting("OtherLimits", said=lambda body: put(body, body[1] == oracle.DEVICE_HELLO, 7, body[12 % len(body)] ^ 1)): {
        "HELLO is answered with session and the limits' hash"
    },
    rewriting("TakenOverByALook", heard=lambda body: put(body, body[1] == 1 and not any(body[5:9]), 0, 1)): {
        "HELLO 0 is answered and changes nothing"
    },
    rewriting("Faithful", heard=lambda body: body[:5] + bytes(4) if body[1] == 1 and body[5:] != OURS else body): {
        "HELLO of another controller disarms and takes over"
    },
    rewriting("HearsItself", heard=lambda body: body[:1] + b"\4" + body[2:] if body[1] >= 0x80 else body): {
        "messages of the hand's own types are ignored"
    },
    rewriting("StartsAllAtOnce", said=lambda body: put(body, body[1] == 0x83 and body[11] > 0, 6, 0x3F)): {
        "servos start one after the other; MOVE waits for them"
    },
    rewriting("Detaches", heard=lambda body: put(body, body[1] == 2, 10, 2)): SILENCE - {"silence: detach"},
    rewriting("Holds", heard=lambda body: put(body, body[1] == 2, 10, 0)): SILENCE - {"silence: hold, then relax"},
    rewriting("GoesOn", heard=lambda body: body[:1] + b"\4" + body[2:] if body[1] == 6 else body): {
        "CLEAR stops motion and pulses"
    },
    rewriting("Forgets", said=lambda body: put(body, body[1] == 0x83, 30, 0)): REPEATS - {"a MOVE from before CLEAR is refused"},
    rewriting("AnswersOnly", said=lambda body: None if body[1] == 0x83 and body[2:4] == b"\0\0" else body): {"periodic STATUS"},
}


def test_the_firmware_conforms():
    rows = list(conform(VirtualHand().connect()))
    assert [row.rule for row in rows] == list(RULES)
    assert all(row.holds for row in rows), [row for row in rows if not row.holds]


@pytest.mark.slow
def test_the_host_board_conforms():
    with HostBoard() as board:
        assert run("conform", "--port", board.port) == 0


WHOLE = {judged_hand.DeafToEstop, judged_hand.NoWatchdog, judged_hand.Renumbering}
"""The wrong hands that further tests hold against all the rules."""
PERIOD_US = 5000
"""Of the wrong hands' ticks; fewer of them take less time to judge."""


@pytest.mark.parametrize(("kind", "rule"), [(kind, rule) for kind in WRONG if kind not in WHOLE for rule in sorted(WRONG[kind])])
def test_a_wrong_device_breaks_its_rule(kind, rule):
    (row,) = conform(kind(PERIOD_US).connect(), patience=0.1, rules=[rule])
    assert row.failure
    assert row.tried
    assert not row.holds


def test_a_mute_device_breaks_every_rule():
    for row in conform(Mute().connect(), patience=0.1):
        assert row.failure
        assert row.tried


def test_every_rule_is_broken_by_a_device_that_answers():
    assert set().union(*WRONG.values()) == set(RULES)


@pytest.mark.parametrize("kind", [judged_hand.DeafToEstop, judged_hand.NoWatchdog], ids=lambda kind: kind.__name__)
def test_a_wrong_device_keeps_the_other_rules(kind):
    assert {row.rule for row in conform(kind(PERIOD_US).connect(), patience=0.1) if not row.holds} == WRONG[kind]


@pytest.mark.parametrize("wrong", [{"state": State.armed}, {"fault": Fault.estop}, {"powered": True}], ids=str)
def test_a_device_in_another_state_breaks_the_rule(wrong):
    device = Device(VirtualHand().connect(), HPAC, patience=0.1)
    device.idle()
    right = {"state": State.idle, "when": "now", "fault": Fault.none, "powered": False}
    device.must_be(**right)
    with pytest.raises(BrokenRule, match="now idle, fault none, servos 000000, must be"):
        device.must_be(**right | wrong)
    with pytest.raises(BrokenRule, match=r"FAULT messages \[\], must be one of estop"):
        device.must_have_told(Fault.estop)


def test_conform_finds_renumbered_moves_leaves_the_hand_without_pulses_and_tells_its_status(capsys, monkeypatch):
    hand = judged_hand.Renumbering(PERIOD_US)
    monkeypatch.setattr("hpac_gym.bridge.commands.VirtualHand", lambda config: hand)
    assert run("conform", "--port", "virtual", "--json") == 1
    rows = json.loads(capsys.readouterr().out)
    assert {row["rule"] for row in rows if not row["holds"]} == WRONG[judged_hand.Renumbering]
    assert not hand.pulses().any()
