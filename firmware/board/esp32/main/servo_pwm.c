/* Resolution of the timer: the finest that the chip has among those that divide its 80 MHz clock to exactly 50 Hz.
 * 17 bits where 20 are to be had (ESP32, C6), 14 elsewhere (C3, S3). With an inexact divider every pulse would be wrong
 * by up to 0.1 %, ten steps of the resolution that it wins. */
#include "pins.h"
#include "servo_output.h"

#if !SERVOS_ON_PCA9685

#include "board.h"
#include "driver/ledc.h"
#include "esp_err.h"
#include "esp_timer.h"
#include "soc/soc_caps.h"

#define PWM_HZ (1000000000 / HPAC_PULSE_PERIOD_NS)
#define CLOCK_HZ 80000000u
#define DIVIDER_FRACTION 256u /* the timer's divider has 8 fractional bits */

#if SOC_LEDC_SUPPORT_APB_CLOCK
#define CLOCK_SOURCE LEDC_USE_APB_CLK
#else
#define CLOCK_SOURCE LEDC_USE_PLL_DIV_CLK
#endif

static const int pins[HPAC_SERVOS] = SERVO_PINS;

static unsigned timer_bits(void)
{
    unsigned bits = SOC_LEDC_TIMER_BIT_WIDTH;
    while ((uint64_t)CLOCK_HZ * DIVIDER_FRACTION % ((uint64_t)PWM_HZ << bits) != 0u) {
        bits--;
    }
    return bits;
}

static uint32_t duty(uint32_t pulse_ns)
{
    uint64_t scaled = (uint64_t)pulse_ns << timer_bits();
    return (uint32_t)((scaled + HPAC_PULSE_PERIOD_NS / 2) / HPAC_PULSE_PERIOD_NS);
}

void servo_output_quiet(void)
{
    for (int i = 0; i < HPAC_SERVOS; i++) {
        board_output(pins[i], 0);
    }
}

int64_t servo_output_start(void)
{
    ledc_timer_config_t timer = {
        .speed_mode = LEDC_LOW_SPEED_MODE,
        .duty_resolution = (ledc_timer_bit_t)timer_bits(),
        .timer_num = LEDC_TIMER_0,
        .freq_hz = PWM_HZ,
        .clk_cfg = CLOCK_SOURCE,
    };
    ESP_ERROR_CHECK(ledc_timer_config(&timer));
    for (int i = 0; i < HPAC_SERVOS; i++) {
        ledc_channel_config_t channel = {
            .gpio_num = pins[i],
            .speed_mode = LEDC_LOW_SPEED_MODE,
            .channel = (ledc_channel_t)i,
            .timer_sel = LEDC_TIMER_0,
            .duty = 0,
            .hpoint = 0,
        };
        ESP_ERROR_CHECK(ledc_channel_config(&channel));
    }
    ESP_ERROR_CHECK(ledc_timer_rst(LEDC_LOW_SPEED_MODE, LEDC_TIMER_0));
    return esp_timer_get_time();
}

bool servo_output_write(const uint32_t pulses[HPAC_SERVOS])
{
    for (int i = 0; i < HPAC_SERVOS; i++) {
        ESP_ERROR_CHECK(ledc_set_duty(LEDC_LOW_SPEED_MODE, (ledc_channel_t)i, duty(pulses[i])));
    }
    for (int i = 0; i < HPAC_SERVOS; i++) {
        ESP_ERROR_CHECK(ledc_update_duty(LEDC_LOW_SPEED_MODE, (ledc_channel_t)i));
    }
    return true;
}

#endif
