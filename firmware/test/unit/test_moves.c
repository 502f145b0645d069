/* MOVE: limits, rates, durations, sequence, pre-emption; and that a refusal changes nothing. */
#include <stdlib.h>
#include <string.h>

#include "bench.h"
#include "check.h"
#include "hpac_motion.h"
#include "tests.h"

static const int16_t half[HPAC_SERVOS] = { 6000, 6000, 6000, 6000, 6000, 6000 };

static void all_servos_arrive_together(void)
{
    static const int16_t target[HPAC_SERVOS] = { 1000, 2000, 3000, 4000, 5000, 6000 };
    for (uint8_t flags = 0; flags < 2u; flags++) {
        bench_t bench;
        bench_armed(&bench, HPAC_ACTION_HOLD);
        CHECK(bench_move(&bench, flags, 400, target) == HPAC_REASON_OK);
        bench_run(&bench, 200);
        for (unsigned i = 0; i < HPAC_SERVOS; i++) {
            CHECK(abs(hpac_motion_angle(&bench.hand, i) - target[i] * 50) <= 1);
        }
        bench_run(&bench, 200);
        for (unsigned i = 0; i < HPAC_SERVOS; i++) {
            CHECK(hpac_motion_angle(&bench.hand, i) == target[i] * 100);
            CHECK(bench.pulses[i] == hpac_servo_pulse(&bench.config.servo[i], target[i] * 100));
        }
        CHECK(!hpac_ramp_moving(&bench.hand.ramp));
    }
}

static void refused(bench_t *bench, uint8_t flags, uint16_t ms, const int16_t *servo, int reason, unsigned which)
{
    hpac_ramp_t before = bench->hand.ramp;
    CHECK(bench_move(bench, flags, ms, servo) == reason);
    CHECK(bench->servo == which);
    CHECK(memcmp(&before, &bench->hand.ramp, sizeof before) == 0);
}

static void limits_are_exact_for_each_servo(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        const hpac_servo_t *limits = &bench.config.servo[i];
        int16_t target[HPAC_SERVOS] = { 0 };
        target[i] = (int16_t)(limits->max_urad / 100);
        CHECK(bench_move(&bench, 0, 1000, target) == HPAC_REASON_OK);
        target[i]++;
        refused(&bench, 0, 1000, target, HPAC_REASON_ANGLE, i);
        target[i] = (int16_t)(limits->min_urad / 100 - 1);
        refused(&bench, 0, 1000, target, HPAC_REASON_ANGLE, i);
        target[i] = INT16_MIN;
        refused(&bench, 0, 10000, target, HPAC_REASON_ANGLE, i);
    }
}

static void the_rate_limit_has_the_stated_tolerance(void)
{
    /* 4 rad/s: 0.2 rad in 50 ms, and 1 ms and 1e-4 rad more at the most */
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        bench_t bench;
        int16_t target[HPAC_SERVOS] = { 0 };
        bench_armed(&bench, HPAC_ACTION_HOLD);
        target[i] = 2042;
        refused(&bench, 0, 50, target, HPAC_REASON_RATE, i);
        target[i] = 2041;
        CHECK(bench_move(&bench, 0, 50, target) == HPAC_REASON_OK);
    }
}

static void minimum_jerk_needs_room_for_its_peak(void)
{
    bench_t bench;
    int16_t target[HPAC_SERVOS] = { 0, 0, 0, 2000, 0, 0 };
    bench_armed(&bench, HPAC_ACTION_HOLD);
    refused(&bench, HPAC_FLAG_MINIMUM_JERK, 90, target, HPAC_REASON_RATE, 3); /* peak 1.875 * 0.2 / 0.09 = 4.17 rad/s */
    CHECK(bench_move(&bench, HPAC_FLAG_MINIMUM_JERK, 94, target) == HPAC_REASON_OK);
}

