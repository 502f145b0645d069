/* A chip that is not there: time, UART and LEDC as far as the port sees them. */
#ifndef FAKE_H
#define FAKE_H

#include <stddef.h>
#include <stdint.h>

#include "esp_system.h"
#include "hpac_protocol.h"

typedef struct {
    uint32_t set, pending, output; /* duty: as set, as handed over, as it leaves the pin since the last period's start */
    int pin;
    int64_t changed_us; /* when the output last changed */
} fake_channel_t;

typedef struct {
    int64_t now_us, period_start_us;
    unsigned bits;
    uint32_t hz;
    fake_channel_t channels[HPAC_SERVOS];
    esp_reset_reason_t reset;
    uint32_t watchdog_ms;
    int64_t fed_us, longest_unfed_us;
    int errors; /* failed ESP_ERROR_CHECKs */
} fake_t;

extern fake_t fake;

/* Run app_main() from reset for `ms`; it comes back by a jump out of vTaskDelay(). */
void fake_boot(esp_reset_reason_t reset, void (*every_ms)(int ms), int ms);

/* Give the UART bytes to receive. */
void fake_receive(const uint8_t *bytes, size_t length);

/* How many bytes the port has sent since reset. */
size_t fake_sent(void);

#endif
