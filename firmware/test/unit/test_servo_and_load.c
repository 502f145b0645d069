/* Pulse widths, trims, and the heat estimate. */
#include <string.h>

#include "bench.h"
#include "check.h"
#include "hpac_load.h"
#include "hpac_motion.h"
#include "hpac_state.h"
#include "tests.h"

static void pulses_follow_the_table(void)
{
    hpac_config_t config;
    bench_config(&config);
    hpac_servo_t servo = config.servo[5];
    CHECK(hpac_servo_pulse(&servo, servo.centre_urad) == 1500000u);
    CHECK(hpac_servo_pulse(&servo, servo.centre_urad + 100000) == 1563662u);
    for (int32_t urad = 1; urad < 100; urad++) { /* to the nearest nanosecond, halves away from the centre */
        uint32_t ns = ((uint32_t)urad * 636620u + 500000u) / 1000000u;
        CHECK(hpac_servo_pulse(&servo, servo.centre_urad + urad) == 1500000u + ns);
        CHECK(hpac_servo_pulse(&servo, servo.centre_urad - urad) == 1500000u - ns);
    }
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

/* Each bound of a table at its last admissible value, and one beyond it. */
static void bounds_of_a_table_are_exact(void)
{
    static const hpac_servo_t wide = { .min_urad = 0, .max_urad = 1000000, .rest_urad = 500000, .centre_urad = 500000,
                                       .rate_urad_s = 1000000, .ns_per_rad = 1000000, .centre_ns = 1500000, .direction = 1 };
    static const struct {
        size_t at; /* offset of the column */
        int32_t good, bad;
    } rows[] = {
        { offsetof(hpac_servo_t, min_urad), 500000, 500001 }, /* rest */
        { offsetof(hpac_servo_t, max_urad), 500000, 499999 },
        { offsetof(hpac_servo_t, rest_urad), 0, -1 },
        { offsetof(hpac_servo_t, rest_urad), 1000000, 1000001 },
        { offsetof(hpac_servo_t, rate_urad_s), 1, 0 },
        { offsetof(hpac_servo_t, rate_urad_s), 100000000, 100000001 },
        { offsetof(hpac_servo_t, ns_per_rad), 1, 0 },
        { offsetof(hpac_servo_t, trim_ns), 32767, 32768 },
        { offsetof(hpac_servo_t, trim_ns), -32768, -32769 },
        { offsetof(hpac_servo_t, direction), -1, 2 },
        { offsetof(hpac_servo_t, direction), 1, 0 },
        { offsetof(hpac_servo_t, centre_ns), HPAC_PULSE_MIN_NS + 500000, HPAC_PULSE_MIN_NS + 499999 },
        { offsetof(hpac_servo_t, centre_ns), HPAC_PULSE_MAX_NS - 500000, HPAC_PULSE_MAX_NS - 499999 },
        { offsetof(hpac_servo_t, centre_urad), 0, -1 },
        { offsetof(hpac_servo_t, centre_urad), 1000000, 1000001 },
    };
    CHECK(hpac_servo_usable(&wide));
    for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
        for (int direction = -1; direction <= 1; direction += 2) {
            hpac_servo_t servo = wide;
            servo.direction = direction;
            memcpy((uint8_t *)&servo + rows[i].at, &rows[i].good, sizeof rows[i].good);
            CHECK(hpac_servo_usable(&servo));
            memcpy((uint8_t *)&servo + rows[i].at, &rows[i].bad, sizeof rows[i].bad);
            CHECK(!hpac_servo_usable(&servo));
        }
    }
    hpac_servo_t far = wide; /* what the wire can say */
    far.ns_per_rad = 100000;
    far.min_urad = -3276700;
    far.max_urad = 3276700;
    CHECK(hpac_servo_usable(&far));
    far.max_urad++;
    CHECK(!hpac_servo_usable(&far));
    far.max_urad--;
    far.min_urad--;
    CHECK(!hpac_servo_usable(&far));
    for (int i = 0; i < HPAC_SERVOS; i++) { /* one is enough */
        hpac_config_t config;
        bench_config(&config);
        CHECK(hpac_servo_all_usable(config.servo));
        config.servo[i].direction = 0;
        CHECK(!hpac_servo_all_usable(config.servo));
    }
}