static void durations_are_bounded(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    refused(&bench, 0, 0, half, HPAC_REASON_DURATION, HPAC_NO_SERVO);
    refused(&bench, 0, HPAC_MOVE_MIN_MS - 1, half, HPAC_REASON_DURATION, HPAC_NO_SERVO);
    refused(&bench, 0, HPAC_MOVE_MAX_MS + 1, half, HPAC_REASON_DURATION, HPAC_NO_SERVO);
    CHECK(bench_move(&bench, 0, HPAC_MOVE_MAX_MS, half) == HPAC_REASON_OK);
}

static void sequence_numbers_only_go_forward(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    bench.seq = 65530;
    CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_OK);
    bench.seq += 20; /* over the wrap */
    CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_OK);
    uint16_t last = bench.seq;
    bench.seq = (uint16_t)(last - 2u);
    refused(&bench, 0, 1000, half, HPAC_REASON_STALE, HPAC_NO_SERVO);
    bench.seq = (uint16_t)(last - 1u);
    refused(&bench, 0, 999, half, HPAC_REASON_STALE, HPAC_NO_SERVO); /* same number, another move */
    bench.seq = (uint16_t)(last + 0x8000u - 1u);
    refused(&bench, 0, 1000, half, HPAC_REASON_STALE, HPAC_NO_SERVO);
    bench_send(&bench, HPAC_HELLO, 0, NULL, 0);
    CHECK(!bench.hand.any_move);
}

static void a_repeated_frame_is_acknowledged_and_not_carried_out_again(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_OK);
    bench_run(&bench, 100);
    hpac_ramp_t running = bench.hand.ramp;
    bench.seq--;
    CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_OK);
    CHECK(memcmp(&running, &bench.hand.ramp, sizeof running) == 0);
}

/* Two moves of one number whose CRCs differ in their lowest byte alone: the second is no repeat of the first. */
static void a_repeat_is_known_by_its_whole_crc(void)
{
    static const int16_t first[HPAC_SERVOS] = { 100, 200, 300, 400, 1000, 1000 };
    static const int16_t second[HPAC_SERVOS] = { 100, 200, 300, 400, 93, 2223 };
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    bench.seq = 0x6fff;
    CHECK(bench_move(&bench, 0, 1000, first) == HPAC_REASON_OK);
    uint32_t crc = bench.hand.last_move_crc;
    bench.seq = 0x6fff;
    CHECK(bench_move(&bench, 0, 1000, second) == HPAC_REASON_STALE);
    bench.hand.last_seq = bench.seq = 0x6fff; /* the second alone would do */
    CHECK(bench_move(&bench, 0, 1000, second) == HPAC_REASON_OK);
    CHECK(crc != bench.hand.last_move_crc && crc >> 8 == bench.hand.last_move_crc >> 8);
}

static void a_move_pre_empts_from_the_present_pose_and_speed(void)
{
    static const int16_t back[HPAC_SERVOS] = { 3000, 3000, 3000, 3000, 3000, 3000 };
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    bench_move(&bench, HPAC_FLAG_MINIMUM_JERK, 600, half);
    bench_run(&bench, 300);
    int32_t angle = hpac_motion_angle(&bench.hand, 1);
    int32_t speed = hpac_ramp_speed(&bench.hand.ramp, 1);
    CHECK(speed > 1000000);
    CHECK(bench_move(&bench, HPAC_FLAG_MINIMUM_JERK, 600, back) == HPAC_REASON_OK);
    CHECK(bench.hand.ramp.from[1] == angle);
    CHECK(abs(hpac_ramp_speed(&bench.hand.ramp, 1) - speed) <= 2);
}

/* At full speed towards the limit, no minimum-jerk move may be accepted whose overshoot would pass it. */
static void an_overshoot_past_a_limit_is_refused(void)
{
    static const int16_t near[HPAC_SERVOS] = { 12000, 12000, 12000, 12000, 12000, 12000 };
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    CHECK(bench_move(&bench, 0, 310, near) == HPAC_REASON_OK);
    bench_run(&bench, 300);
    CHECK(bench_move(&bench, HPAC_FLAG_MINIMUM_JERK, 1000, near) == HPAC_REASON_ANGLE);
    CHECK(bench.hand.state == HPAC_STATE_ARMED);
}

