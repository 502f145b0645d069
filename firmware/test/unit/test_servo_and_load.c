/* Pulse widths, trims, and the heat estimate. */
#include "bench.h"
#include "check.h"
#include "hpac_load.h"
#include "tests.h"

static void pulses_follow_the_table(void)
{
    hpac_config_t config;
    bench_config(&config);
    hpac_servo_t servo = config.servo[5];
    CHECK(hpac_servo_pulse(&servo, servo.centre_urad) == 1500000u);
    CHECK(hpac_servo_pulse(&servo, servo.centre_urad + 100000) == 1563662u);
    servo.trim_ns = -20000;
    CHECK(hpac_servo_pulse(&servo, servo.centre_urad) == 1480000u);
    servo.direction = -1;
    CHECK(hpac_servo_pulse(&servo, servo.centre_urad + 100000) == 1416338u);
}

static void unusable_tables_are_found(void)
{
    hpac_config_t config;
    bench_config(&config);
    const hpac_servo_t good = config.servo[0];
    hpac_servo_t bad[7] = { good, good, good, good, good, good, good };
    bad[0].direction = 0;
    bad[1].trim_ns = 800000;
    bad[2].trim_ns = -800000;
    bad[3].rate_urad_s = 0;
    bad[4].max_urad = bad[4].min_urad;
    bad[5].rest_urad = bad[5].max_urad + 1;
    bad[6].ns_per_rad = -1;
    CHECK(hpac_servo_usable(&good));
    for (int i = 0; i < 7; i++) {
        CHECK(!hpac_servo_usable(&bad[i]));
    }
}

static void an_unusable_table_never_gets_pulses(void)
{
    bench_t bench;
    hpac_config_t config;
    bench_start(&bench);
    bench_config(&config);
    config.servo[3].trim_ns = 800000;
    hpac_hand_init(&bench.hand, &config, HPAC_RESET_POWER_ON, 1);
    CHECK(bench.hand.state == HPAC_STATE_FAULT && bench.hand.fault == HPAC_FAULT_CONFIG);
    CHECK(bench_send(&bench, HPAC_CLEAR, 0, NULL, 0) == HPAC_REASON_STATE);
    bench_run(&bench, 10);
    CHECK(bench.hand.state == HPAC_STATE_FAULT && bench_silent(&bench));
}

static void heat_rises_to_the_square_of_the_effort(void)
{
    uint32_t heat = 0;
    uint32_t effort = hpac_load_effort(1000, 0);
    CHECK(effort == HPAC_LOAD_IDLE_PERMILLE + HPAC_LOAD_HOLD_PERMILLE);
    CHECK(hpac_load_effort(1000, 1000) == effort + HPAC_LOAD_MOVE_PERMILLE);
    CHECK(hpac_load_effort(5000, 5000) == hpac_load_effort(1000, 1000));
    for (int i = 0; i < HPAC_LOAD_TIME_CONSTANT_S * 100; i++) {
        heat = hpac_load_step(heat, effort);
    }
    uint32_t end = effort * effort * 256u; /* after one time constant 63.2 % are reached */
    CHECK(heat > end / 1000u * 630u && heat < end / 1000u * 634u);
    for (int i = 0; i < HPAC_LOAD_TIME_CONSTANT_S * 1500; i++) {
        heat = hpac_load_step(heat, 0);
    }
    CHECK(hpac_load_percent(heat) == 0u);
}

static void the_rate_falls_with_heat(void)
{
    CHECK(hpac_load_rate_permille(0) == 1000u);
    CHECK(hpac_load_rate_permille(HPAC_HEAT_LIMIT / 100u * HPAC_LOAD_DERATE_FROM_PERCENT) == 1000u);
    CHECK(hpac_load_rate_permille(HPAC_HEAT_LIMIT / 100u * 90u) > 600u);
    CHECK(hpac_load_rate_permille(HPAC_HEAT_LIMIT / 100u * 90u) < 650u);
    CHECK(hpac_load_rate_permille(HPAC_HEAT_LIMIT) == HPAC_LOAD_DERATE_TO_PERMILLE);
    CHECK(hpac_load_rate_permille(UINT32_MAX) == HPAC_LOAD_DERATE_TO_PERMILLE);
    CHECK(hpac_load_percent(HPAC_HEAT_LIMIT) == 100u);
}

static void keep_alive(bench_t *bench, uint32_t s)
{
    for (uint32_t i = 0; i < 4u * s && bench->hand.state == HPAC_STATE_ARMED; i++) {
        bench_send(bench, HPAC_HEARTBEAT, 0, NULL, 0);
        bench_run(bench, 250);
    }
}

/* A hand held closed is slowed down, then opens by itself, cools, and can be armed again. */
static void a_closed_hand_is_derated_then_relaxes(void)
{
    static const int16_t closed[HPAC_SERVOS] = { 13000, 13000, 13000, 13000, 13000, 13000 };
    static const int16_t open[HPAC_SERVOS] = { 0 };
    uint8_t arm[HPAC_ARM_LENGTH];
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    hpac_put_u32(arm + HPAC_ARM_AT_LIMITS_HASH, HPAC_LIMITS_HASH);
    arm[HPAC_ARM_AT_ACTION] = HPAC_ACTION_HOLD;
    CHECK(bench_move(&bench, 0, 400, closed) == HPAC_REASON_OK);
    keep_alive(&bench, 200);
    CHECK(bench.hand.state == HPAC_STATE_ARMED);
    CHECK(bench_move(&bench, 0, 400, open) == HPAC_REASON_HOT);
    keep_alive(&bench, 200);
    CHECK(bench.hand.state == HPAC_STATE_FAULT && bench.hand.fault == HPAC_FAULT_OVERLOAD);
    CHECK(bench.hand.relaxing);
    bench_run(&bench, 2000);
    CHECK(bench_silent(&bench));
    CHECK(bench_send(&bench, HPAC_CLEAR, 0, NULL, 0) == HPAC_REASON_OK);
    CHECK(bench_send(&bench, HPAC_ARM, 0, arm, sizeof arm) == HPAC_REASON_HOT);
    bench_run(&bench, 60000);
    CHECK(bench_send(&bench, HPAC_ARM, 0, arm, sizeof arm) == HPAC_REASON_OK);
}

static void heat_does_not_depend_on_how_often_the_board_ticks(void)
{
    bench_t often;
    bench_t rarely;
    bench_armed(&often, HPAC_ACTION_HOLD);
    bench_armed(&rarely, HPAC_ACTION_HOLD);
    for (int i = 0; i < 400; i++) {
        bench_run(&often, 20);
        rarely.now_us += 20000u;
        hpac_hand_tick(&rarely.hand, rarely.now_us, rarely.pulses);
        if (i % 10 == 0) {
            bench_send(&often, HPAC_HEARTBEAT, 0, NULL, 0);
            bench_send(&rarely, HPAC_HEARTBEAT, 0, NULL, 0);
        }
    }
    CHECK(often.hand.heat[0] > 0u && often.hand.heat[0] == rarely.hand.heat[0]);
}

void test_servo_and_load(void)
{
    heat_does_not_depend_on_how_often_the_board_ticks();
    pulses_follow_the_table();
    unusable_tables_are_found();
    an_unusable_table_never_gets_pulses();
    heat_rises_to_the_square_of_the_effort();
    the_rate_falls_with_heat();
    a_closed_hand_is_derated_then_relaxes();
}
