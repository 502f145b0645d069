/* The state machine: who may do what when, watchdog, e-stop, safe actions, latches. */
#include <string.h>

#include "bench.h"
#include "check.h"
#include "hpac_load.h"
#include "hpac_motion.h"
#include "tests.h"

static const int16_t half[HPAC_SERVOS] = { 6000, 6000, 6000, 6000, 6000, 6000 };

static void nothing_moves_before_the_handshake(void)
{
    bench_t bench;
    bench_start(&bench);
    CHECK(bench.hand.state == HPAC_STATE_BOOT);
    CHECK(bench_arm(&bench, HPAC_ACTION_HOLD, 0) == HPAC_REASON_SESSION);
    CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_SESSION);
    CHECK(bench_send(&bench, HPAC_CLEAR, 0, NULL, 0) == HPAC_REASON_SESSION);
    bench_run(&bench, 2000);
    CHECK(bench_silent(&bench));
    CHECK(bench_send(&bench, HPAC_HELLO, 0, NULL, 0) == -1);
    CHECK(bench.answer_types[HPAC_DEVICE_HELLO] == 1u);
    CHECK(bench.hand.state == HPAC_STATE_IDLE && bench_silent(&bench));
    CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_STATE);
}

static void arming_is_checked_and_staggered(void)
{
    bench_t bench;
    bench_start(&bench);
    hpac_hand_init(&bench.hand, &bench.config, HPAC_RESET_POWER_ON, 1, NULL);
    bench_send(&bench, HPAC_HELLO, 0, NULL, 0);
    CHECK(bench_arm(&bench, HPAC_ACTION_HOLD, 1) == HPAC_REASON_LIMITS);
    CHECK(bench_arm(&bench, HPAC_ACTION_DETACH + 1u, 0) == HPAC_REASON_ACTION);
    CHECK(bench.hand.state == HPAC_STATE_IDLE);
    CHECK(bench_arm(&bench, HPAC_ACTION_HOLD, 0) == HPAC_REASON_OK);
    CHECK(hpac_hand_powered(&bench.hand) && bench_silent(&bench)); /* the supply comes before the first pulse */
    for (int i = 0; i < HPAC_SERVOS; i++) { /* after power-on each may have its whole range to go */
        uint32_t ms = HPAC_START_SETTLE_MS + ((uint32_t)bench.config.servo[i].max_urad + 4999u) / (HPAC_START_SPEED_URAD_S / 1000);
        bench_run(&bench, i == 0 ? HPAC_POWER_ON_MS : 1);
        CHECK(bench.hand.attached == (1u << (i + 1)) - 1u);
        CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_STARTING);
        bench_send(&bench, HPAC_HEARTBEAT, 0, NULL, 0);
        bench_run(&bench, ms - 1u);
        CHECK(bench.hand.attached == (1u << (i + 1)) - 1u && bench.hand.starting);
    }
    bench_run(&bench, 2);
    CHECK(bench_all_pulses(&bench) && !bench.hand.starting);
    CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_OK);
}

static void hold_unpowered(bench_t *bench)
{
    for (int i = 0; i < HPAC_SERVOS; i++) {
        bench->config.servo[i].holds_unpowered = 1;
    }
}

/* Where servos hold by themselves, nobody knows better where they are than the last command: no step at the first pulses,
 * then slowly to rest. */
static void arming_takes_up_the_last_pose_of_servos_that_hold_and_goes_to_rest_slowly(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    hold_unpowered(&bench);
    CHECK(bench_move(&bench, 0, 300, half) == HPAC_REASON_OK);
    bench_run(&bench, 200);
    uint32_t last[HPAC_SERVOS];
    memcpy(last, bench.pulses, sizeof last);
    bench_send(&bench, HPAC_CLEAR, 0, NULL, 0);
    CHECK(bench_silent(&bench));
    bench_run(&bench, 300);
    CHECK(bench_arm(&bench, HPAC_ACTION_HOLD, 0) == HPAC_REASON_OK);
    for (uint32_t ms = 0; ms < HPAC_START_MAX_MS && bench.hand.starting; ms++) {
        uint32_t before[HPAC_SERVOS];
        memcpy(before, bench.pulses, sizeof before);
        uint8_t attached = bench.hand.attached;
        bench_run(&bench, 1);
        for (int i = 0; i < HPAC_SERVOS; i++) {
            bool first = before[i] == 0u && bench.pulses[i] != 0u;
            CHECK(!first || bench.pulses[i] == last[i]);
            /* a quarter of 4 rad/s is 637 ns a ms */
            CHECK(bench.pulses[i] == 0u || first || (before[i] - bench.pulses[i] <= 638u && bench.pulses[i] <= before[i]));
            CHECK(bench_all_pulses(&bench) || bench.pulses[i] == 0u || bench.pulses[i] == last[i]);
        }
        CHECK(bench.hand.attached == attached || bench.hand.attached == 2u * attached + 1u); /* one at a time */
        if (ms % 100u == 0u) {
            CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_STARTING);
            bench_send(&bench, HPAC_HEARTBEAT, 0, NULL, 0);
        }
    }
    CHECK(bench.hand.state == HPAC_STATE_ARMED && !bench.hand.starting);
    CHECK(bench.pulses[0] == hpac_servo_pulse(&bench.config.servo[0], 0));
}

