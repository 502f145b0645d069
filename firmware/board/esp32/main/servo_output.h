/* Six servo pulses: from the chip's LEDC timers (servo_pwm.c), or from a PCA9685 (servo_pca9685.c), as pins.h says;
 * servo_output_write() stands in loop.h. */
#ifndef SERVO_OUTPUT_H
#define SERVO_OUTPUT_H

#include "loop.h"

/* Make sure that no pulse leaves, before anything else is done. */
void servo_output_quiet(void);

/* Start, all outputs low. Returns the time at which the first period started [us]. */
int64_t servo_output_start(void);

#endif
