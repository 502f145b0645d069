#include "fake.h"

#include <setjmp.h>
#include <stdio.h>
#include <string.h>

#include "driver/ledc.h"
#include "driver/uart.h"
#include "esp_task_wdt.h"
#include "esp_timer.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"

void app_main(void);

fake_t fake;

static jmp_buf power_off;
static void (*script)(int ms);
static int ms_passed;
static int ms_in_all;
static uint8_t to_receive[1024];
static size_t to_receive_length;
static size_t sent_length;

void fake_boot(esp_reset_reason_t reset, void (*every_ms)(int ms), int ms)
{
    memset(&fake, 0, sizeof fake);
    fake.reset = reset;
    fake.now_us = 300000; /* the boot loader took its time */
    script = every_ms;
    ms_passed = 0;
    ms_in_all = ms;
    to_receive_length = 0;
    sent_length = 0;
    if (setjmp(power_off) == 0) {
        app_main();
    }
}

void fake_receive(const uint8_t *bytes, size_t length)
{
    memcpy(to_receive + to_receive_length, bytes, length);
    to_receive_length += length;
}

size_t fake_sent(void) { return sent_length; }

void stub_check(esp_err_t error, const char *what)
{
    if (error != ESP_OK) {
        fake.errors++;
        printf("failed: %s\n", what);
    }
}

esp_reset_reason_t esp_reset_reason(void) { return fake.reset; }

int64_t esp_timer_get_time(void) { return fake.now_us; }

/* Time passes here alone; at each start of a period the duties that were handed over reach the pins. */
void vTaskDelay(uint32_t ticks)
{
    for (uint32_t i = 0; i < ticks * 1000u; i++) {
        fake.now_us++;
        if (fake.hz != 0u && (fake.now_us - fake.period_start_us) % (1000000 / (int64_t)fake.hz) == 0) {
            for (int c = 0; c < HPAC_SERVOS; c++) {
                if (fake.channels[c].output != fake.channels[c].pending) {
                    fake.channels[c].output = fake.channels[c].pending;
                    fake.channels[c].changed_us = fake.now_us;
                }
            }
        }
    }
    if (fake.now_us - fake.fed_us > fake.longest_unfed_us) {
        fake.longest_unfed_us = fake.now_us - fake.fed_us;
    }
    if (++ms_passed > ms_in_all) {
        longjmp(power_off, 1);
    }
    script(ms_passed);
}

esp_err_t esp_task_wdt_reconfigure(const esp_task_wdt_config_t *config)
{
    fake.watchdog_ms = config->trigger_panic ? config->timeout_ms : 0u;
    return ESP_OK;
}

esp_err_t esp_task_wdt_add(void *task)
{
    fake.fed_us = fake.now_us;
    return task == NULL ? ESP_OK : ESP_FAIL;
}

esp_err_t esp_task_wdt_reset(void)
{
    fake.fed_us = fake.now_us;
    return ESP_OK;
}

esp_err_t uart_driver_install(int port, int rx_bytes, int tx_bytes, int queue_length, void *queue, int flags)
{
    (void)queue_length;
    (void)flags;
    return port == UART_NUM_0 && rx_bytes > 128 && tx_bytes > 128 && queue == NULL ? ESP_OK : ESP_FAIL;
}

esp_err_t uart_param_config(int port, const uart_config_t *config)
{
    return port == UART_NUM_0 && config->baud_rate == HPAC_BAUD ? ESP_OK : ESP_FAIL;
}

int uart_read_bytes(int port, void *buffer, uint32_t length, uint32_t ticks)
{
    (void)port;
    (void)ticks;
    size_t taken = to_receive_length < length ? to_receive_length : length;
    memcpy(buffer, to_receive, taken);
    to_receive_length -= taken;
    memmove(to_receive, to_receive + taken, to_receive_length);
    return (int)taken;
}

int uart_write_bytes(int port, const void *bytes, size_t length)
{
    (void)port;
    (void)bytes;
    sent_length += length;
    return (int)length;
}

esp_err_t uart_get_tx_buffer_free_size(int port, size_t *size)
{
    *size = 100;
    return port == UART_NUM_0 ? ESP_OK : ESP_FAIL;
}

esp_err_t ledc_timer_config(const ledc_timer_config_t *config)
{
    fake.bits = (unsigned)config->duty_resolution;
    fake.hz = config->freq_hz;
    return config->freq_hz == 50u && config->clk_cfg == LEDC_USE_APB_CLK ? ESP_OK : ESP_FAIL;
}

esp_err_t ledc_channel_config(const ledc_channel_config_t *config)
{
    fake.channels[config->channel].pin = config->gpio_num;
    return config->duty == 0u && config->timer_sel == LEDC_TIMER_0 ? ESP_OK : ESP_FAIL;
}

esp_err_t ledc_timer_rst(ledc_mode_t mode, ledc_timer_t timer)
{
    (void)mode;
    fake.period_start_us = fake.now_us;
    return timer == LEDC_TIMER_0 ? ESP_OK : ESP_FAIL;
}

esp_err_t ledc_set_duty(ledc_mode_t mode, ledc_channel_t channel, uint32_t duty)
{
    (void)mode;
    fake.channels[channel].set = duty;
    return duty < (1u << fake.bits) ? ESP_OK : ESP_FAIL;
}

esp_err_t ledc_update_duty(ledc_mode_t mode, ledc_channel_t channel)
{
    (void)mode;
    fake.channels[channel].pending = fake.channels[channel].set;
    return ESP_OK;
}