/* The springs open a hand without pulses: after a stop it may hold somebody's finger, and must not close on it again. */
static void a_closed_hand_that_was_stopped_does_not_close_again(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    CHECK(bench_move(&bench, 0, 300, half) == HPAC_REASON_OK);
    bench_run(&bench, 300);
    bench_send(&bench, HPAC_ESTOP, 0, NULL, 0);
    CHECK(bench_silent(&bench));
    bench_run(&bench, 60000);
    bench_send(&bench, HPAC_CLEAR, 0, NULL, 0);
    uint64_t armed_us = bench.now_us;
    CHECK(bench_arm(&bench, HPAC_ACTION_HOLD, 0) == HPAC_REASON_OK);
    for (uint32_t ms = 0; ms < HPAC_START_MAX_MS && bench.hand.starting; ms++) {
        bench_run(&bench, 1);
        for (int i = 0; i < HPAC_SERVOS; i++) {
            CHECK(bench.pulses[i] == 0u || bench.pulses[i] == hpac_servo_pulse(&bench.config.servo[i], 0));
        }
        if (ms % 100u == 0u) {
            bench_send(&bench, HPAC_HEARTBEAT, 0, NULL, 0);
        }
    }
    CHECK(bench.hand.state == HPAC_STATE_ARMED && !bench.hand.starting);
    /* each servo gets the time for its way from where it was commanded to: it may not have opened after all */
    CHECK(bench.now_us - armed_us >= 6u * (60000u + 100u * (uint32_t)half[0] / 5u));
}

/* One servo away from rest is enough: arming waits until it is there, too. */
static void arming_brings_each_servo_to_rest(void)
{
    for (int i = 0; i < HPAC_SERVOS; i++) {
        hpac_memory_t memory = { .placed = HPAC_ALL_SERVOS };
        bench_t bench;
        memory.pose[i] = 500000;
        bench_start(&bench);
        hold_unpowered(&bench);
        hpac_hand_init(&bench.hand, &bench.config, HPAC_RESET_SOFTWARE, 2, &memory);
        bench_run(&bench, 1);
        CHECK(bench_send(&bench, HPAC_HELLO, 0, NULL, 0) == -1);
        CHECK(bench_arm(&bench, HPAC_ACTION_RELAX, 0) == HPAC_REASON_OK);
        for (int j = 0; j < 300 && bench.hand.starting; j++) {
            bench_run(&bench, 10);
            bench_send(&bench, HPAC_HEARTBEAT, 0, NULL, 0);
        }
        CHECK(!bench.hand.starting && hpac_motion_angle(&bench.hand, (unsigned)i) == 0);
    }
}

static void the_first_pulse_comes_no_microsecond_early(void)
{
    bench_t bench;
    bench_idle(&bench);
    CHECK(bench_arm(&bench, HPAC_ACTION_RELAX, 0) == HPAC_REASON_OK);
    bench.now_us += 20000;
    bench_feed(&bench, NULL, 0);
    bench.now_us += 20000;
    bench_feed(&bench, NULL, 0);
    bench.now_us += 9999;
    bench_feed(&bench, NULL, 0);
    CHECK(bench_silent(&bench));
    bench.now_us += 1;
    bench_feed(&bench, NULL, 0);
    CHECK(bench.pulses[0] != 0u);
}

/* The time that a servo is given to its first pulse follows from its way to the microsecond. */
static void the_time_to_a_first_pulse_is_exact(void)
{
    bench_t bench;
    bench_start(&bench);
    bench.hand.placed = 0x1f;
    CHECK(hpac_motion_start_us(&bench.hand, 5) == 60000u + 314000u); /* 1.57 rad at 5 rad/s */
    CHECK(hpac_motion_start_us(&bench.hand, 4) == 60000u);
    bench.hand.ramp.to[4] = 1000000;
    CHECK(hpac_motion_start_us(&bench.hand, 4) == 60000u + 200000u);
}

