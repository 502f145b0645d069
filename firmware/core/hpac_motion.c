#include "hpac_motion.h"

#include "hpac_load.h"

#define US_PER_MS 1000
#define US_PER_S 1000000
#define NRAD_PER_URAD 1000
/* The minimum-jerk polynomial is evaluated with 30 fractional bits: its roundings stay below this. */
#define ROUNDING_URAD 16
/* No motion's state is computed with beyond these: speed over the rate limit, duration of a move. */
#define SPEED_MARGIN_URAD_S 1000000
#define DURATION_MAX_US ((HPAC_MOVE_MAX_MS + HPAC_WATCHDOG_MAX_MS) * US_PER_MS)

static const hpac_servo_t *limits_of(const hpac_hand_t *hand, unsigned servo) { return &hand->config->servo[servo]; }

static bool within(const hpac_servo_t *servo, int64_t urad) { return urad >= servo->min_urad && urad <= servo->max_urad; }

static int64_t magnitude(int64_t value) { return value < 0 ? -value : value; }

int32_t hpac_motion_angle(const hpac_hand_t *hand, unsigned servo)
{
    const hpac_servo_t *limits = limits_of(hand, servo);
    int32_t urad = hpac_ramp_angle(&hand->ramp, servo);
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
    int64_t share = magnitude(part) * 1000 / whole;
    return (uint32_t)(share < 1000 ? share : 1000);
}

uint32_t hpac_motion_effort(const hpac_hand_t *hand, unsigned servo)
{
    const hpac_servo_t *limits = limits_of(hand, servo);
    if ((hand->attached & (1u << servo)) == 0u) {
        return 0;
    }
    int64_t travel = (int64_t)hpac_motion_angle(hand, servo) - limits->rest_urad;
    int64_t speed = hpac_ramp_speed(&hand->ramp, servo);
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

bool hpac_motion_sound(const hpac_hand_t *hand)
{
    const hpac_ramp_t *ramp = &hand->ramp;
    uint32_t relax_us = hpac_motion_relax_max_us(hand);
    bool sound = ramp->duration_us <= (relax_us > DURATION_MAX_US ? relax_us : DURATION_MAX_US);
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        const hpac_servo_t *limits = limits_of(hand, i);
        sound = sound && within(limits, ramp->from[i]) && within(limits, ramp->to[i])
                && magnitude(ramp->from_speed[i]) <= (int64_t)limits->rate_urad_s + SPEED_MARGIN_URAD_S;
    }
    return sound;
}

void hpac_motion_stand(hpac_hand_t *hand, const int32_t pose[HPAC_SERVOS])
{
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        const hpac_servo_t *limits = limits_of(hand, i);
        int32_t least = pose[i] > limits->min_urad ? pose[i] : limits->min_urad;
        hand->pose[i] = least < limits->max_urad ? least : limits->max_urad;
    }
    hpac_ramp_rest(&hand->ramp, hand->pose);
}

static void pose_now(const hpac_hand_t *hand, int32_t pose[HPAC_SERVOS])
{
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        pose[i] = hpac_motion_angle(hand, i);
    }
}

void hpac_motion_stop(hpac_hand_t *hand)
{
    int32_t pose[HPAC_SERVOS];
    pose_now(hand, pose);
    hpac_ramp_rest(&hand->ramp, pose);
}

static hpac_ramp_t ramp_from_here(const hpac_hand_t *hand)
{
    hpac_ramp_t ramp = { .elapsed_us = 0 };
    pose_now(hand, ramp.from);
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        ramp.from_speed[i] = hpac_ramp_speed(&hand->ramp, i);
    }
    return ramp;
}

static uint32_t relax_us(const hpac_servo_t *limits, int64_t travel)
{
    int64_t us = magnitude(travel) * US_PER_S * 1000 / ((int64_t)limits->rate_urad_s * HPAC_RELAX_PERMILLE);
    return us < UINT32_MAX ? (uint32_t)us : UINT32_MAX;
}

uint32_t hpac_motion_relax_max_us(const hpac_hand_t *hand)
{
    uint32_t longest_us = 0;
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        const hpac_servo_t *limits = limits_of(hand, i);
        uint32_t down_us = relax_us(limits, (int64_t)limits->max_urad - limits->rest_urad);
        uint32_t up_us = relax_us(limits, (int64_t)limits->rest_urad - limits->min_urad);
        longest_us = down_us > longest_us ? down_us : longest_us;
        longest_us = up_us > longest_us ? up_us : longest_us;
    }
    return longest_us;
}

void hpac_motion_relax(hpac_hand_t *hand)
{
    hpac_ramp_t ramp = ramp_from_here(hand);
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        const hpac_servo_t *limits = limits_of(hand, i);
        ramp.to[i] = (hand->attached & (1u << i)) != 0u ? limits->rest_urad : ramp.from[i]; /* without pulses it stays */
        uint32_t us = relax_us(limits, (int64_t)ramp.to[i] - ramp.from[i]);
        ramp.duration_us = us > ramp.duration_us ? us : ramp.duration_us;
    }
    hand->ramp = ramp;
}

bool hpac_motion_at_rest(const hpac_hand_t *hand)
{
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        if (hpac_motion_angle(hand, i) != limits_of(hand, i)->rest_urad) {
            return false;
        }
    }
    return true;
}

void hpac_motion_place(hpac_hand_t *hand, unsigned servo)
{
    const hpac_servo_t *limits = limits_of(hand, servo);
    if (limits->holds_unpowered == 0) {
        hand->pose[servo] = limits->rest_urad;
        hpac_ramp_rest(&hand->ramp, hand->pose);
    }
}

