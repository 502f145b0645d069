/* The board around the servos: command port, servo supply, e-stop input. Pins stand in pins.h. */
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Make a pin an output at this level, which it has from its first moment on. It may have woken up as something else: pins 4
 * to 7 of a C3 are JTAG's until gpio_config() selects their GPIO function, which gpio_set_direction() does not. */
void board_output(int pin, uint32_t level);

/* Servo supply off, before anything else is done. */
void board_quiet(void);

/* Open the command port, and what pins.h says is there. */
void board_start(void);

/* Take what has come in, up to `capacity` bytes; never waits. Returns how many. */
size_t board_read(uint8_t *bytes, size_t capacity);

/* How many bytes may be written without waiting, and write them. */
size_t board_room(void);
void board_write(const uint8_t *bytes, size_t length);

/* Switch the servo supply. */
void board_power(bool on);

/* The e-stop input; false if there is none. */
bool board_estop_pressed(void);

/* The servo supply in front of its switch [mV]; 0 if it is not measured. */
uint16_t board_supply_mv(void);

#endif