static void silence_trips_the_watchdog_and_latches(hpac_action_t action)
{
    bench_t bench;
    bench_armed(&bench, action);
    CHECK(bench_move(&bench, 0, 200, half) == HPAC_REASON_OK);
    bench_run(&bench, BENCH_WATCHDOG_MS - 1);
    CHECK(bench.hand.state == HPAC_STATE_ARMED);
    uint32_t before = bench.pulses[2];
    bench_run(&bench, 1);
    CHECK(bench.hand.state == HPAC_STATE_FAULT && bench.hand.fault == HPAC_FAULT_WATCHDOG);
    CHECK(bench.hand.count.watchdog_trips == 1u);
    CHECK(bench_silent(&bench) == (action == HPAC_ACTION_DETACH));
    CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_STATE);
    CHECK(bench_send(&bench, HPAC_HEARTBEAT, 0, NULL, 0) == HPAC_REASON_OK);
    CHECK(bench_arm(&bench, HPAC_ACTION_HOLD, 0) == HPAC_REASON_STATE);
    CHECK(bench.hand.state == HPAC_STATE_FAULT);
    bench_run(&bench, 50);
    CHECK(action != HPAC_ACTION_HOLD || bench.pulses[2] == before);
    CHECK(action != HPAC_ACTION_RELAX || bench.pulses[2] < before);
    bench_run(&bench, 2000);
    CHECK(bench_silent(&bench) == (action != HPAC_ACTION_HOLD));
    CHECK(bench_send(&bench, HPAC_HELLO, 0, NULL, 0) == -1);
    CHECK(bench.hand.state == HPAC_STATE_FAULT); /* only CLEAR leaves it */
    CHECK(bench_send(&bench, HPAC_CLEAR, 0, NULL, 0) == HPAC_REASON_OK);
    CHECK(bench.hand.state == HPAC_STATE_IDLE && bench_silent(&bench));
}

static void refused_frames_do_not_feed_the_watchdog(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_DETACH);
    for (int i = 0; i < 20; i++) {
        bench_run(&bench, BENCH_WATCHDOG_MS / 10);
        bench_move(&bench, 0, 1, half);
    }
    CHECK(bench.hand.state == HPAC_STATE_FAULT && bench.hand.fault == HPAC_FAULT_WATCHDOG);
}

static void heartbeats_feed_the_watchdog(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_DETACH);
    for (int i = 0; i < 20; i++) {
        CHECK(bench_send(&bench, HPAC_HEARTBEAT, HPAC_FLAG_NO_ACK, NULL, 0) == -1);
        bench_run(&bench, BENCH_WATCHDOG_MS - 1);
    }
    CHECK(bench.hand.state == HPAC_STATE_ARMED);
}

static void another_session_is_refused_and_feeds_nothing(void)
{
    bench_t bench;
    uint8_t period[HPAC_STATUS_LENGTH] = { 0 };
    bench_armed(&bench, HPAC_ACTION_DETACH);
    uint32_t ours = bench.session;
    for (uint32_t ms = 0; ms < BENCH_WATCHDOG_MS - 10u; ms += 10u) {
        bench.session = ms % 20u == 0u ? ours ^ 1u : 0u;
        CHECK(bench_send(&bench, HPAC_HEARTBEAT, 0, NULL, 0) == HPAC_REASON_SESSION);
        CHECK(bench_arm(&bench, HPAC_ACTION_HOLD, 0) == HPAC_REASON_SESSION);
        CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_SESSION);
        CHECK(bench_send(&bench, HPAC_CLEAR, 0, NULL, 0) == HPAC_REASON_SESSION);
        CHECK(bench_send(&bench, HPAC_STATUS, 0, period, sizeof period) == -1); /* answered, from anybody */
        bench.session = 0;
        CHECK(bench_send(&bench, HPAC_HELLO, 0, NULL, 0) == -1); /* only looks */
        CHECK(bench.answer_types[HPAC_DEVICE_HELLO] == 1u && bench.hand.state == HPAC_STATE_ARMED);
        bench_run(&bench, 10);
    }
    bench_run(&bench, 10);
    CHECK(bench.hand.fault == HPAC_FAULT_WATCHDOG && bench_silent(&bench));
}

static void a_new_session_takes_over_and_disarms(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    uint32_t ours = bench.session;
    bench_move(&bench, 0, 1000, half);
    bench_run(&bench, 100);
    bench.session = ours + 1u;
    bench_send(&bench, HPAC_HELLO, 0, NULL, 0);
    CHECK(bench.hand.state == HPAC_STATE_IDLE && bench_silent(&bench));
    bench.session = ours;
    CHECK(bench_send(&bench, HPAC_HEARTBEAT, 0, NULL, 0) == HPAC_REASON_SESSION);
}

