"""Named faults of the firmware's core, each with the judge that must notice it: the negative controls of
the tests."""

CONTROLS = [
    (
        "hold: a move runs on after the watchdog",
        "state",
        "        hpac_motion_stop(hand);\n    }\n    if",
        "    }\n    if",
        "driver",
    ),
    (
        "watchdog: strangers feed it",
        "dispatch",
        "    hand->count.accepted++;\n    if",
        "    hand->heard_us = hand->now_us;\n    if",
        "driver",
    ),
    (
        "watchdog: the wrong action",
        "state",
        "(hpac_action_t)hand->action",
        "HPAC_ACTION_HOLD",
        "driver",
    ),
    (
        "relax: too fast",
        "motion",
        "limits->rate_urad_s * HPAC_RELAX_PERMILLE",
        "limits->rate_urad_s * 1000",
        "driver",
    ),
    (
        "start: two servos at once",
        "state",
        "hand->start_left_us = hpac_motion_start_us(hand, i);",
        ";",
        "driver",
    ),
    (
        "late tick: the motion jumps",
        "state",
        "late_us < room_us ? (uint32_t)late_us : room_us",
        "(uint32_t)late_us",
        "driver",
    ),
    (
        "stream: the credit never ends",
        "motion",
        "return left + filled - used;",
        "return credit_max(limits) + filled;",
        "driver",
    ),
    (
        "e-stop: out of the session",
        "dispatch",
        "if (type == HPAC_ESTOP) {\n        estop(hand, seq);\n        return;",
        "if (type == HPAC_ESTOP && hand->session != 0u) {\n        estop(hand, seq);\n        return;",
        "driver",
    ),
    ("stale: an old number after CLEAR", "state", "    hand->repeatable = false;\n", "", "driver"),
    (
        "flipped bit: no slew limit",
        "motion",
        "|| credit_now(hand, i) < -(int64_t)ROUNDING_URAD * NRAD_PER_URAD",
        "",
        "flips",
    ),
    (
        "flipped bit: no table",
        "motion",
        "!within(limits_of(hand, i), hpac_motion_angle(hand, i))\n            ||",
        "",
        "flips",
    ),
    (
        "flipped bit: a hold without end",
        "state",
        " && hand->safe_until_us <= hand->now_us + longest_us",
        "",
        "flips",
    ),
    ("flipped bit: state not looked at", "state", "if (!sound(hand)) {", "if (false) {", "flips"),
    (
        "flipped bit: clock not looked at",
        "state",
        "hand->now_us != ~hand->not_now_us || ",
        "",
        "flips",
    ),
]
"""Name, file, text, replacement, and the judge that must notice."""
