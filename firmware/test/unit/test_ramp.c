/* The synchronised move: exact ends, continuity, bounds. */
#include <stdlib.h>

#include "check.h"
#include "hpac_ramp.h"
#include "tests.h"

static int32_t angle_at(hpac_ramp_t *ramp, uint32_t us)
{
    ramp->elapsed_us = us;
    return hpac_ramp_angle(ramp, 2);
}

static int32_t speed_at(hpac_ramp_t *ramp, uint32_t us)
{
    ramp->elapsed_us = us;
    return hpac_ramp_speed(ramp, 2);
}

static hpac_ramp_t ramp_of(int32_t from, int32_t speed, int32_t to, uint32_t duration_us, bool minimum_jerk)
{
    hpac_ramp_t ramp = { .duration_us = duration_us, .minimum_jerk = minimum_jerk };
    for (int i = 0; i < HPAC_SERVOS; i++) {
        ramp.from[i] = from;
        ramp.from_speed[i] = speed;
        ramp.to[i] = to;
    }
    return ramp;
}

static void ends_are_exact(void)
{
    for (int kind = 0; kind < 2; kind++) {
        hpac_ramp_t ramp = ramp_of(123456, kind == 0 ? 0 : 700000, 1100000, 777000, kind == 1);
        CHECK(angle_at(&ramp, 0) == 123456);
        CHECK(angle_at(&ramp, ramp.duration_us) == 1100000);
        CHECK(speed_at(&ramp, ramp.duration_us) == 0);
        ramp.elapsed_us = 0;
        hpac_ramp_advance(&ramp, ramp.duration_us - 1u);
        CHECK(hpac_ramp_moving(&ramp));
        hpac_ramp_advance(&ramp, 1000u);
        CHECK(!hpac_ramp_moving(&ramp) && ramp.elapsed_us == ramp.duration_us);
        hpac_ramp_advance(&ramp, 1000u);
        CHECK(ramp.elapsed_us == ramp.duration_us);
    }
}

static void linear_is_a_straight_line(void)
{
    hpac_ramp_t ramp = ramp_of(0, 0, 1000000, 1000000, false);
    CHECK(angle_at(&ramp, 250000u) == 250000);
    CHECK(speed_at(&ramp, 250000u) == 1000000);
    CHECK(hpac_ramp_peak_speed(&ramp, 0) == 1000000);
}

static void minimum_jerk_has_its_textbook_shape(void)
{
    hpac_ramp_t ramp = ramp_of(0, 0, 1000000, 1000000, true);
    /* 10 s^3 - 15 s^4 + 6 s^5 at 1/4, 1/2; peak speed 1.875 */
    CHECK(abs(angle_at(&ramp, 250000u) - 103516) <= 1);
    CHECK(abs(angle_at(&ramp, 500000u) - 500000) <= 1);
    CHECK(abs(speed_at(&ramp, 500000u) - 1875000) <= 1);
    CHECK(hpac_ramp_peak_speed(&ramp, 0) == 1875000);
}

static void minimum_jerk_starts_at_the_given_speed(void)
{
    hpac_ramp_t ramp = ramp_of(200000, 900000, 700000, 900000, true);
    CHECK(abs(speed_at(&ramp, 0) - 900000) <= 2);
    int32_t early = angle_at(&ramp, 100u);
    CHECK(abs(early - 200090) <= 1);
}

/* Sweep of starts, speeds and targets: neither bound is ever passed, and speed is the slope of angle. */
static void bounds_hold(void)
{
    for (int32_t speed = -3000000; speed <= 3000000; speed += 1000000) {
        for (int32_t to = 0; to <= 1500000; to += 300000) {
            hpac_ramp_t ramp = ramp_of(600000, speed, to, 400000, true);
            int64_t peak = hpac_ramp_peak_speed(&ramp, 0);
            int64_t turning = hpac_ramp_turning_angle(&ramp, 0);
            int64_t low = turning < to ? turning : to;
            int64_t high = turning > to ? turning : to;
            low = low < 600000 ? low : 600000;
            high = high > 600000 ? high : 600000;
            bool inside = true;
            bool slow = true;
            bool smooth = true;
            for (uint32_t t = 0; t < 400000u; t += 1000u) {
                int32_t angle = angle_at(&ramp, t);
                int32_t next = angle_at(&ramp, t + 1000u);
                int32_t rate = speed_at(&ramp, t);
                inside = inside && angle >= low - 16 && angle <= high + 16;
                slow = slow && abs(rate) <= peak + 16;
                smooth = smooth && llabs((int64_t)(next - angle) * 1000 - rate) < 150000;
            }
            CHECK(inside);
            CHECK(slow);
            CHECK(smooth);
        }
    }
}

void test_ramp(void)
{
    ends_are_exact();
    linear_is_a_straight_line();
    minimum_jerk_has_its_textbook_shape();
    minimum_jerk_starts_at_the_given_speed();
    bounds_hold();
}