static void the_watchdog_is_what_arm_chose(void)
{
    static const uint16_t periods[] = { HPAC_WATCHDOG_MIN_MS - 1, HPAC_WATCHDOG_MIN_MS, 377, HPAC_WATCHDOG_MAX_MS, HPAC_WATCHDOG_MAX_MS + 1 };
    for (int i = 0; i < 5; i++) {
        bench_t bench;
        uint8_t arm[HPAC_ARM_LENGTH] = { 0 };
        bool allowed = i > 0 && i < 4;
        bench_armed(&bench, HPAC_ACTION_DETACH);
        hpac_put_u32(arm + HPAC_ARM_AT_LIMITS_HASH, hpac_servo_hash(bench.config.servo));
        hpac_put_u16(arm + HPAC_ARM_AT_WATCHDOG_MS, periods[i]);
        arm[HPAC_ARM_AT_ACTION] = HPAC_ACTION_DETACH;
        CHECK(bench_send(&bench, HPAC_ARM, 0, arm, sizeof arm) == (allowed ? HPAC_REASON_OK : HPAC_REASON_PERIOD));
        bench_run(&bench, allowed ? periods[i] - 1u : 1u);
        CHECK(bench.hand.state == HPAC_STATE_ARMED);
        bench_run(&bench, allowed ? 1u : 0u);
        CHECK(bench.hand.state == (allowed ? HPAC_STATE_FAULT : HPAC_STATE_ARMED));
    }
}

/* Any flags, any payload, any version, no session; and another version is told who is there, and refused. */
static void anybody_may_stop_the_hand_and_other_versions_do_nothing_else(void)
{
    static const uint8_t payload[40] = { 1, 2, 3 };
    for (unsigned version = 0; version < 256u; version++) {
        for (uint8_t type = HPAC_HELLO; type <= HPAC_STATUS; type++) {
            bench_t bench;
            uint8_t wire[128];
            bool stops = type == HPAC_ESTOP;
            bench_armed(&bench, HPAC_ACTION_HOLD);
            bench.acks = 0;
            if (version == HPAC_VERSION && !stops) {
                continue;
            }
            bench_feed(&bench, wire, bench_frame(wire, (uint8_t)version, type, 9, (uint8_t)version, payload, version % 41u));
            CHECK(bench.hand.state == (stops ? HPAC_STATE_FAULT : HPAC_STATE_ARMED));
            CHECK(bench_silent(&bench) == stops);
            CHECK(bench.acks == (type == HPAC_HELLO ? 0 : 1));
            CHECK(type == HPAC_HELLO || bench.reason == (stops ? HPAC_REASON_OK : HPAC_REASON_VERSION));
        }
    }
}

static void estop_stops_pulses_in_every_state(void)
{
    bench_t bench;
    bench_start(&bench);
    CHECK(bench_send(&bench, HPAC_ESTOP, 0, NULL, 0) == HPAC_REASON_OK);
    CHECK(bench.hand.state == HPAC_STATE_FAULT);
    bench_armed(&bench, HPAC_ACTION_HOLD);
    bench_move(&bench, 0, 1000, half);
    bench_run(&bench, 100);
    CHECK(bench_send(&bench, HPAC_ESTOP, 0xffu, NULL, 0) == HPAC_REASON_OK); /* flags do not matter */
    CHECK(bench.hand.fault == HPAC_FAULT_ESTOP && bench_silent(&bench));
    CHECK(bench.answer_types[HPAC_FAULT] == 1u);
    bench_armed(&bench, HPAC_ACTION_HOLD);
    bench_run(&bench, BENCH_WATCHDOG_MS);
    CHECK(bench.hand.fault == HPAC_FAULT_WATCHDOG && bench_all_pulses(&bench));
    bench_send(&bench, HPAC_ESTOP, 0, NULL, 0); /* also out of a fault that holds */
    CHECK(bench.hand.fault == HPAC_FAULT_ESTOP && bench_silent(&bench));
}

static void clear_and_hello_stop_a_motion(void)
{
    for (int kind = 0; kind < 2; kind++) {
        bench_t bench;
        bench_armed(&bench, HPAC_ACTION_HOLD);
        bench_move(&bench, 0, 1000, half);
        bench_run(&bench, 100);
        bench_send(&bench, kind == 0 ? HPAC_CLEAR : HPAC_HELLO, 0, NULL, 0);
        CHECK(bench.hand.state == HPAC_STATE_IDLE && bench_silent(&bench));
        CHECK(!hpac_ramp_moving(&bench.hand.ramp));
        bench_run(&bench, 1000);
        CHECK(bench_silent(&bench));
    }
}

static void a_suspicious_reset_stays_disarmed(void)
{
    static const hpac_reset_t resets[] = { HPAC_RESET_BROWNOUT, HPAC_RESET_CRASH };
    static const hpac_fault_t faults[] = { HPAC_FAULT_BROWNOUT, HPAC_FAULT_CRASH };
    for (int i = 0; i < 2; i++) {
        bench_t bench;
        bench_start(&bench);
        hpac_hand_init(&bench.hand, &bench.config, resets[i], 2, NULL);
        bench_send(&bench, HPAC_HELLO, 0, NULL, 0);
        CHECK(bench.hand.state == HPAC_STATE_FAULT && bench.hand.fault == faults[i]);
        CHECK(bench_send(&bench, HPAC_CLEAR, 0, NULL, 0) == HPAC_REASON_OK);
        CHECK(bench.hand.state == HPAC_STATE_IDLE);
    }
}

