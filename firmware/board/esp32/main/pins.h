/* Everything that your wiring and your copy of the hand decide. Change it, build, then `hpac wiggle` shows whether names and
 * fingers agree. The wiring list in README.md says what belongs on each pin.
 *
 * Servo order: thumb_mp, index_mcp, middle_mcp, ring_mcp, pinky_mcp, thumb_cmc. None of the pins below takes part in
 * booting (strapping), in flash or PSRAM (WROVER and octal S3 modules included), in native USB, or is an input only. */
#ifndef PINS_H
#define PINS_H

#include "sdkconfig.h"

#define NO_PIN (-1)

#if CONFIG_IDF_TARGET_ESP32
#define SERVO_PINS { 18, 19, 21, 22, 23, 25 }
#define SUPPLY_SWITCH_PIN 26
#define UART_TX_PIN 1
#define UART_RX_PIN 3
/* free for ESTOP_PIN: 27, 32, 33; for SUPPLY_ADC_CHANNEL: 6 (GPIO34) */
#elif CONFIG_IDF_TARGET_ESP32S3
#define SERVO_PINS { 4, 5, 6, 7, 15, 16 }
#define SUPPLY_SWITCH_PIN 17
#define UART_TX_PIN 43
#define UART_RX_PIN 44
/* free for ESTOP_PIN: 18, 21; for SUPPLY_ADC_CHANNEL: 0 (GPIO1) */
#elif CONFIG_IDF_TARGET_ESP32C6
#define SERVO_PINS { 18, 19, 20, 21, 22, 23 }
#define SUPPLY_SWITCH_PIN 10
#define UART_TX_PIN 16
#define UART_RX_PIN 17
/* free for ESTOP_PIN: 11, 2, 3; for SUPPLY_ADC_CHANNEL: 0 (GPIO0) */
#elif CONFIG_IDF_TARGET_ESP32C3
#define SERVO_PINS { 3, 4, 5, 6, 7, 10 }
#define SUPPLY_SWITCH_PIN 1
#define UART_TX_PIN 21
#define UART_RX_PIN 20
/* free for ESTOP_PIN or SUPPLY_ADC_CHANNEL: 0 (GPIO0); for more, put the servos on a PCA9685 */
#else
#error "pins.h knows ESP32, ESP32-S3, ESP32-C6 and ESP32-C3: add the pins of your chip"
#endif

/* 1: the command port is the chip's own USB (USB Serial/JTAG: C3, S3, C6), for boards without a USB bridge on UART0. */
#ifndef PORT_IS_USB
#define PORT_IS_USB 0
#endif

/* A normally closed contact to ground: pressed, unplugged and broken all read the same. NO_PIN: there is none. */
#ifndef ESTOP_PIN
#define ESTOP_PIN NO_PIN
#endif

/* The channel of ADC1 that reads the servo supply, in front of its switch, through a divider; NO_PIN: not measured.
 * SUPPLY_PER_MILLE is the supply over the pin's voltage: 1000 * (20 kOhm + 10 kOhm) / 10 kOhm. Correct it by a multimeter. */
#ifndef SUPPLY_ADC_CHANNEL
#define SUPPLY_ADC_CHANNEL NO_PIN
#endif
#define SUPPLY_PER_MILLE 3000

/* 1: the servos hang on a PCA9685 board, channels 0 to 5, instead of on SERVO_PINS. */
#ifndef SERVOS_ON_PCA9685
#define SERVOS_ON_PCA9685 0
#endif
#define PCA9685_ADDRESS 0x40
#define PCA9685_CLOCK_HZ 25000000 /* its oscillator is off by up to some percent: measure the period and correct this */
/* OE is pulled up to VCC, 3.3 V, against the pull-down of most boards (README.md): no pulses unless driven low. */
#if CONFIG_IDF_TARGET_ESP32
#define PCA9685_SDA_PIN 21
#define PCA9685_SCL_PIN 22
#define PCA9685_OE_PIN 19
#elif CONFIG_IDF_TARGET_ESP32C6
#define PCA9685_SDA_PIN 18
#define PCA9685_SCL_PIN 19
#define PCA9685_OE_PIN 20
#else
#define PCA9685_SDA_PIN 5
#define PCA9685_SCL_PIN 6
#define PCA9685_OE_PIN 7
#endif

/* What a servo does without pulses: 0, the springs open it, so that its first pulse is at rest and can pinch nothing; 1, it
 * keeps its angle, so that its first pulse is at its last commanded one. docs/first_hour.md has the step that decides it. */
#ifndef SERVOS_HOLD_UNPOWERED
#define SERVOS_HOLD_UNPOWERED 0
#endif

/* Zero trims, -32768 to 32767 [ns], added to every pulse, and directions, -1 for a servo mounted the other way round. */
#ifndef SERVO_TRIMS_NS
#define SERVO_TRIMS_NS 0, 0, 0, 0, 0, 0
#endif
#ifndef SERVO_DIRECTIONS
#define SERVO_DIRECTIONS 1, 1, 1, 1, 1, 1
#endif

#endif
