/* Six servo pulses: from the chip's LEDC timers (servo_pwm.c), or from a PCA9685 (servo_pca9685.c), as pins.h says. */
#ifndef SERVO_OUTPUT_H
#define SERVO_OUTPUT_H

#include <stdbool.h>
#include <stdint.h>

#include "hpac_protocol.h"

/* One step of the pulse width is this much [ns], rounded up. */
uint32_t servo_output_step_ns(void);

/* Make sure that no pulse leaves, before anything else is done. */
void servo_output_quiet(void);

/* Start, all outputs low. Returns the time at which the first period started [us]. */
int64_t servo_output_start(void);

/* Set six widths [ns], 0 for none; all of them take effect together at the start of the next period. False if they could
 * not be set: then there are no pulses. */
bool servo_output_write(const uint32_t pulses[HPAC_SERVOS]);

#endif
