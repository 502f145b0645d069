#include "hpac_servo.h"

#include "hpac_frame.h"

#define URAD_PER_RAD 1000000
/* What the wire can say, and 100 rad/s. */
#define URAD_MAX (INT16_MAX * HPAC_ANGLE_UNIT_URAD)
#define URAD_S_MAX 100000000

static int64_t pulse(const hpac_servo_t *servo, int64_t urad)
{
    int64_t scaled = (urad - servo->centre_urad) * servo->ns_per_rad;
    int64_t half = scaled < 0 ? -URAD_PER_RAD / 2 : URAD_PER_RAD / 2;
    return servo->centre_ns + servo->trim_ns + servo->direction * ((scaled + half) / URAD_PER_RAD);
}

static bool admissible(int64_t ns) { return ns >= HPAC_PULSE_MIN_NS && ns <= HPAC_PULSE_MAX_NS; }

bool hpac_servo_usable(const hpac_servo_t *servo)
{
    bool bounded = servo->min_urad >= -URAD_MAX && servo->max_urad <= URAD_MAX && servo->rate_urad_s <= URAD_S_MAX
                   && servo->trim_ns >= HPAC_TRIM_MIN_NS && servo->trim_ns <= HPAC_TRIM_MAX_NS;
    bool ordered = servo->min_urad < servo->max_urad && servo->min_urad <= servo->rest_urad
                   && servo->rest_urad <= servo->max_urad && servo->rate_urad_s > 0 && servo->ns_per_rad > 0
                   && (servo->direction == 1 || servo->direction == -1);
    return bounded && ordered && admissible(pulse(servo, servo->min_urad)) && admissible(pulse(servo, servo->max_urad));
}

bool hpac_servo_all_usable(const hpac_servo_t table[HPAC_SERVOS])
{
    bool usable = true;
    for (int i = 0; i < HPAC_SERVOS; i++) {
        usable = usable && hpac_servo_usable(&table[i]);
    }
    return usable;
}

uint32_t hpac_servo_pulse(const hpac_servo_t *servo, int32_t urad) { return (uint32_t)pulse(servo, urad); }

#define HASHED_CONSTANTS 9
#define HASHED_COLUMNS 9

uint32_t hpac_servo_hash(const hpac_servo_t table[HPAC_SERVOS])
{
    uint8_t bytes[4 * (HASHED_CONSTANTS + HASHED_COLUMNS * HPAC_SERVOS)];
    const int32_t constants[HASHED_CONSTANTS] = {
        (int32_t)HPAC_VERSION,     HPAC_PULSE_PERIOD_NS,   HPAC_PULSE_MIN_NS,         HPAC_PULSE_MAX_NS,   
        HPAC_ANGLE_TOLERANCE_URAD, HPAC_TIME_TOLERANCE_US, HPAC_RATE_EXCESS_PERMILLE, HPAC_STEP_MAX_MS, HPAC_RELAX_PERMILLE,
    };
    size_t at = 0;
    for (int i = 0; i < HASHED_CONSTANTS; i++, at += 4) {
        hpac_put_u32(bytes + at, (uint32_t)constants[i]);
    }
    for (int i = 0; i < HPAC_SERVOS; i++) {
        const hpac_servo_t *s = &table[i];
        const int32_t row[HASHED_COLUMNS] = { s->min_urad,   s->max_urad,  s->rest_urad, s->centre_urad, s->rate_urad_s,
                                              s->ns_per_rad, s->centre_ns, s->trim_ns,   s->direction };
        for (int column = 0; column < HASHED_COLUMNS; column++, at += 4) {
            hpac_put_u32(bytes + at, (uint32_t)row[column]);
        }
    }
    return hpac_crc32(bytes, at);
}