static void status_comes_at_the_set_rate(void)
{
    bench_t bench;
    uint8_t period[HPAC_STATUS_LENGTH];
    bench_idle(&bench);
    hpac_put_u16(period, HPAC_STATUS_MIN_MS - 1);
    CHECK(bench_send(&bench, HPAC_STATUS, 0, period, sizeof period) == HPAC_REASON_PERIOD);
    hpac_put_u16(period, 50);
    CHECK(bench_send(&bench, HPAC_STATUS, 0, period, sizeof period) == -1);
    bench_run(&bench, 1000);
    CHECK(bench.answer_types[HPAC_DEVICE_STATUS] == 1u + 20u);
    hpac_put_u16(period, 0);
    bench_send(&bench, HPAC_STATUS, 0, period, sizeof period);
    bench_run(&bench, 1000);
    CHECK(bench.answer_types[HPAC_DEVICE_STATUS] == 1u);
}

static void time_never_goes_back(void)
{
    bench_t bench;
    uint32_t pulses[HPAC_SERVOS];
    bench_armed(&bench, HPAC_ACTION_HOLD);
    bench_move(&bench, 0, 1000, half);
    bench_run(&bench, 300);
    hpac_hand_tick(&bench.hand, &bench.config, bench.now_us - 1000u * HPAC_CLOCK_BACK_MAX_MS, pulses);
    CHECK(pulses[0] == bench.pulses[0]);
    CHECK(bench.hand.state == HPAC_STATE_ARMED);
    bench.fault_servo = 0;
    bench.now_us -= 1000u * HPAC_CLOCK_BACK_MAX_MS + 1u;
    bench_run(&bench, 0);
    bench_feed(&bench, NULL, 0);
    CHECK(bench_silent(&bench) && bench.hand.fault == HPAC_FAULT_INTERNAL && bench.fault_servo == HPAC_NO_SERVO);
}

/* Whatever the reason: an angle outside of the limits never becomes a pulse. */
static void a_wrong_angle_inside_latches_a_fault(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    bench.hand.ramp.to[4] = bench.config.servo[4].max_urad + 17;
    bench_run(&bench, 1);
    CHECK(bench.hand.fault == HPAC_FAULT_INTERNAL && bench_silent(&bench));
}

/* Heat and pose outlive a reset; whatever stands in that memory, no angle leaves the table and no heat stays for ever. */
static void memory_is_taken_up_within_bounds(void)
{
    bench_t bench;
    hpac_memory_t memory;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    bench_move(&bench, 0, 300, half);
    bench_run(&bench, 300);
    for (unsigned i = 0; i < HPAC_SERVOS; i++) { /* each its own */
        hpac_memory_t own;
        bench_t other = bench;
        other.hand.heat[i] = 2u * HPAC_HEAT_LIMIT;
        other.hand.pose[i] = 7;
        other.hand.placed = (uint8_t)(1u << i);
        hpac_hand_remember(&other.hand, &own);
        for (unsigned k = 0; k < HPAC_SERVOS; k++) {
            CHECK((own.heat[k] == 2u * HPAC_HEAT_LIMIT) == (k == i) && (own.pose[k] == 7) == (k == i));
        }
        own.heat[i]++;
        hpac_hand_init(&other.hand, &bench.config, HPAC_RESET_BROWNOUT, 2, &own);
        CHECK(other.hand.placed == 1u << i); /* the others had no pulse yet when the supply broke down */
        for (unsigned k = 0; k < HPAC_SERVOS; k++) {
            CHECK(other.hand.heat[k] == (k == i ? 2u * HPAC_HEAT_LIMIT : own.heat[k]));
        }
    }
    hpac_hand_remember(&bench.hand, &memory);
    hpac_hand_init(&bench.hand, &bench.config, HPAC_RESET_SOFTWARE, 2, &memory);
    for (int i = 0; i < HPAC_SERVOS; i++) {
        CHECK(memory.heat[i] > 0u && bench.hand.heat[i] == memory.heat[i]);
        CHECK(hpac_motion_angle(&bench.hand, (unsigned)i) == half[i] * 100);
        memory.heat[i] = i < 3 ? UINT32_MAX : 2u * HPAC_HEAT_LIMIT + HPAC_HEAT_LIMIT / 2u;
        memory.pose[i] = i % 2 == 0 ? INT32_MAX : INT32_MIN;
    }
    memory.placed = ~0u;
    hpac_hand_init(&bench.hand, &bench.config, HPAC_RESET_SOFTWARE, 3, &memory);
    CHECK(bench.hand.placed == HPAC_ALL_SERVOS);
    bench.now_us = 0;
    bench_run(&bench, 1);
    CHECK(bench.hand.state == HPAC_STATE_BOOT && bench_silent(&bench));
    for (int i = 0; i < HPAC_SERVOS; i++) {
        const hpac_servo_t *limits = &bench.config.servo[i];
        CHECK(hpac_motion_angle(&bench.hand, (unsigned)i) == (i % 2 == 0 ? limits->max_urad : limits->min_urad));
        CHECK(bench.hand.heat[i] <= 2u * HPAC_HEAT_LIMIT && bench.hand.heat[i] > 2u * HPAC_HEAT_LIMIT - HPAC_HEAT_LIMIT / 100u);
    }
}

