"""The evidence itself: it holds for the hand that ships, and goes red for hands that break one
promise each.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hpac_gym.bridge.evidence import codec as wire
from hpac_gym.bridge.firmware import BUILD_VARIABLE
from hpac_gym.bridge.hands import VirtualHand
from tools.evidence import hostile, safety, scenarios, sessions
from tools.evidence.judged_hand import Renumbering, _rewritten

FIRMWARE = Path(__file__).parents[2] / "firmware"

# --- the safety case
# ------------------------------------------------------------------------------------------------


def check(claims):
    """No claim allows a single violation, only times. On the wall clock a busy machine may be later
    than the limit; there it counts that the control is later still."""
    for claim in claims:
        assert claim.limit == 0 or claim.unit in ("s", "ms"), claim
        limit = claim.control if "wall clock" in claim.claim else claim.limit
        assert claim.tried > 0, claim
        assert claim.figure <= limit, claim
        assert claim.control > claim.limit, claim


@pytest.mark.parametrize("row", safety._PLAYED, ids=lambda row: row[0])
def test_every_claim_about_a_hand_holds_beside_a_control_that_does_not(row):
    *given, play = row[:5]
    words = {hostile.hostile: [2_000], scenarios.random_moves: [*row[5:], 150]}.get(play, row[5:])
    check([safety._played(*given, play, *words)])


def test_every_other_claim_holds_beside_a_control_that_does_not():
    driver = list(safety._driver(frames=20_000, seed=1))
    wall_clock = list(safety._wall_clock(trials=2))
    assert (len(driver), len(wall_clock)) == (3, 2)
    check(driver + wall_clock)


class ForgetsUntilCleared(Renumbering):
    """Carries out a MOVE that comes again, and does not say so; from CLEAR on it moves no more."""

    cleared = False

    def _renumber(self, body):
        self.cleared |= body[1] == wire.CLEAR
        return None if self.cleared and body[1] == wire.MOVE else super()._renumber(body)

    def _number_back(self, body):
        unsaid = body[1] == wire.ACK and body[5] == wire.MOVE and self.seq > 1
        return None if unsaid else super()._number_back(body)


def test_a_move_that_comes_again_counts_by_its_motion_before_clear_too():
    assert scenarios.old_moves(ForgetsUntilCleared) == (1, 9)


@pytest.mark.slow
def test_every_safety_claim_is_one_row_of_the_command(capsys):
    safety.main(["--json", "--frames", "20000", "--trials", "5", "--sessions", "200"])
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
    assert safety.main([]) == 1
    assert "NOT TRIED" in capsys.readouterr().out


def test_a_broken_claim_is_told_and_ends_in_status_1(capsys, monkeypatch):
    monkeypatch.setattr(
        safety, "measure", lambda *_: iter([safety.Claim("it is safe", 21.0, 20.0, "ms", 1, 30.0)])
    )
    assert safety.main([]) == 1
    assert "BROKEN" in capsys.readouterr().out
    assert safety.main(["--json"]) == 1
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
        "from tools.evidence import safety\n"
        "from hpac_gym.bridge.errors import BridgeError\n"
        "for name, limit, unit, control, play, *words in safety._PLAYED:\n"
        "    try: figure = play(safety.JudgedHand, *words)[0]\n"
        "    except BridgeError: figure = limit + 1\n"
        "    print(figure <= limit, name)"
    )
    environment = os.environ | {BUILD_VARIABLE: str(copy / "build")}
    answer = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    assert [
        line for line in answer.stdout.splitlines() if line.startswith("False") and claim in line
    ], answer.stdout


# --- random sessions
# ------------------------------------------------------------------------------------------------


def check_sessions(result: sessions.Sessions) -> None:
    assert result.powered == result.untold == result.swallowed == 0, result
    assert all(
        result.longest_cut_off[action] <= bound for action, bound in sessions.BOUND.items()
    ), result
    assert result.with_pulses > 0.6 * result.sessions, result
    assert (
        min(result.interrupted, result.cut_off.total(), result.lossy, result.unconfirmed)
        > 0.03 * result.sessions
    ), result
    assert result.interrupted_twice > 0.01 * result.sessions, result


def test_no_random_session_leaves_the_hand_powered_and_those_without_last_words_are_found_out(
    monkeypatch,
):
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


def test_safety_tries_ten_million_frames_twenty_times_ten_thousand_sessions_unless_told(
    monkeypatch,
):
    asked = []
    monkeypatch.setattr(safety, "measure", lambda *numbers: asked.append(numbers) or iter(()))
    safety.main([])
    safety.main(["--frames", "1", "--trials", "1", "--sessions", "1", "--seed", "1"])
    assert asked == [(10_000_000, 20, 10_000, 1), (1, 1, 1, 1)]
    with pytest.raises(SystemExit):
        safety.main(["--sessions", "0"])


class Deaf(VirtualHand):
    """Hears everything but CLEAR and ESTOP, so that every link ends with a warning."""

    def receive(self, data):
        ends = (wire.CLEAR, wire.ESTOP)
        super().receive(_rewritten(data, lambda body: None if body[1] in ends else body))


def test_a_hand_that_stays_powered_counts_even_if_its_user_was_told():
    """The headline claim counts hands, not warnings."""
    found = sessions.run_sessions(30, seed=3, kind=Deaf)
    assert found.powered > 2
    assert found.untold == 0
