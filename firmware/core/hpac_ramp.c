#include "hpac_ramp.h"

#define US_PER_S 1000000

/* Share of the move that has passed, 30 fractional bits. */
#define SHARE_BITS 30

void hpac_ramp_rest(hpac_ramp_t *ramp, const int32_t pose[HPAC_SERVOS])
{
    *ramp = (hpac_ramp_t){ .duration_us = 0 };
    for (int i = 0; i < HPAC_SERVOS; i++) {
        ramp->from[i] = pose[i];
        ramp->to[i] = pose[i];
    }
}

bool hpac_ramp_moving(const hpac_ramp_t *ramp) { return ramp->elapsed_us < ramp->duration_us; }

void hpac_ramp_advance(hpac_ramp_t *ramp, uint32_t us)
{
    uint32_t left = hpac_ramp_moving(ramp) ? ramp->duration_us - ramp->elapsed_us : 0u;
    ramp->elapsed_us += us < left ? us : left;
}

static int64_t travel(const hpac_ramp_t *ramp, unsigned servo) { return (int64_t)ramp->to[servo] - ramp->from[servo]; }

/* How far the servo would go in the whole move at its first speed. */
static int64_t coast(const hpac_ramp_t *ramp, unsigned servo)
{
    return (int64_t)ramp->from_speed[servo] * (int64_t)ramp->duration_us / US_PER_S;
}

static int64_t share_of(const hpac_ramp_t *ramp)
{
    return (int64_t)(((uint64_t)ramp->elapsed_us << SHARE_BITS) / ramp->duration_us);
}

static int64_t scaled(int64_t value, int64_t share) { return value * share / ((int64_t)1 << SHARE_BITS); }

int32_t hpac_ramp_angle(const hpac_ramp_t *ramp, unsigned servo)
{
    if (!hpac_ramp_moving(ramp)) {
        return ramp->to[servo];
    }
    int64_t d = travel(ramp, servo);
    if (!ramp->minimum_jerk) {
        return (int32_t)(ramp->from[servo] + d * (int64_t)ramp->elapsed_us / (int64_t)ramp->duration_us);
    }
    /* The quintic from (angle, speed, no acceleration) to (target, at rest, no acceleration), by Horner's rule:
     * x = v s + (10 d - 6 v) s^3 + (8 v - 15 d) s^4 + (6 d - 3 v) s^5, with s from 0 to 1 and v the coast. */
    int64_t v = coast(ramp, servo);
    int64_t s = share_of(ramp);
    int64_t x = 6 * d - 3 * v;
    x = scaled(x, s) + 8 * v - 15 * d;
    x = scaled(x, s) + 10 * d - 6 * v;
    x = scaled(scaled(x, s), s) + v;
    return (int32_t)(ramp->from[servo] + scaled(x, s));
}

int32_t hpac_ramp_speed(const hpac_ramp_t *ramp, unsigned servo)
{
    if (!hpac_ramp_moving(ramp)) {
        return 0;
    }
    int64_t d = travel(ramp, servo);
    int64_t per_move = d;
    if (ramp->minimum_jerk) {
        int64_t v = coast(ramp, servo);
        int64_t s = share_of(ramp);
        int64_t x = 5 * (6 * d - 3 * v);
        x = scaled(x, s) + 4 * (8 * v - 15 * d);
        x = scaled(x, s) + 3 * (10 * d - 6 * v);
        per_move = scaled(scaled(x, s), s) + v;
    }
    return (int32_t)(per_move * US_PER_S / (int64_t)ramp->duration_us);
}

static int64_t magnitude(int64_t value) { return value < 0 ? -value : value; }

int64_t hpac_ramp_peak_speed(const hpac_ramp_t *ramp, unsigned servo)
{
    int64_t d = travel(ramp, servo);
    int64_t per_move = magnitude(d);
    if (ramp->minimum_jerk) {
        /* As a Bezier curve the speed is v (B0 + B1) + (5 d - 2 v) B2, and B2 is at most 3/8. */
        int64_t v = coast(ramp, servo);
        per_move = magnitude(v) + magnitude(5 * d - 2 * v) * 3 / 8;
    }
    return per_move * US_PER_S / (int64_t)ramp->duration_us;
}

int64_t hpac_ramp_turning_angle(const hpac_ramp_t *ramp, unsigned servo)
{
    /* The Bezier curve's control points are from, from + v/5, from + 2v/5, to, to, to; it stays within their span. */
    return ramp->from[servo] + (ramp->minimum_jerk ? 2 * coast(ramp, servo) / 5 : 0);
}
