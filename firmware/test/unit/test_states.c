/* The state machine: who may do what when, watchdog, e-stop, safe actions, latches. */
#include "bench.h"
#include "check.h"
#include "tests.h"

static const int16_t half[HPAC_SERVOS] = { 6000, 6000, 6000, 6000, 6000, 6000 };

static void arm_payload(uint8_t *payload, uint32_t hash, uint8_t action)
{
    hpac_put_u32(payload + HPAC_ARM_AT_LIMITS_HASH, hash);
    payload[HPAC_ARM_AT_ACTION] = action;
}

static void nothing_moves_before_the_handshake(void)
{
    bench_t bench;
    uint8_t arm[HPAC_ARM_LENGTH];
    arm_payload(arm, HPAC_LIMITS_HASH, HPAC_ACTION_HOLD);
    bench_start(&bench);
    CHECK(bench.hand.state == HPAC_STATE_BOOT);
    CHECK(bench_send(&bench, HPAC_ARM, 0, arm, sizeof arm) == HPAC_REASON_STATE);
    CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_STATE);
    CHECK(bench_send(&bench, HPAC_CLEAR, 0, NULL, 0) == HPAC_REASON_STATE);
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
    uint8_t arm[HPAC_ARM_LENGTH];
    bench_idle(&bench);
    arm_payload(arm, HPAC_LIMITS_HASH ^ 1u, HPAC_ACTION_HOLD);
    CHECK(bench_send(&bench, HPAC_ARM, 0, arm, sizeof arm) == HPAC_REASON_LIMITS);
    arm_payload(arm, HPAC_LIMITS_HASH, HPAC_ACTION_DETACH + 1u);
    CHECK(bench_send(&bench, HPAC_ARM, 0, arm, sizeof arm) == HPAC_REASON_ACTION);
    CHECK(bench.hand.state == HPAC_STATE_IDLE);
    arm_payload(arm, HPAC_LIMITS_HASH, HPAC_ACTION_HOLD);
    CHECK(bench_send(&bench, HPAC_ARM, 0, arm, sizeof arm) == HPAC_REASON_OK);
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        CHECK(bench.hand.attached == (1u << (i + 1u)) - 1u);
        CHECK(i == HPAC_SERVOS - 1u || bench_move(&bench, 0, 1000, half) == HPAC_REASON_STARTING);
        bench_run(&bench, HPAC_STAGGER_MS);
    }
    CHECK(bench_all_pulses(&bench));
    CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_OK);
}

static void silence_trips_the_watchdog_and_latches(hpac_action_t action)
{
    bench_t bench;
    uint8_t arm[HPAC_ARM_LENGTH];
    arm_payload(arm, HPAC_LIMITS_HASH, HPAC_ACTION_HOLD);
    bench_armed(&bench, action);
    CHECK(bench_move(&bench, 0, 200, half) == HPAC_REASON_OK);
    bench_run(&bench, HPAC_WATCHDOG_MS - 1);
    CHECK(bench.hand.state == HPAC_STATE_ARMED);
    uint32_t before = bench.pulses[2];
    bench_run(&bench, 1);
    CHECK(bench.hand.state == HPAC_STATE_FAULT && bench.hand.fault == HPAC_FAULT_WATCHDOG);
    CHECK(bench.hand.count.watchdog_trips == 1u);
    CHECK(bench_silent(&bench) == (action == HPAC_ACTION_DETACH));
    CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_STATE);
    CHECK(bench_send(&bench, HPAC_HEARTBEAT, 0, NULL, 0) == HPAC_REASON_OK);
    CHECK(bench_send(&bench, HPAC_ARM, 0, arm, sizeof arm) == HPAC_REASON_STATE);
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
        bench_run(&bench, HPAC_WATCHDOG_MS / 10);
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
        bench_run(&bench, HPAC_WATCHDOG_MS - 1);
    }
    CHECK(bench.hand.state == HPAC_STATE_ARMED);
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
    bench_run(&bench, HPAC_WATCHDOG_MS);
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
        CHECK(!hpac_ramp_moving(&bench.hand.ramp, bench.now_us));
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
        hpac_config_t config;
        bench_start(&bench);
        bench_config(&config);
        hpac_hand_init(&bench.hand, &config, resets[i], 2);
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
    hpac_hand_tick(&bench.hand, 0, pulses);
    CHECK(pulses[0] == bench.pulses[0]);
    CHECK(bench.hand.state == HPAC_STATE_ARMED);
}

/* Whatever the reason: an angle outside of the limits never becomes a pulse. */
static void a_wrong_angle_inside_latches_a_fault(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    bench.hand.ramp.to[4] = bench.hand.config.servo[4].max_urad + 17;
    bench_run(&bench, 1);
    CHECK(bench.hand.fault == HPAC_FAULT_INTERNAL && bench_silent(&bench));
}

void test_states(void)
{
    nothing_moves_before_the_handshake();
    arming_is_checked_and_staggered();
    silence_trips_the_watchdog_and_latches(HPAC_ACTION_HOLD);
    silence_trips_the_watchdog_and_latches(HPAC_ACTION_RELAX);
    silence_trips_the_watchdog_and_latches(HPAC_ACTION_DETACH);
    refused_frames_do_not_feed_the_watchdog();
    heartbeats_feed_the_watchdog();
    estop_stops_pulses_in_every_state();
    clear_and_hello_stop_a_motion();
    a_suspicious_reset_stays_disarmed();
    status_comes_at_the_set_rate();
    time_never_goes_back();
    a_wrong_angle_inside_latches_a_fault();
}