static void an_unusable_table_never_gets_pulses(void)
{
    bench_t bench;
    bench_start(&bench);
    bench.config.servo[3].trim_ns = 800000;
    hpac_hand_init(&bench.hand, &bench.config, HPAC_RESET_POWER_ON, 1, NULL);
    CHECK(bench.hand.state == HPAC_STATE_FAULT && bench.hand.fault == HPAC_FAULT_CONFIG);
    bench_send(&bench, HPAC_HELLO, 0, NULL, 0);
    CHECK(bench.fault_servo == HPAC_NO_SERVO);
    CHECK(bench_send(&bench, HPAC_CLEAR, 0, NULL, 0) == HPAC_REASON_STATE);
    bench_run(&bench, 10);
    CHECK(bench.hand.state == HPAC_STATE_FAULT && bench_silent(&bench));
    bench.fault_servo = 0;
    CHECK(bench_send(&bench, HPAC_ESTOP, 0, NULL, 0) == HPAC_REASON_OK); /* there is nothing to stop, but it is told */
    CHECK(bench.answer_types[HPAC_FAULT] == 1u && bench.fault_servo == HPAC_NO_SERVO);
    CHECK(bench.hand.fault == HPAC_FAULT_CONFIG && bench_silent(&bench));
    bench_run(&bench, 10);
    CHECK(bench.hand.fault == HPAC_FAULT_CONFIG);
    bench.hand.attached = 4; /* should a bit flip */
    bench_run(&bench, 1);
    CHECK(bench_silent(&bench));
    for (uint8_t state = HPAC_STATE_BOOT; state < HPAC_STATE_FAULT; state++) {
        hpac_hand_init(&bench.hand, &bench.config, HPAC_RESET_POWER_ON, 1, NULL);
        bench.hand.state = state; /* should this one */
        bench_run(&bench, 1);
        CHECK(bench.hand.state == HPAC_STATE_FAULT && !hpac_hand_powered(&bench.hand));
        bench_send(&bench, HPAC_HELLO, 0, NULL, 0);
        CHECK(bench_arm(&bench, HPAC_ACTION_RELAX, 0) == HPAC_REASON_STATE);
    }
    bench_start(&bench);
    bench.config.servo[3].max_urad = -1; /* nothing is computed with such a table, and its fault is told once */
    hpac_hand_init(&bench.hand, &bench.config, HPAC_RESET_POWER_ON, 1, NULL);
    bench_run(&bench, 1);
    memset(bench.answer_types, 0, sizeof bench.answer_types);
    bench_run(&bench, 10);
    CHECK(bench.hand.fault == HPAC_FAULT_CONFIG && bench.answer_types[HPAC_FAULT] == 0u);
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

/* Shares are cut to whole permille, and an angle counts from rest. */
static void effort_follows_the_angle(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    CHECK(hpac_motion_effort(&bench.hand, 5) == HPAC_LOAD_IDLE_PERMILLE);
    bench.hand.ramp.to[5] = 1569999; /* of 1.57 rad: 999 permille, 599.4 of effort */
    CHECK(hpac_motion_effort(&bench.hand, 5) == HPAC_LOAD_IDLE_PERMILLE + 599u);
    bench.hand.ramp.to[5] = 1570000;
    CHECK(hpac_motion_effort(&bench.hand, 5) == HPAC_LOAD_IDLE_PERMILLE + HPAC_LOAD_HOLD_PERMILLE);
    bench.hand.attached = 0x1f;
    CHECK(hpac_motion_effort(&bench.hand, 5) == 0u);
}

static void the_rate_falls_with_heat(void)
{
    CHECK(hpac_load_rate_permille(0) == 1000u);
    CHECK(hpac_load_rate_permille(HPAC_HEAT_LIMIT / 100u * HPAC_LOAD_DERATE_FROM_PERCENT) == 1000u);
    for (uint32_t share = 0; share < 1000u; share++) { /* from 80 % on, in thousandths of the way to 100 % */
        uint32_t heat = HPAC_HEAT_LIMIT / 100u * HPAC_LOAD_DERATE_FROM_PERCENT + share * (HPAC_HEAT_LIMIT / 5000u);
        CHECK(hpac_load_rate_permille(heat) == 1000u - 750u * share / 1000u);
    }
    bench_t bench;
    bench_idle(&bench);
    bench.hand.heat[4] = HPAC_HEAT_LIMIT / 100u * 90u;
    bench.hand.heat[2] = HPAC_HEAT_LIMIT / 100u * 85u;
    CHECK(hpac_motion_rate_permille(&bench.hand) == 625u); /* the hottest servo's */
    bench.hand.heat[0] = HPAC_HEAT_LIMIT;
    CHECK(hpac_motion_rate_permille(&bench.hand) == HPAC_LOAD_DERATE_TO_PERMILLE);
    CHECK(hpac_load_rate_permille(HPAC_HEAT_LIMIT) == HPAC_LOAD_DERATE_TO_PERMILLE);
    CHECK(hpac_load_rate_permille(UINT32_MAX) == HPAC_LOAD_DERATE_TO_PERMILLE);
    CHECK(hpac_load_percent(HPAC_HEAT_LIMIT) == 100u);
    CHECK(hpac_load_percent(UINT32_MAX) == 255u);
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
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
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
    CHECK(bench_arm(&bench, HPAC_ACTION_HOLD, 0) == HPAC_REASON_HOT);
    bench_run(&bench, 60000);
    CHECK(bench_arm(&bench, HPAC_ACTION_HOLD, 0) == HPAC_REASON_OK);
}

static void the_first_servo_at_its_limit_is_told_once(void)
{
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        bench_t bench;
        bench_armed(&bench, HPAC_ACTION_HOLD);
        for (unsigned k = i; k < HPAC_SERVOS; k++) {
            bench.hand.heat[k] = HPAC_HEAT_LIMIT;
        }
        bench.hand.load_us = bench.now_us;
        bench.answer_types[HPAC_FAULT] = 0;
        bench_feed(&bench, NULL, 0);
        CHECK(bench.hand.fault == HPAC_FAULT_OVERLOAD && bench.fault_servo == i && bench.answer_types[HPAC_FAULT] == 1u);
    }
}

