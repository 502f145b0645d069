/* The board around the servos: command port, servo supply, e-stop input, as loop.h asks for them. Pins stand in pins.h. */
#ifndef BOARD_H
#define BOARD_H

#include "loop.h"

/* Make a pin an output at this level, which it has from its first moment on. It may have woken up as something else: pins 4
 * to 7 of a C3 are JTAG's until gpio_config() selects their GPIO function, which gpio_set_direction() does not. */
void board_output(int pin, uint32_t level);

/* Servo supply off, before anything else is done. */
void board_quiet(void);

/* The end of a panic: servo supply off, OE high, then a reset of the peripherals, too. */
void __wrap_esp_restart_noos(void) __attribute__((noreturn));

/* Open the command port, and what pins.h says is there. */
void board_start(void);

#endif
