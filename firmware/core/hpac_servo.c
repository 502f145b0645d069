#include "hpac_servo.h"

#define URAD_PER_RAD 1000000

static int64_t pulse(const hpac_servo_t *servo, int64_t urad)
{
    int64_t scaled = (urad - servo->centre_urad) * servo->ns_per_rad;
    int64_t half = scaled < 0 ? -URAD_PER_RAD / 2 : URAD_PER_RAD / 2;
    return servo->centre_ns + servo->trim_ns + servo->direction * ((scaled + half) / URAD_PER_RAD);
}

static bool admissible(int64_t ns) { return ns >= HPAC_PULSE_MIN_NS && ns <= HPAC_PULSE_MAX_NS; }

bool hpac_servo_usable(const hpac_servo_t *servo)
{
    bool ordered = servo->min_urad < servo->max_urad && servo->min_urad <= servo->rest_urad
                   && servo->rest_urad <= servo->max_urad && servo->rate_urad_s > 0 && servo->ns_per_rad > 0
                   && (servo->direction == 1 || servo->direction == -1);
    return ordered && admissible(pulse(servo, servo->min_urad)) && admissible(pulse(servo, servo->max_urad));
}

uint32_t hpac_servo_pulse(const hpac_servo_t *servo, int32_t urad) { return (uint32_t)pulse(servo, urad); }