/* Every 10 ms, and after a gap for one second of it. */
static void heat_steps_are_counted(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    bench.hand.load_us = bench.now_us;
    uint32_t heat = bench.hand.heat[1];
    bench.now_us += HPAC_LOAD_STEP_US - 1u;
    bench_feed(&bench, NULL, 0);
    CHECK(bench.hand.heat[1] == heat);
    bench.now_us++;
    bench_feed(&bench, NULL, 0);
    heat = hpac_load_step(heat, HPAC_LOAD_IDLE_PERMILLE);
    CHECK(bench.hand.heat[1] == heat);
    for (int gaps = 0; gaps < 2; gaps++) {
        hpac_state_idle(&bench.hand);
        bench.hand.heat[1] = HPAC_HEAT_LIMIT / 2u;
        uint32_t cold = HPAC_HEAT_LIMIT / 2u;
        for (int i = 0; i < 100; i++) {
            cold = hpac_load_step(cold, 0);
        }
        bench.now_us += 100u * HPAC_LOAD_STEP_US + (gaps == 0 ? 0u : 5000000u);
        bench_feed(&bench, NULL, 0);
        CHECK(bench.hand.heat[1] == cold);
    }
}

static void each_hot_servo_keeps_the_hand_from_arming(void)
{
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        bench_t bench;
        bench_idle(&bench);
        bench.hand.heat[i] = HPAC_HEAT_LIMIT / 100u * 90u;
        CHECK(bench_arm(&bench, HPAC_ACTION_HOLD, 0) == HPAC_REASON_HOT && bench.servo == i);
        CHECK(bench.hand.state == HPAC_STATE_IDLE);
        bench_armed(&bench, HPAC_ACTION_HOLD); /* one that grips may change its action and go on */
        bench.hand.heat[i] = HPAC_HEAT_LIMIT / 100u * 90u;
        CHECK(bench_arm(&bench, HPAC_ACTION_RELAX, 0) == HPAC_REASON_OK);
    }
}