static void the_estop_input_holds_off_clear(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    CHECK(hpac_hand_powered(&bench.hand));
    hpac_hand_inputs(&bench.hand, true, 0);
    memset(bench.answer_types, 0, sizeof bench.answer_types);
    bench_run(&bench, 100);
    CHECK(bench.hand.fault == HPAC_FAULT_ESTOP && bench_silent(&bench) && !hpac_hand_powered(&bench.hand));
    CHECK(bench.answer_types[HPAC_FAULT] == 1u); /* told once, however long it is pressed */
    CHECK(bench_send(&bench, HPAC_CLEAR, 0, NULL, 0) == HPAC_REASON_ESTOP);
    CHECK(bench_arm(&bench, HPAC_ACTION_HOLD, 0) == HPAC_REASON_STATE);
    hpac_hand_inputs(&bench.hand, false, 0);
    bench_run(&bench, 1);
    CHECK(bench.hand.fault == HPAC_FAULT_ESTOP); /* latched */
    CHECK(bench_send(&bench, HPAC_CLEAR, 0, NULL, 0) == HPAC_REASON_OK);
    CHECK(bench_arm(&bench, HPAC_ACTION_HOLD, 0) == HPAC_REASON_OK);
}

/* A config fault stays one, and is not told again at every call while the button is pressed. */
static void a_pressed_button_repeats_no_config_fault(void)
{
    bench_t bench;
    bench_start(&bench);
    bench.config.servo[2].rate_urad_s = 0;
    hpac_hand_init(&bench.hand, &bench.config, HPAC_RESET_POWER_ON, 1, NULL);
    bench_run(&bench, 10);
    memset(bench.answer_types, 0, sizeof bench.answer_types);
    hpac_hand_inputs(&bench.hand, true, 0);
    bench_run(&bench, 1000);
    CHECK(bench.hand.fault == HPAC_FAULT_CONFIG && bench_silent(&bench));
    CHECK(bench.answer_types[HPAC_FAULT] == 0u);
}

/* What cannot be computed with is found before it is computed with, even where it does not show yet. */
static void an_unsound_motion_is_a_fault(void)
{
    enum { DURATION_MAX_US = (HPAC_MOVE_MAX_MS + HPAC_WATCHDOG_MAX_MS) * 1000, SPEED_MAX = 4000000 + 1000000 };
    for (int beyond = 0; beyond < 2; beyond++) {
        for (int which = 0; which < 14; which++) {
            bench_t bench;
            bench_armed(&bench, HPAC_ACTION_HOLD);
            hpac_ramp_t *ramp = &bench.hand.ramp;
            int servo = which < 7 ? 0 : 5;
            int kind = which % 7;
            int32_t most = bench.config.servo[servo].max_urad;
            int32_t *fields[] = { &ramp->from[servo], &ramp->from[servo], &ramp->from_speed[servo], &ramp->from_speed[servo] };
            const int32_t values[] = { most + beyond, -beyond, SPEED_MAX + beyond, -SPEED_MAX - beyond };
            if (kind < 4) {
                *fields[kind] = values[kind];
            } else if (kind == 4) {
                ramp->minimum_jerk = true;
                ramp->duration_us = ramp->elapsed_us = DURATION_MAX_US + (uint32_t)beyond;
            } else if (kind == 5) { /* linear ones too */
                ramp->duration_us = ramp->elapsed_us = DURATION_MAX_US + (uint32_t)beyond;
            } else {
                bench.hand.fault = beyond != 0 ? HPAC_FAULT_OVERLOAD : HPAC_FAULT_NONE;
            }
            bench_run(&bench, 1);
            CHECK((bench.hand.fault == HPAC_FAULT_INTERNAL) == (beyond != 0));
            CHECK(beyond == 0 || bench.fault_servo == HPAC_NO_SERVO);
            CHECK(bench_silent(&bench) == (beyond != 0));
        }
    }
}

/* A target outside of the table is found before the way to it leads there. */
static void a_wrong_target_is_found_at_once(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_OK);
    bench_run(&bench, 1);
    bench.hand.ramp.to[2] = bench.config.servo[2].max_urad + 1;
    bench_run(&bench, 1);
    CHECK(bench.hand.fault == HPAC_FAULT_INTERNAL && bench_silent(&bench));
}

