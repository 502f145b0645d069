/* The pins of pins.h are free on their chip and different. Compiled once a chip, output and pin that README.md calls free. */
#include <stdio.h>

#include "pins.h"

/* booting, flash, PSRAM, native USB, UART0, inputs only, and pins that the chip does not have (data sheets) */
#if CONFIG_IDF_TARGET_ESP32
#define FORBIDDEN { 0, 2, 5, 12, 15, 6, 7, 8, 9, 10, 11, 16, 17, 20, 24, 28, 29, 30, 31, 34, 35, 36, 37, 38, 39, 1, 3 }
#elif CONFIG_IDF_TARGET_ESP32S3
#define FORBIDDEN { 0, 3, 45, 46, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33, 34, 35, 36, 37, 19, 20, 43, 44, 1 }
#elif CONFIG_IDF_TARGET_ESP32C6
#define FORBIDDEN { 4, 5, 8, 9, 15, 24, 25, 26, 27, 28, 29, 30, 12, 13, 14, 16, 17, 0 }
#else
#define FORBIDDEN { 2, 8, 9, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21 }
#endif

int main(void)
{
    static const int forbidden[] = FORBIDDEN; /* with the pin of the supply's ADC channel, except on C3 */
    static const int used[] = { SUPPLY_SWITCH_PIN, ESTOP_PIN, PCA9685_SDA_PIN, PCA9685_SCL_PIN, PCA9685_OE_PIN };
    static const int servos[] = SERVO_PINS;
    const int *outputs = SERVOS_ON_PCA9685 ? used + 2 : servos;
    const int count = 2 + (SERVOS_ON_PCA9685 ? 3 : 6);
    int failures = 0;
    for (int i = 0; i < count; i++) {
        const int pin = i < 2 ? used[i] : outputs[i - 2];
        for (size_t j = 0; j < sizeof forbidden / sizeof *forbidden; j++) {
            failures += pin == forbidden[j];
        }
        for (int j = 0; j < i; j++) {
            failures += pin == (j < 2 ? used[j] : outputs[j - 2]);
        }
    }
    if (failures) {
        printf("test_pins.c: target %d, PCA9685 %d, e-stop %d: %d pins are not free\n", STUB_TARGET, SERVOS_ON_PCA9685, ESTOP_PIN, failures);
    }
    return failures != 0;
}
