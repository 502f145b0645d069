#include "hpac_motion.h"

#include "hpac_load.h"

#define US_PER_MS 1000
#define US_PER_S 1000000
#define URAD_PER_STEP 100
/* The minimum-jerk polynomial is evaluated with 30 fractional bits: its roundings stay below this. */
#define ROUNDING_URAD 16

static bool within(const hpac_servo_t *servo, int64_t urad) { return urad >= servo->min_urad && urad <= servo->max_urad; }

int32_t hpac_motion_angle(const hpac_hand_t *hand, unsigned servo)
{
    const hpac_servo_t *limits = &hand->config.servo[servo];
    int32_t urad = hpac_ramp_angle(&hand->ramp, (int)servo, hand->now_us);
    if (urad < limits->min_urad && urad >= limits->min_urad - ROUNDING_URAD) {
        return limits->min_urad;
    }
    if (urad > limits->max_urad && urad <= limits->max_urad + ROUNDING_URAD) {
        return limits->max_urad;
    }
    return urad;
}

static uint32_t permille(int64_t part, int64_t whole)
{
    int64_t share = (part < 0 ? -part : part) * 1000 / whole;
    return (uint32_t)(share < 1000 ? share : 1000);
}

uint32_t hpac_motion_effort(const hpac_hand_t *hand, unsigned servo)
{
    const hpac_servo_t *limits = &hand->config.servo[servo];
    if ((hand->attached & (1u << servo)) == 0u) {
        return 0;
    }
    int64_t travel = (int64_t)hpac_motion_angle(hand, servo) - limits->rest_urad;
    int64_t speed = hpac_ramp_speed(&hand->ramp, (int)servo, hand->now_us);
    return hpac_load_effort(permille(travel, (int64_t)limits->max_urad - limits->min_urad),
                            permille(speed, limits->rate_urad_s));
}

uint16_t hpac_motion_rate_permille(const hpac_hand_t *hand)
{
    uint16_t least = 1000;
    for (int i = 0; i < HPAC_SERVOS; i++) {
        uint16_t rate = hpac_load_rate_permille(hand->heat[i]);
        least = rate < least ? rate : least;
    }
    return least;
}

void hpac_motion_rest(hpac_hand_t *hand)
{
    int32_t rest[HPAC_SERVOS];
    for (int i = 0; i < HPAC_SERVOS; i++) {
        rest[i] = hand->config.servo[i].rest_urad;
    }
    hpac_ramp_rest(&hand->ramp, rest);
}

void hpac_motion_stop(hpac_hand_t *hand)
{
    int32_t pose[HPAC_SERVOS];
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        pose[i] = hpac_motion_angle(hand, i);
    }
    hpac_ramp_rest(&hand->ramp, pose);
}

static hpac_ramp_t ramp_from_here(const hpac_hand_t *hand)
{
    hpac_ramp_t ramp = { .start_us = hand->now_us };
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        ramp.from[i] = hpac_motion_angle(hand, i);
        ramp.from_speed[i] = hpac_ramp_speed(&hand->ramp, (int)i, hand->now_us);
    }
    return ramp;
}

void hpac_motion_relax(hpac_hand_t *hand)
{
    hpac_ramp_t ramp = ramp_from_here(hand);
    int64_t longest_us = 0;
    for (int i = 0; i < HPAC_SERVOS; i++) {
        const hpac_servo_t *servo = &hand->config.servo[i];
        ramp.to[i] = servo->rest_urad;
        int64_t travel = (int64_t)ramp.to[i] - ramp.from[i];
        int64_t us = (travel < 0 ? -travel : travel) * US_PER_S * 1000 / ((int64_t)servo->rate_urad_s * HPAC_RELAX_PERMILLE);
        longest_us = us > longest_us ? us : longest_us;
    }
    ramp.duration_us = longest_us < UINT32_MAX ? (uint32_t)longest_us : UINT32_MAX;
    hand->ramp = ramp;
}

/* The fastest that a move of this duration may be: the limit, with room for the wire's roundings. */
static int64_t admissible_speed(int64_t rate_urad_s, int64_t duration_us)
{
    int64_t distance = rate_urad_s * (duration_us + HPAC_TIME_TOLERANCE_US) / US_PER_S + HPAC_ANGLE_TOLERANCE_URAD;
    return distance * US_PER_S / duration_us;
}

static hpac_reason_t judge_servo(const hpac_hand_t *hand, const hpac_ramp_t *ramp, int i)
{
    const hpac_servo_t *servo = &hand->config.servo[i];
    if (!within(servo, ramp->to[i]) || !within(servo, hpac_ramp_turning_angle(ramp, i))) {
        return HPAC_REASON_ANGLE;
    }
    int64_t peak = hpac_ramp_peak_speed(ramp, i);
    if (peak > admissible_speed(servo->rate_urad_s, ramp->duration_us)) {
        return HPAC_REASON_RATE;
    }
    int64_t derated = (int64_t)servo->rate_urad_s * hpac_load_rate_permille(hand->heat[i]) / 1000;
    return peak > admissible_speed(derated, ramp->duration_us) ? HPAC_REASON_HOT : HPAC_REASON_OK;
}

hpac_reason_t hpac_motion_move(hpac_hand_t *hand, const uint8_t *payload, uint8_t flags, uint8_t *servo)
{
    uint16_t duration_ms = hpac_get_u16(payload + HPAC_MOVE_AT_DURATION_MS);
    if (duration_ms < HPAC_MOVE_MIN_MS || duration_ms > HPAC_MOVE_MAX_MS) {
        return HPAC_REASON_DURATION;
    }
    hpac_ramp_t ramp = ramp_from_here(hand);
    ramp.duration_us = (uint32_t)duration_ms * US_PER_MS;
    ramp.minimum_jerk = (flags & HPAC_FLAG_MINIMUM_JERK) != 0u;
    for (int i = 0; i < HPAC_SERVOS; i++) {
        ramp.to[i] = hpac_get_i16(payload + HPAC_MOVE_AT_SERVO + 2 * i) * URAD_PER_STEP;
        hpac_reason_t reason = judge_servo(hand, &ramp, i);
        if (reason != HPAC_REASON_OK) {
            *servo = (uint8_t)i;
            return reason;
        }
    }
    hand->ramp = ramp;
    return HPAC_REASON_OK;
}