/* Rounding at a limit is cut off; a motion that leaves the table by more is a fault, not a limit to stand at. */
static void an_overshoot_inside_is_a_fault(void)
{
    for (int low = 0; low < 2; low++) {
        static const int16_t near_the_ends[2][HPAC_SERVOS] = { { 13400, 500, 500, 500, 500, 500 }, { 100, 500, 500, 500, 500, 500 } };
        bench_t bench;
        bench_armed(&bench, HPAC_ACTION_HOLD);
        CHECK(bench_move(&bench, 0, 500, near_the_ends[low]) == HPAC_REASON_OK);
        bench_run(&bench, 480);
        bench_send(&bench, HPAC_HEARTBEAT, 0, NULL, 0);
        bench_run(&bench, 100);
        CHECK(bench_move(&bench, HPAC_FLAG_MINIMUM_JERK, 400, near_the_ends[low]) == HPAC_REASON_OK);
        bench.hand.ramp.from_speed[0] = low != 0 ? -3900000 : 3900000;
        bench_run(&bench, 100);
        CHECK(bench.hand.fault == HPAC_FAULT_INTERNAL && bench_silent(&bench));
    }
}

/* A state that denies itself is a fault at the next call. */
static void a_fault_without_its_state_is_a_fault(void)
{
    bench_t bench;
    bench_idle(&bench);
    bench.hand.fault = HPAC_FAULT_WATCHDOG;
    bench_run(&bench, 1);
    CHECK(bench.hand.state == HPAC_STATE_FAULT && bench.hand.fault == HPAC_FAULT_INTERNAL);
    bench_idle(&bench);
    bench.hand.state = HPAC_STATE_FAULT;
    bench_run(&bench, 1);
    CHECK(bench.hand.fault == HPAC_FAULT_INTERNAL);
    bench_idle(&bench);
    bench.hand.starting = true; /* outside of ARMED nothing starts */
    bench_run(&bench, 1);
    CHECK(bench_silent(&bench) && bench.hand.attached == 0u);
}

static void a_jump_inside_the_table_is_a_fault_of_its_servo(void)
{
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        bench_t bench;
        bench_armed(&bench, HPAC_ACTION_HOLD);
        bench.hand.ramp.to[i] += 50000;
        bench_run(&bench, 1);
        CHECK(bench.hand.fault == HPAC_FAULT_INTERNAL && bench_silent(&bench));
        bench_feed(&bench, NULL, 0);
        CHECK(bench.fault_servo == i);
    }
}

static void an_output_that_fails_is_a_fault(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    hpac_hand_output_failed(&bench.hand);
    bench_run(&bench, 1);
    CHECK(bench.fault_servo == HPAC_NO_SERVO);
    CHECK(bench.hand.fault == HPAC_FAULT_INTERNAL && bench_silent(&bench) && !hpac_hand_powered(&bench.hand));
}

static void hold_ends_in_a_relax(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    bench_move(&bench, 0, 300, half);
    bench_run(&bench, BENCH_WATCHDOG_MS);
    uint32_t held = bench.pulses[3];
    bench_run(&bench, HPAC_HOLD_MAX_MS - 2);
    bench_run(&bench, 1);
    CHECK(bench.pulses[3] == held && !bench.hand.relaxing);
    bench_run(&bench, 1);
    CHECK(bench.hand.relaxing);
    bench_run(&bench, 100);
    CHECK(bench.pulses[3] < held && bench.hand.relaxing);
    bench_run(&bench, 1000);
    CHECK(bench_silent(&bench) && !hpac_hand_powered(&bench.hand) && bench.hand.fault == HPAC_FAULT_WATCHDOG);
}

/* The grip is off after seconds of the clock, not after steps of at most 20 ms: on a board that calls every 100 ms too. */
static void safe_actions_end_in_seconds_however_rarely_the_board_calls(void)
{
    static const int16_t far_end[HPAC_SERVOS] = { 13000, 13500, 13000, 13100, 13000, 15000 };
    for (int hold = 0; hold < 2; hold++) {
        bench_t bench;
        bench_armed(&bench, hold != 0 ? HPAC_ACTION_HOLD : HPAC_ACTION_RELAX);
        bench_move(&bench, 0, 400, far_end);
        bench_run(&bench, BENCH_WATCHDOG_MS);
        uint64_t fault_us = bench.now_us;
        CHECK(bench.hand.fault == HPAC_FAULT_WATCHDOG && !bench_silent(&bench));
        while (!bench_silent(&bench) && bench.now_us < fault_us + 60000000u) {
            bench.now_us += 100000u;
            bench_feed(&bench, NULL, 0);
        }
        uint32_t most_us = hpac_motion_relax_max_us(&bench.hand) + (hold != 0 ? 1000u * HPAC_HOLD_MAX_MS : 0u);
        CHECK(bench.now_us - fault_us <= most_us + 200000u); /* a late call is late by up to itself */
    }
}