static void a_low_supply_keeps_the_hand_from_arming_and_stops_it(void)
{
    bench_t bench;
    bench_idle(&bench);
    hpac_hand_inputs(&bench.hand, false, HPAC_SUPPLY_MIN_MV - 1);
    bench.now_us++;
    hpac_hand_tick(&bench.hand, &bench.config, bench.now_us, bench.pulses);
    CHECK(bench_arm(&bench, HPAC_ACTION_HOLD, 0) == HPAC_REASON_SUPPLY);
    hpac_hand_inputs(&bench.hand, false, 0); /* nothing is measured */
    bench_run(&bench, 1);
    hpac_hand_inputs(&bench.hand, false, 1);
    for (int i = 0; i < 1 << 20; i++) { /* 2^32 us, and the time that it was low is not 0 again */
        bench.now_us += 4096;
        hpac_hand_tick(&bench.hand, &bench.config, bench.now_us, bench.pulses);
    }
    CHECK(bench_arm(&bench, HPAC_ACTION_HOLD, 0) == HPAC_REASON_SUPPLY);
    hpac_hand_inputs(&bench.hand, false, HPAC_SUPPLY_MIN_MV);
    bench_run(&bench, 1);
    CHECK(bench_arm(&bench, HPAC_ACTION_HOLD, 0) == HPAC_REASON_OK);
    bench_run(&bench, 200);
    for (int dips = 0; dips < 3; dips++) { /* a dip is none */
        hpac_hand_inputs(&bench.hand, false, 1);
        bench_run(&bench, HPAC_SUPPLY_LOW_MS - 1);
        CHECK(bench.hand.state == HPAC_STATE_ARMED);
        hpac_hand_inputs(&bench.hand, false, 5000);
        bench_run(&bench, 1);
    }
    hpac_hand_inputs(&bench.hand, false, 1);
    bench_run(&bench, HPAC_SUPPLY_LOW_MS);
    CHECK(bench.hand.fault == HPAC_FAULT_SUPPLY && bench_silent(&bench) && !hpac_hand_powered(&bench.hand));
    bench_armed(&bench, HPAC_ACTION_HOLD);
    hpac_hand_inputs(&bench.hand, false, 1);
    bench_run(&bench, 5);
    bench.hand.supply_low_us ^= 1u << 20; /* any single bit may flip */
    bench_run(&bench, 1);
    CHECK(bench.hand.fault == HPAC_FAULT_SUPPLY && bench_silent(&bench));
}

/* Each servo's own heat slows its own moves, and no other's. */
static void a_hot_servo_alone_is_slowed(void)
{
    for (unsigned hot = 0; hot < HPAC_SERVOS; hot++) {
        for (unsigned moved = 0; moved < HPAC_SERVOS; moved++) {
            int16_t target[HPAC_SERVOS] = { 0 };
            bench_t bench;
            bench_armed(&bench, HPAC_ACTION_HOLD);
            bench.hand.heat[hot] = HPAC_HEAT_LIMIT / 100u * 95u;
            target[moved] = 12000;
            CHECK(bench_move(&bench, 0, 400, target) == (moved == hot ? HPAC_REASON_HOT : HPAC_REASON_OK));
            CHECK(moved != hot || bench.servo == hot);
        }
    }
}

/* A hold grips: it heats the servos, and ends where they are too hot. */
static void overload_ends_a_hold(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    bench_run(&bench, BENCH_WATCHDOG_MS + 100);
    CHECK(bench.hand.fault == HPAC_FAULT_WATCHDOG && bench_all_pulses(&bench));
    bench.hand.heat[2] = HPAC_HEAT_LIMIT + HPAC_HEAT_LIMIT / 100u;
    bench_run(&bench, 2);
    CHECK(bench.hand.fault == HPAC_FAULT_OVERLOAD && bench.fault_servo == 2u);
    bench_run(&bench, 4000);
    CHECK(bench_silent(&bench));
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
        hpac_hand_tick(&rarely.hand, &rarely.config, rarely.now_us, rarely.pulses);
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
    the_first_servo_at_its_limit_is_told_once();
    heat_steps_are_counted();
    each_hot_servo_keeps_the_hand_from_arming();
    a_hot_servo_alone_is_slowed();
    overload_ends_a_hold();
    a_low_supply_keeps_the_hand_from_arming_and_stops_it();
    pulses_follow_the_table();
    unusable_tables_are_found();
    bounds_of_a_table_are_exact();
    an_unusable_table_never_gets_pulses();
    heat_rises_to_the_square_of_the_effort();
    effort_follows_the_angle();
    the_rate_falls_with_heat();
    a_closed_hand_is_derated_then_relaxes();
}
