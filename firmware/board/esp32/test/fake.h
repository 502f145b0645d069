/* A chip that is not there: time, ports, pins, LEDC, ADC, I2C with a PCA9685 on it, as far as the port sees them. */
#ifndef FAKE_H
#define FAKE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "esp_system.h"
#include "hpac_protocol.h"

typedef struct {
    uint32_t set, pending, output; /* duty: as set, as handed over, as it leaves the pin since the last period's start */
    int pin;
    bool configured;
    int64_t changed_us; /* when the output last changed */
} fake_channel_t;

typedef struct {
    int64_t now_us, period_start_us;
    unsigned bits;
    uint32_t hz;
    fake_channel_t channels[HPAC_SERVOS];
    unsigned writes; /* of all six duties, or transfers over I2C */
    esp_reset_reason_t reset;
    uint32_t watchdog_ms;
    int64_t fed_us, longest_unfed_us;
    bool watched;
    int errors; /* failed ESP_ERROR_CHECKs, and calls that the real chip would refuse or that would wait */
    uint32_t level[64];
    int64_t level_us[64]; /* when it last changed */
    bool i2c_failed, enabled_blind; /* the bus failed last; the PCA9685's outputs were enabled after that */
    bool of_gpio[64], output[64], pulled_up[64], input[64];
    uint64_t glitches;  /* pins that drove a high level the moment they became outputs */
    int tx_pin, rx_pin; /* of UART0; -1: not routed, deaf */
    bool usb, uart_installed, uart_set;
    int adc_channel, supply_mv;
    bool adc_broken;
    uint8_t i2c[256];      /* the PCA9685's registers */
    int64_t woke_us;       /* its oscillator needs 0.5 ms */
    int i2c_faults;        /* so many transfers from now on fail */
    int i2c_flips;         /* so many writes from now on arrive with one bit wrong */
    size_t fifo;           /* bytes that wait in the UART */
    bool pll_off;          /* the clock is the ROM's again */
    bool restarted;        /* with all peripherals */
    bool unread;           /* nobody reads the USB: its driver takes nothing */
    uint8_t sent[16384];
    size_t sent_length;
} fake_t;

extern fake_t fake;

/* Run app_main() from reset for `ms`; it comes back by a jump out of vTaskDelay(). Memory that a reset keeps is kept. */
void fake_boot(esp_reset_reason_t reset, void (*every_ms)(int ms), int ms);

/* Give the port bytes to receive. */
void fake_receive(const uint8_t *bytes, size_t length);

/* The pulse that leaves channel i now [ns], whatever makes it; 0 for none. */
double fake_pulse_ns(int i);

#endif