static void flags_are_checked(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    CHECK(bench_move(&bench, 4, 1000, half) == HPAC_REASON_FLAGS);
    CHECK(bench_move(&bench, HPAC_FLAG_NO_ACK, 1000, half) == -1);
    CHECK(hpac_ramp_moving(&bench.hand.ramp));
    CHECK(bench_move(&bench, HPAC_FLAG_NO_ACK, 1, half) == HPAC_REASON_DURATION); /* refusals are always told */
    CHECK(bench_send(&bench, HPAC_HEARTBEAT, HPAC_FLAG_MINIMUM_JERK, NULL, 0) == HPAC_REASON_FLAGS);
}

/* A board that is held up goes on where it was, and later by as much; the host's next move takes longer, none is refused. */
static void a_late_tick_is_no_jump(void)
{
    static const int16_t whole[HPAC_SERVOS] = { 12000, 12000, 12000, 12000, 12000, 12000 };
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    CHECK(bench_move(&bench, 0, 300, whole) == HPAC_REASON_OK);
    bench_run(&bench, 100);
    int32_t before = hpac_motion_angle(&bench.hand, 2);
    bench.now_us += 130000;
    bench_run(&bench, 0);
    hpac_hand_tick(&bench.hand, &bench.config, bench.now_us, bench.pulses);
    CHECK(hpac_motion_angle(&bench.hand, 2) - before == 4 * HPAC_STEP_MAX_MS * 1000);
    hpac_hand_tick(&bench.hand, &bench.config, bench.now_us, bench.pulses); /* no time, no way */
    CHECK(hpac_motion_angle(&bench.hand, 2) - before == 4 * HPAC_STEP_MAX_MS * 1000);
    CHECK(bench_move(&bench, 0, 70, whole) == HPAC_REASON_OK); /* 180 ms of way are left, 110 ms were held back */
    CHECK(bench.hand.ramp.duration_us == 180000u);
    bench_run(&bench, 180);
    CHECK(hpac_motion_angle(&bench.hand, 2) == 1200000 && bench.hand.behind_us == 0u);
    CHECK(bench.hand.state == HPAC_STATE_ARMED);
}

/* 10 ms moves, each as fast as the credit lets it be: in the long run 1 % over the limit, no more. */
static void a_stream_of_short_moves_keeps_the_rate(void)
{
    bench_t bench;
    int16_t to[HPAC_SERVOS] = { 0 };
    bench_armed(&bench, HPAC_ACTION_HOLD);
    int32_t before = hpac_motion_angle(&bench.hand, 0);
    uint64_t start_us = bench.now_us;
    for (int i = 0; i < 32; i++) { /* 4 rad/s: 0.04 rad in 10 ms; ask for 0.0440 and take what is given */
        int step = 440;
        do {
            to[0] = (int16_t)(before / 100 + step);
            step--;
        } while (bench_move(&bench, HPAC_FLAG_NO_ACK, 10, to) == HPAC_REASON_RATE);
        bench_run(&bench, 10);
        before = hpac_motion_angle(&bench.hand, 0);
    }
    int64_t elapsed_us = (int64_t)(bench.now_us - start_us);
    int64_t credit = 4 * HPAC_TIME_TOLERANCE_US + HPAC_ANGLE_TOLERANCE_URAD;
    CHECK(before <= 4 * elapsed_us * 101 / 100 + credit);
    CHECK(before >= 4 * elapsed_us);
}

static void a_move_may_start_at_either_limit(void)
{
    for (int upper = 0; upper < 2; upper++) {
        bench_t bench;
        int32_t limit[HPAC_SERVOS];
        bench_armed(&bench, HPAC_ACTION_HOLD);
        for (int i = 0; i < HPAC_SERVOS; i++) {
            limit[i] = upper != 0 ? bench.config.servo[i].max_urad : bench.config.servo[i].min_urad;
        }
        hpac_motion_stand(&bench.hand, limit);
        CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_OK);
        hpac_motion_stand(&bench.hand, limit);
        CHECK(bench_move(&bench, HPAC_FLAG_MINIMUM_JERK, 1000, half) == HPAC_REASON_OK);
    }
}

