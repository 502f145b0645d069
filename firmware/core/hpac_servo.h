/* One servo: its limits, and the pulse that stands for an angle. */
#ifndef HPAC_SERVO_H
#define HPAC_SERVO_H

#include <stdbool.h>
#include <stdint.h>

#include "hpac_protocol.h"

typedef struct {
    int32_t min_urad;
    int32_t max_urad;
    int32_t rest_urad;   /* where it is taken to be at power-on, and where relax goes */
    int32_t centre_urad; /* the angle of the pulse centre_ns */
    int32_t rate_urad_s;
    int32_t ns_per_rad;
    int32_t centre_ns;
    int32_t trim_ns;   /* zero trim of this copy of the hand, added to every pulse */
    int32_t direction; /* 1, or -1 for a servo mounted the other way round */
    int32_t holds_unpowered; /* 0: without pulses the springs take it to rest; 1: it keeps its angle */
} hpac_servo_t;

/* True if the limits are in order, the wire can say them, and every admissible angle has an admissible pulse. */
bool hpac_servo_usable(const hpac_servo_t *servo);
bool hpac_servo_all_usable(const hpac_servo_t table[HPAC_SERVOS]);

/* CRC-32 of the constants and the table that bound the output: the limits hash, byte by byte in docs/wire.md. */
uint32_t hpac_servo_hash(const hpac_servo_t table[HPAC_SERVOS]);

/* Width of the pulse for an angle [ns], rounded to the nearest. */
uint32_t hpac_servo_pulse(const hpac_servo_t *servo, int32_t urad);

#endif
