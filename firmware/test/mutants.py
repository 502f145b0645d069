"""Deliberate faults in the core, each of which a unit test must notice.

Every mutant is one replacement in one file. The unit tests are built with it and must fail (or crash, or be stopped by
a sanitizer); a mutant that passes them is a hole in the tests and makes this exit with status 1.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from shutil import copytree

FIRMWARE = Path(__file__).parents[1]

MUTANTS = [
    # name, file, text, replacement
    ("overrun: no bound on a frame", "frame", "rx->received < HPAC_HOST_COBS_MAX", "rx->received < 255u"),
    ("overrun: the rest of a long frame is taken", "frame", "rx->overrun = true;", ";"),
    ("CRC: not compared", "frame", "hpac_get_u32(rx->frame + body) != hpac_crc32(rx->frame, body)", "false"),
    ("CRC: header left out", "frame", "!= hpac_crc32(rx->frame, body)", "!= hpac_crc32(rx->frame + 1, body - 1)"),
    ("CRC: not inverted", "crc32", "return ~crc;", "return crc;"),
    ("COBS: runs may pass the end", "frame", "code == 0u || in + code - 1u > length", "code == 0u"),
    ("frame: minimum length", "frame", "length < HPAC_HEADER_LENGTH + HPAC_CRC_LENGTH", "length < HPAC_CRC_LENGTH"),
    ("version: not compared", "frame", "rx->frame[HPAC_AT_VERSION] == HPAC_VERSION ?", "true ?"),
    ("length: payload not compared", "dispatch", "payload_length != rules[i].length", "false"),
    ("flags: not checked", "dispatch", "return allowed ? HPAC_REASON_OK : HPAC_REASON_FLAGS;", "return HPAC_REASON_OK;"),
    ("echo: answered", "dispatch", "if ((type & 0x80u) != 0u) {", "if (false) {"),
    ("sequence: old moves are taken", "dispatch", "(ahead == 0u || ahead >= 0x8000u)", "(ahead == 0u)"),
    ("sequence: same number, other move", "dispatch", "(ahead == 0u || ahead >= 0x8000u)", "(ahead >= 0x8000u)"),
    ("sequence: a repeat runs again", "dispatch", "seq == hand->last_seq && crc == hand->last_move_crc", "false"),
    ("sequence: HELLO does not reset it", "dispatch", "hand->any_move = false;", ";"),
    ("limit: upper angle", "motion", "urad >= servo->min_urad && urad <= servo->max_urad", "urad >= servo->min_urad"),
    ("limit: lower angle", "motion", "urad >= servo->min_urad && urad <= servo->max_urad", "urad <= servo->max_urad"),
    ("limit: overshoot", "motion", "|| !within(servo, hpac_ramp_turning_angle(ramp, i))", ""),
    ("limit: rate", "motion", "peak > admissible_speed(servo->rate_urad_s, ramp->duration_us)", "false"),
    ("limit: derated rate", "motion", "return peak > admissible_speed(derated, ramp->duration_us) ?", "return false ?"),
    ("limit: tolerance ten times too wide", "motion", "duration_us + HPAC_TIME_TOLERANCE_US", "duration_us + 10000"),
    ("limit: only five servos", "motion", "for (int i = 0; i < HPAC_SERVOS; i++) {\n        ramp.to[i] = hpac_get", "for (int i = 0; i < HPAC_SERVOS - 1; i++) {\n        ramp.to[i] = hpac_get"),
    ("limit: peak of minimum jerk taken as the mean", "ramp", "magnitude(5 * d - 2 * v) * 3 / 8", "magnitude(5 * d - 2 * v) / 5"),
    ("duration: too long", "motion", "|| duration_ms > HPAC_MOVE_MAX_MS", ""),
    ("duration: zero", "motion", "duration_ms < HPAC_MOVE_MIN_MS ||", ""),
    ("refusal: half carried out", "motion", "            *servo = (uint8_t)i;\n            return reason;", "            *servo = (uint8_t)i;\n            hand->ramp = ramp;\n            return reason;"),
    ("ramp: start ignores speed", "motion", "ramp.from_speed[i] = hpac_ramp_speed(&hand->ramp, (int)i, hand->now_us);", "ramp.from_speed[i] = 0;"),
    ("ramp: starts at the last target", "motion", "ramp.from[i] = hpac_motion_angle(hand, i);", "ramp.from[i] = hand->ramp.to[i];"),
    ("watchdog: never", "state", "hand->now_us - hand->heard_us >= HPAC_WATCHDOG_MS * US_PER_MS", "false"),
    ("watchdog: late", "state", ">= HPAC_WATCHDOG_MS * US_PER_MS", ">= 2 * HPAC_WATCHDOG_MS * US_PER_MS"),
    ("watchdog: fed by refused frames", "dispatch", "        hpac_state_count(&hand->count.refused);", "        hpac_state_count(&hand->count.refused);\n        hand->heard_us = hand->now_us;"),
    ("watchdog: always holds", "state", "action = (hpac_action_t)hand->action;", "action = HPAC_ACTION_HOLD;"),
    ("watchdog: relax keeps the pulses", "state", "if (hand->relaxing && !hpac_ramp_moving(&hand->ramp, hand->now_us)) {", "if (false) {"),
    ("e-stop: pulses go on", "state", "} else if (action == HPAC_ACTION_DETACH) {", "} else if (false) {"),
    ("e-stop: not latched", "state", "hand->state = HPAC_STATE_FAULT;", ";"),
    ("e-stop: refused for a flag", "dispatch", "HPAC_ESTOP_LENGTH, 0xffu", "HPAC_ESTOP_LENGTH, 0"),
    ("fault: HELLO leaves it", "dispatch", "if (hand->state != HPAC_STATE_FAULT) {", "if (true) {"),
    ("fault: ARM leaves it", "dispatch", "hand->state != HPAC_STATE_IDLE && hand->state != HPAC_STATE_ARMED", "hand->state == HPAC_STATE_BOOT"),
    ("fault: MOVE in FAULT", "dispatch", "if (hand->state != HPAC_STATE_ARMED) {\n        return HPAC_REASON_STATE;", "if (hand->state == HPAC_STATE_IDLE || hand->state == HPAC_STATE_BOOT) {\n        return HPAC_REASON_STATE;"),
    ("fault: CLEAR of a bad table", "dispatch", "hand->state == HPAC_STATE_BOOT || !hand->usable", "hand->state == HPAC_STATE_BOOT"),
    ("fault: brown-out forgotten", "hand", "reset == HPAC_RESET_BROWNOUT", "false"),
    ("clear: the motion goes on", "state", "void hpac_state_idle(hpac_hand_t *hand)\n{\n    hpac_state_detach(hand);", "void hpac_state_idle(hpac_hand_t *hand)\n{"),
    ("arm: any limits hash", "dispatch", "hpac_get_u32(payload + HPAC_ARM_AT_LIMITS_HASH) != HPAC_LIMITS_HASH", "false"),
    ("arm: any action", "dispatch", "if (action > HPAC_ACTION_DETACH) {", "if (false) {"),
    ("arm: all servos at once", "state", "(uint64_t)i * HPAC_STAGGER_MS * US_PER_MS", "(uint64_t)i * 0u"),
    ("arm: moves while starting", "dispatch", "if (hand->attached != ALL_ATTACHED) {", "if (false) {"),
    ("arm: hot servo", "dispatch", "if (hpac_load_rate_permille(hand->heat[i]) < 1000u) {", "if (false) {"),
    ("output: pulses when detached", "hand", "pulses[i] = attached ?", "pulses[i] = true ?"),
    ("output: wrong angle not caught", "hand", "hand->attached != 0u && (urad < servo->min_urad || urad > servo->max_urad)", "false"),
    ("load: never overloads", "state", "if (hand->heat[i] >= HPAC_HEAT_LIMIT) {", "if (false) {"),
    ("load: estimate stands still", "state", "hand->heat[i] = hpac_load_step(hand->heat[i], hpac_motion_effort(hand, i));", ";"),
    ("load: slower with rare ticks", "state", "hand->load_us += HPAC_LOAD_STEP_US;", "hand->load_us = hand->now_us;"),
    ("load: effort not squared", "load", "effort * effort * 256u", "effort * 750u * 256u"),
    ("trim: ignored", "servo", "servo->centre_ns + servo->trim_ns +", "servo->centre_ns +"),
    ("trim: direction ignored", "servo", "servo->direction * ((scaled", "((scaled"),
    ("trim: pulses outside of the servo's range", "servo", "return ordered && admissible(pulse(servo, servo->min_urad)) && admissible(pulse(servo, servo->max_urad));", "return ordered;"),
    ("status: too fast a rate", "dispatch", "period_ms != 0u && period_ms < HPAC_STATUS_MIN_MS", "false"),
    ("time: goes back", "state", "hand->now_us = now_us > hand->now_us ? now_us : hand->now_us;", "hand->now_us = now_us;"),
]  # fmt: skip


def _killed(compiler: str, folder: Path, mutant: tuple[str, str, str, str]) -> bool:
    name, file, text, replacement = mutant
    with tempfile.TemporaryDirectory(dir=folder) as copy:
        core = Path(copy) / "core"
        copytree(FIRMWARE / "core", core)
        source = core / f"hpac_{file}.c"
        before = source.read_text()
        if text not in before:
            sys.exit(f"mutant {name!r}: its text is no longer in {source.name}; bring test/mutants.py up to date")
        source.write_text(before.replace(text, replacement))
        test = FIRMWARE / "test"
        program = Path(copy) / "unit"
        build = [
            *(compiler, "-std=c99", "-O1", "-w", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"),
            *(f"-I{core}", f"-I{test}", f"-I{test / 'unit'}", "-o", str(program)),
            *map(str, [*core.glob("*.c"), test / "bench.c", *(test / "unit").glob("*.c")]),
        ]
        subprocess.run(build, check=True)
        try:
            return subprocess.run([program], capture_output=True, timeout=20, check=False).returncode != 0
        except subprocess.TimeoutExpired:
            return True


def main() -> int:
    """Build and run every mutant; the exit status tells whether all were killed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cc", default="cc", help="C compiler")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(2) as pool:
        killed = list(pool.map(lambda mutant: _killed(options.cc, Path(folder), mutant), MUTANTS))
    for mutant, dead in zip(MUTANTS, killed, strict=True):
        if not dead:
            print(f"survived: {mutant[0]}")
    print(f"mutants: {sum(killed)} of {len(MUTANTS)} killed by the unit tests")
    return 0 if all(killed) else 1


if __name__ == "__main__":
    sys.exit(main())