uint32_t hpac_motion_start_us(const hpac_hand_t *hand, unsigned servo)
{
    const hpac_servo_t *limits = limits_of(hand, servo);
    bool known = (hand->placed & (1u << servo)) != 0u;
    int64_t travel = known ? (int64_t)hpac_motion_angle(hand, servo) - limits->rest_urad
                           : (int64_t)limits->max_urad - limits->min_urad;
    return (uint32_t)(HPAC_START_SETTLE_MS * US_PER_MS + magnitude(travel) * US_PER_S / HPAC_START_SPEED_URAD_S);
}

/* --- the rate limit: a credit per servo, in nrad, that time fills and travel uses up ---------------------------------- */

/* The most that the credit can be: the stated tolerances. */
static int64_t credit_max(const hpac_servo_t *limits)
{
    return (int64_t)limits->rate_urad_s * HPAC_TIME_TOLERANCE_US / (US_PER_S / NRAD_PER_URAD)
           + (int64_t)HPAC_ANGLE_TOLERANCE_URAD * NRAD_PER_URAD;
}

/* The credit of one servo now, before it is cut to its most: what the last output left, plus what time has brought
 * since, less the way to the present angle. */
static int64_t credit_now(const hpac_hand_t *hand, unsigned servo)
{
    const hpac_servo_t *limits = limits_of(hand, servo);
    int64_t left = hand->credit_nrad[servo] < credit_max(limits) ? hand->credit_nrad[servo] : credit_max(limits);
    int64_t step_us = hand->step_us < HPAC_STEP_MAX_MS * US_PER_MS ? hand->step_us : HPAC_STEP_MAX_MS * US_PER_MS;
    int64_t filled = limits->rate_urad_s * step_us * (1000 + HPAC_RATE_EXCESS_PERMILLE) / US_PER_S;
    int64_t used = magnitude((int64_t)hpac_motion_angle(hand, servo) - hand->pose[servo]) * NRAD_PER_URAD;
    return left + filled - used;
}

/* The fastest that a move of this duration may be: the limit, and the credit [nrad] spread over it. */
static int64_t admissible_speed(int64_t rate_urad_s, int64_t credit, int64_t duration_us)
{
    return rate_urad_s + (credit > 0 ? credit : 0) * (US_PER_S / NRAD_PER_URAD) / duration_us;
}

static hpac_reason_t judge_servo(const hpac_hand_t *hand, const hpac_ramp_t *ramp, unsigned i)
{
    const hpac_servo_t *limits = limits_of(hand, i);
    if (!within(limits, ramp->to[i]) || !within(limits, hpac_ramp_turning_angle(ramp, i))) {
        return HPAC_REASON_ANGLE;
    }
    int64_t peak = hpac_ramp_peak_speed(ramp, i);
    int64_t credit = credit_now(hand, i) < credit_max(limits) ? credit_now(hand, i) : credit_max(limits);
    if (peak > admissible_speed(limits->rate_urad_s, credit, ramp->duration_us)) {
        return HPAC_REASON_RATE;
    }
    int64_t derated = (int64_t)limits->rate_urad_s * hpac_load_rate_permille(hand->heat[i]) / 1000;
    return peak > admissible_speed(derated, credit, ramp->duration_us) ? HPAC_REASON_HOT : HPAC_REASON_OK;
}

hpac_reason_t hpac_motion_move(hpac_hand_t *hand, const uint8_t *payload, uint8_t flags, uint8_t *servo)
{
    uint16_t duration_ms = hpac_get_u16(payload + HPAC_MOVE_AT_DURATION_MS);
    if (duration_ms < HPAC_MOVE_MIN_MS || duration_ms > HPAC_MOVE_MAX_MS) {
        return HPAC_REASON_DURATION;
    }
    hpac_ramp_t ramp = ramp_from_here(hand);
    /* What late ticks have held back is not caught up with by going faster: this move ends later by as much. */
    uint32_t behind_us = hand->behind_us < HPAC_WATCHDOG_MAX_MS * US_PER_MS ? hand->behind_us : HPAC_WATCHDOG_MAX_MS * US_PER_MS;
    ramp.duration_us = (uint32_t)duration_ms * US_PER_MS + behind_us;
    ramp.minimum_jerk = (flags & HPAC_FLAG_MINIMUM_JERK) != 0u;
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        ramp.to[i] = hpac_get_i16(payload + HPAC_MOVE_AT_SERVO + 2 * i) * HPAC_ANGLE_UNIT_URAD;
        hpac_reason_t reason = judge_servo(hand, &ramp, i);
        if (reason != HPAC_REASON_OK) {
            *servo = (uint8_t)i;
            return reason;
        }
    }
    hand->ramp = ramp;
    return HPAC_REASON_OK;
}

bool hpac_motion_output(hpac_hand_t *hand, unsigned *servo)
{
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        *servo = i;
        if (!within(limits_of(hand, i), hpac_motion_angle(hand, i))
            || credit_now(hand, i) < -(int64_t)ROUNDING_URAD * NRAD_PER_URAD) {
            return false;
        }
    }
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        int64_t most = credit_max(limits_of(hand, i));
        int64_t credit = credit_now(hand, i);
        hand->credit_nrad[i] = (int32_t)(credit < most ? credit : most);
        hand->pose[i] = hpac_motion_angle(hand, i);
    }
    hand->step_us = 0;
    return true;
}
