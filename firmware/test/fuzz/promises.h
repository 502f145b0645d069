/* A hand and its oracle for the fuzzers: every call is judged, abort() tells the fuzzer. */
#ifndef PROMISES_H
#define PROMISES_H

#include <stdio.h>
#include <stdlib.h>

#include "hpac_hand.h"
#include "oracle.h"

#define SESSION 0x12345678u /* of the test vectors, which are the seeds */

typedef struct {
    hpac_hand_t hand;
    hpac_config_t config;
    oracle_t oracle;
    uint64_t now_us;
    uint16_t seq;
} judged_t;

static inline void judge(judged_t *judged, const uint8_t *bytes, size_t length, const uint32_t *pulses)
{
    uint8_t answers[HPAC_TX_CAPACITY];
    size_t answered = hpac_hand_transmit(&judged->hand, answers, sizeof answers);
    if (!oracle_judge(&judged->oracle, judged->now_us, bytes, length, answers, answered, pulses)) {
        fprintf(stderr, "%s\n", judged->oracle.guard.broken);
        abort();
    }
}

static inline void feed(judged_t *judged, const uint8_t *bytes, size_t length)
{
    hpac_hand_receive(&judged->hand, &judged->config, judged->now_us, bytes, length);
    judge(judged, bytes, length, NULL);
}

static inline void pass(judged_t *judged, uint32_t us)
{
    uint32_t pulses[HPAC_SERVOS];
    judged->now_us += us;
    hpac_hand_tick(&judged->hand, &judged->config, judged->now_us, pulses);
    judge(judged, NULL, 0, pulses);
}

static inline void say(judged_t *judged, uint8_t type, uint8_t flags, const uint8_t *payload, size_t length)
{
    uint8_t wire[128];
    feed(judged, wire, oracle_encode(wire, HPAC_VERSION, type, ++judged->seq, flags, payload, length));
}

static inline void start(judged_t *judged)
{
    oracle_servo_t table[ORACLE_SERVOS];
    oracle_table(table, 2.0);
    *judged = (judged_t){ .now_us = 1000000 };
    hpac_config_default(&judged->config);
    hpac_hand_init(&judged->hand, &judged->config, HPAC_RESET_POWER_ON, 1, NULL);
    oracle_start(&judged->oracle, table, HPAC_RESET_POWER_ON, 1);
    pass(judged, 0);
}

/* Greeted, armed with the longest watchdog, at rest. */
static inline void start_armed(judged_t *judged)
{
    uint8_t arm[HPAC_ARM_LENGTH] = { 0 };
    start(judged);
    hpac_put_u32(arm, SESSION);
    say(judged, HPAC_HELLO, 0, arm, HPAC_HELLO_LENGTH);
    hpac_put_u32(arm + HPAC_ARM_AT_LIMITS_HASH, oracle_hash(judged->oracle.guard.table));
    hpac_put_u16(arm + HPAC_ARM_AT_WATCHDOG_MS, HPAC_WATCHDOG_MAX_MS);
    say(judged, HPAC_ARM, 0, arm, sizeof arm);
    for (int ms = 0; ms < HPAC_START_MAX_MS; ms += 20) {
        if (ms % 500 == 0) {
            say(judged, HPAC_HEARTBEAT, 0, arm, HPAC_HEARTBEAT_LENGTH);
        }
        pass(judged, 20000);
    }
}

#endif