/* Frames alone, without an output in between, bring a motion on by one late tick's time at the most. */
static void frames_without_an_output_are_no_way_round(void)
{
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    CHECK(bench_move(&bench, 0, 1000, half) == HPAC_REASON_OK);
    for (int i = 0; i < 5; i++) {
        bench.now_us += 30000;
        hpac_hand_receive(&bench.hand, &bench.config, bench.now_us, NULL, 0);
        CHECK(bench.hand.ramp.elapsed_us == HPAC_STEP_MAX_MS * 1000u);
    }
}

/* The rate credit to the last nanoradian: how full it gets, and how far below nothing roundings may bring it. */
static void the_rate_credit_is_exact(void)
{
    const int32_t most_nrad = 4000 * HPAC_TIME_TOLERANCE_US + 1000 * HPAC_ANGLE_TOLERANCE_URAD; /* at 4 rad/s */
    const int32_t step_nrad = 4040 * 1000 * HPAC_STEP_MAX_MS;
    const struct {
        int32_t credit_nrad, way_urad;
        uint32_t step_us;
        bool holds;
    } cases[] = {
        { -16000, 0, 0, true },
        { -16001, 0, 0, false },
        { most_nrad, most_nrad / 1000 + 16, 0, true },
        { most_nrad + 1000, most_nrad / 1000 + 17, 0, false },
        { most_nrad, (most_nrad + step_nrad) / 1000 + 16, HPAC_STEP_MAX_MS * 1000, true },
        { most_nrad, (most_nrad + step_nrad) / 1000 + 17, HPAC_STEP_MAX_MS * 1000 + 999, false }, /* no more than a step's time */
    };
    bench_t bench;
    bench_armed(&bench, HPAC_ACTION_HOLD);
    CHECK(bench.hand.credit_nrad[3] == most_nrad);
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        unsigned servo = HPAC_NO_SERVO;
        bench_armed(&bench, HPAC_ACTION_HOLD);
        bench.hand.credit_nrad[3] = cases[i].credit_nrad;
        bench.hand.step_us = cases[i].step_us;
        bench.hand.ramp.to[3] = cases[i].way_urad;
        CHECK(hpac_motion_output(&bench.hand, &servo) == cases[i].holds);
        CHECK(cases[i].holds || servo == 3u);
    }
}

/* What late ticks have held back prolongs a move by the longest watchdog's period at the most. */
static void a_move_is_prolonged_within_bounds(void)
{
    static const uint32_t behind_us[] = { 1999999, 2000500, 2001000, 4000000 };
    for (int i = 0; i < 4; i++) {
        bench_t bench;
        bench_armed(&bench, HPAC_ACTION_HOLD);
        CHECK(bench_move(&bench, 0, 300, half) == HPAC_REASON_OK);
        bench.hand.behind_us = behind_us[i];
        CHECK(bench_move(&bench, 0, 300, half) == HPAC_REASON_OK);
        CHECK(bench.hand.ramp.duration_us == 300000u + (behind_us[i] < 2000000u ? behind_us[i] : 2000000u));
    }
}

void test_moves(void)
{
    a_move_may_start_at_either_limit();
    frames_without_an_output_are_no_way_round();
    the_rate_credit_is_exact();
    a_move_is_prolonged_within_bounds();
    a_late_tick_is_no_jump();
    a_stream_of_short_moves_keeps_the_rate();
    all_servos_arrive_together();
    limits_are_exact_for_each_servo();
    the_rate_limit_has_the_stated_tolerance();
    minimum_jerk_needs_room_for_its_peak();
    durations_are_bounded();
    sequence_numbers_only_go_forward();
    a_repeated_frame_is_acknowledged_and_not_carried_out_again();
    a_repeat_is_known_by_its_whole_crc();
    a_move_pre_empts_from_the_present_pose_and_speed();
    an_overshoot_past_a_limit_is_refused();
    flags_are_checked();
}
