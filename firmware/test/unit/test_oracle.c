/* The oracle against the hand where both know a moment to a few microseconds only: the start of a servo that travels from an
 * angle within a motion, the end of a relax. It must neither raise a false alarm there nor overlook a hand that is early or late. */
#include <string.h>

#include "check.h"
#include "hpac_hand.h"
#include "oracle.h"
#include "tests.h"

#define SESSION 0x51e55107u

typedef struct {
    hpac_hand_t hand;
    hpac_config_t config;
    oracle_t oracle;
    uint64_t now_us;
    uint16_t seq;
} watched_t;

static void judge(watched_t *w, const uint8_t *bytes, size_t length, const uint32_t *pulses)
{
    uint8_t answers[HPAC_TX_CAPACITY];
    size_t answered = hpac_hand_transmit(&w->hand, answers, sizeof answers);
    oracle_judge(&w->oracle, w->now_us, bytes, length, answers, answered, pulses);
}

static void tick(watched_t *w, uint32_t us)
{
    uint32_t pulses[HPAC_SERVOS];
    w->now_us += us;
    hpac_hand_tick(&w->hand, &w->config, w->now_us, pulses);
    judge(w, NULL, 0, pulses);
}

/* A frame that comes `us` later, between two ticks: the oracle sees no pulses then. */
static void say(watched_t *w, uint32_t us, uint8_t type, uint8_t flags, const uint8_t *payload, size_t length)
{
    uint8_t wire[64];
    uint8_t body[32] = { 0 };
    if (length > 0u) {
        memcpy(body + 4, payload, length);
    }
    hpac_put_u32(body, SESSION);
    w->now_us += us;
    size_t size = oracle_encode(wire, HPAC_VERSION, type, ++w->seq, flags, body, length + 4u);
    hpac_hand_receive(&w->hand, &w->config, w->now_us, wire, size);
    judge(w, wire, size, NULL);
}

static void heartbeat(watched_t *w, uint32_t us) { say(w, us, HPAC_HEARTBEAT, 0, NULL, 0); }

static void arm(watched_t *w)
{
    uint8_t payload[7];
    hpac_put_u32(payload, oracle_hash(w->oracle.guard.table));
    hpac_put_u16(payload + 4, HPAC_WATCHDOG_MAX_MS);
    payload[6] = HPAC_ACTION_RELAX;
    say(w, 0, HPAC_ARM, 0, payload, sizeof payload);
}

static void run(watched_t *w, uint32_t ms)
{
    for (; ms > 0u; ms--) {
        tick(w, 1000);
        if (ms % 100u == 0u) {
            heartbeat(w, 0);
        }
    }
}

/* A hand that was stopped `ms` into a smooth motion, and is armed again. */
static void armed_within_a_motion(watched_t *w, uint32_t ms)
{
    static const int16_t target[HPAC_SERVOS] = { 9876, 7654, 5432, 3210, 8765, 6543 };
    uint8_t move[14];
    oracle_servo_t table[ORACLE_SERVOS];
    memset(w, 0, sizeof *w);
    hpac_config_default(&w->config);
    oracle_table(table, 2.0);
    hpac_hand_init(&w->hand, &w->config, HPAC_RESET_POWER_ON, 7, NULL);
    oracle_start(&w->oracle, table, 0, 7);
    tick(w, 1000);
    say(w, 0, HPAC_HELLO, 0, NULL, 0);
    arm(w);
    run(w, 2500);
    hpac_put_u16(move, 1234);
    for (int i = 0; i < HPAC_SERVOS; i++) {
        hpac_put_u16(move + 2 + 2 * i, (uint16_t)target[i]);
    }
    say(w, 0, HPAC_MOVE, HPAC_FLAG_MINIMUM_JERK, move, sizeof move);
    run(w, ms);
    heartbeat(w, 137);
    say(w, 0, HPAC_CLEAR, 0, NULL, 0);
    arm(w);
}

/* A frame `offset_us` off the moment at which each servo starts, and the next pulses 14 ms later. */
static void frames_about_a_start_raise_no_alarm(uint32_t ms, int offset_us)
{
    watched_t w;
    armed_within_a_motion(&w, ms);
    for (int servo = 0; servo <= HPAC_SERVOS; servo++) {
        while (w.hand.start_left_us > 1000u) {
            tick(&w, 500);
        }
        heartbeat(&w, (uint32_t)((int)w.hand.start_left_us + offset_us));
        tick(&w, 14000);
    }
    run(&w, 5000);
    CHECK(w.oracle.guard.broken[0] == '\0');
    CHECK(w.oracle.state == HPAC_STATE_ARMED && w.oracle.arms == 2u && !w.oracle.starting && !w.hand.starting);
}

/* One servo starts a little early or late, on a board that ticks finely enough to show it. */
static void a_start_at_the_wrong_time_is_noticed(uint32_t ms, int wrong_us)
{
    watched_t w;
    armed_within_a_motion(&w, ms);
    while (w.hand.attached != 7u) {
        tick(&w, 100);
    }
    w.hand.start_left_us += (uint32_t)wrong_us;
    while (w.hand.attached != 15u) {
        tick(&w, 100);
    }
    tick(&w, 100);
    CHECK((w.oracle.guard.broken[0] == '\0') == (wrong_us == 0));
}

/* Where the oracle sees a microradian left to rest, which no pulse shows, the hand may see none: its pulses end at once. */
static void a_relax_at_rest_raises_no_alarm(double off_urad)
{
    watched_t w;
    armed_within_a_motion(&w, 100);
    run(&w, 5000);
    w.oracle.ramp.to[0] += off_urad;
    for (uint32_t ms = 0; ms <= HPAC_WATCHDOG_MAX_MS; ms++) {
        tick(&w, 1000);
    }
    CHECK(w.hand.fault == HPAC_FAULT_WATCHDOG && w.hand.attached == 0u && w.oracle.attached == 0u);
    CHECK(w.oracle.guard.broken[0] == '\0');
}

void test_oracle(void)
{
    a_relax_at_rest_raises_no_alarm(0);
    a_relax_at_rest_raises_no_alarm(1);
    for (uint32_t ms = 100; ms < 1300u; ms += 83u) {
        for (int offset_us = -3; offset_us <= 3; offset_us++) {
            frames_about_a_start_raise_no_alarm(ms, offset_us);
        }
    }
    a_start_at_the_wrong_time_is_noticed(432, 0);
    a_start_at_the_wrong_time_is_noticed(432, 300);
    a_start_at_the_wrong_time_is_noticed(432, -300);
}