/* A relax that an overload begins anew, on such a board, has no more time for it. */
static void an_overload_does_not_make_a_relax_longer(void)
{
    static const int16_t far_end[HPAC_SERVOS] = { 13000, 13500, 13000, 13100, 13000, 15000 };
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_RELAX);
    bench_move(&bench, 0, 400, far_end);
    bench_run(&bench, BENCH_WATCHDOG_MS);
    uint64_t until_us = bench.now_us + hpac_motion_relax_max_us(&bench.hand);
    while (!bench_silent(&bench) && bench.now_us < until_us + 60000000u) {
        bench.now_us += 100000u;
        bench.hand.heat[0] = bench.now_us > until_us - 400000u ? 2u * HPAC_HEAT_LIMIT : bench.hand.heat[0];
        bench_feed(&bench, NULL, 0);
    }
    CHECK(bench.hand.fault == HPAC_FAULT_OVERLOAD && bench.now_us <= until_us + 100000u);
}

/* The longest way of the slowest servo, down or up, at a quarter of its rate. */
static void a_relax_lasts_as_long_as_its_longest_way(void)
{
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        for (int up = 0; up < 2; up++) {
            bench_t bench;
            bench_start(&bench);
            hpac_servo_t *servo = &bench.config.servo[i];
            servo->rate_urad_s = 100000;
            servo->rest_urad = up != 0 ? 900000 : 100000;
            int64_t way = up != 0 ? servo->rest_urad - servo->min_urad : servo->max_urad - servo->rest_urad;
            CHECK(hpac_motion_relax_max_us(&bench.hand) == (uint32_t)(way * 1000000 * 1000 / (100000 * HPAC_RELAX_PERMILLE)));
        }
    }
}

/* Once a safe action is over, a flipped bit does not bring it back. */
static void a_safe_action_that_is_over_stays_over(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    bench_run(&bench, BENCH_WATCHDOG_MS + 100);
    CHECK(bench.hand.holding && bench_all_pulses(&bench));
    bench_send(&bench, HPAC_ESTOP, 0, NULL, 0);
    bench.hand.attached = 1;
    bench_run(&bench, 1);
    CHECK(bench_silent(&bench) && bench.hand.fault == HPAC_FAULT_INTERNAL);
    bench_armed(&bench, HPAC_ACTION_HOLD);
    bench_move(&bench, 0, 300, half);
    bench_run(&bench, BENCH_WATCHDOG_MS + HPAC_HOLD_MAX_MS + 100);
    CHECK(bench.hand.relaxing && bench_all_pulses(&bench));
    bench.hand.relaxing = false;
    bench_run(&bench, 1);
    CHECK(bench_silent(&bench) && bench.hand.fault == HPAC_FAULT_INTERNAL);
}

/* Should a bit flip, a safe action outside of a fault ends no pulses. */
static void safe_actions_belong_to_faults(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    bench.hand.relaxing = true;
    bench_run(&bench, 2);
    CHECK(bench.hand.state == HPAC_STATE_ARMED && bench_all_pulses(&bench));
}

void test_states(void)
{
    safe_actions_end_in_seconds_however_rarely_the_board_calls();
    an_overload_does_not_make_a_relax_longer();
    safe_actions_belong_to_faults();
    a_relax_lasts_as_long_as_its_longest_way();
    a_safe_action_that_is_over_stays_over();
    memory_is_taken_up_within_bounds();
    the_estop_input_holds_off_clear();
    an_unsound_motion_is_a_fault();
    a_wrong_target_is_found_at_once();
    an_overshoot_inside_is_a_fault();
    a_fault_without_its_state_is_a_fault();
    a_pressed_button_repeats_no_config_fault();
    a_jump_inside_the_table_is_a_fault_of_its_servo();
    an_output_that_fails_is_a_fault();
    hold_ends_in_a_relax();
    nothing_moves_before_the_handshake();
    arming_is_checked_and_staggered();
    arming_takes_up_the_last_pose_of_servos_that_hold_and_goes_to_rest_slowly();
    a_closed_hand_that_was_stopped_does_not_close_again();
    arming_brings_each_servo_to_rest();
    the_first_pulse_comes_no_microsecond_early();
    the_time_to_a_first_pulse_is_exact();
    silence_trips_the_watchdog_and_latches(HPAC_ACTION_HOLD);
    silence_trips_the_watchdog_and_latches(HPAC_ACTION_RELAX);
    silence_trips_the_watchdog_and_latches(HPAC_ACTION_DETACH);
    refused_frames_do_not_feed_the_watchdog();
    heartbeats_feed_the_watchdog();
    another_session_is_refused_and_feeds_nothing();
    a_new_session_takes_over_and_disarms();
    the_watchdog_is_what_arm_chose();
    anybody_may_stop_the_hand_and_other_versions_do_nothing_else();
    estop_stops_pulses_in_every_state();
    clear_and_hello_stop_a_motion();
    a_suspicious_reset_stays_disarmed();
    status_comes_at_the_set_rate();
    time_never_goes_back();
    a_wrong_angle_inside_latches_a_fault();
}
