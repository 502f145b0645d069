/* Six servo pulses from the LEDC peripheral. */
#ifndef SERVO_PWM_H
#define SERVO_PWM_H

#include <stdbool.h>
#include <stdint.h>

#include "hpac_protocol.h"

/* Resolution of the timer: the finest that the chip has among those that divide its 80 MHz clock to exactly 50 Hz.
 * 17 bits where 20 are to be had (ESP32, C6), 14 elsewhere (C3, S2, S3). With an inexact divider every pulse would be
 * wrong by up to 0.1 %, ten steps of the resolution that it wins. */
unsigned servo_pwm_bits(void);

/* Duty for a pulse of this width, rounded to the nearest step. */
uint32_t servo_pwm_duty(uint32_t pulse_ns);

/* Start the timer, all outputs low. Returns the time at which the first period started [us]. */
int64_t servo_pwm_start(void);

/* Set six widths; all of them take effect together at the start of the next period. */
void servo_pwm_write(const uint32_t pulses[HPAC_SERVOS]);

#endif
