/* The core on an ESP32: one task does everything. */
#include "board.h"
#include "esp_attr.h"
#include "esp_err.h"
#include "esp_system.h"
#include "esp_task_wdt.h"
#include "esp_timer.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"
#include "loop.h"
#include "pins.h"
#include "servo_output.h"

#define LOOP_TIMEOUT_MS 100
#define PERIOD_US (HPAC_PULSE_PERIOD_NS / 1000)
#define AFTER_PERIOD_US 200 /* widths are written this long after a period has started, far from its end */

#define FITS(trim) ((trim) >= HPAC_TRIM_MIN_NS && (trim) <= HPAC_TRIM_MAX_NS)
#define ALL_FIT(a, b, c, d, e, f) (FITS(a) && FITS(b) && FITS(c) && FITS(d) && FITS(e) && FITS(f))
#define TRIMS_FIT(...) ALL_FIT(__VA_ARGS__)
_Static_assert(TRIMS_FIT(SERVO_TRIMS_NS), "SERVO_TRIMS_NS of pins.h: a trim is outside of -32768 to 32767 ns");

#define TABLE(...) HPAC_SERVO_TABLE(__VA_ARGS__)
static const hpac_config_t config = { .servo = TABLE(SERVOS_HOLD_UNPOWERED, SERVO_TRIMS_NS, SERVO_DIRECTIONS) };

static RTC_NOINIT_ATTR loop_memory_t kept;
static loop_t loop;

uint64_t board_clock_us(void) { return (uint64_t)esp_timer_get_time(); }

enum { RST_PWR_GLITCH = 14, RST_CPU_LOCKUP = 15 }; /* of esp_reset_reason_t; the first releases of 5.2 have no names for them */

static hpac_reset_t reset_reason(void)
{
    switch ((int)esp_reset_reason()) {
    case ESP_RST_POWERON:
        return HPAC_RESET_POWER_ON;
    case ESP_RST_SW:
        return HPAC_RESET_SOFTWARE;
    case ESP_RST_BROWNOUT:
    case RST_PWR_GLITCH:
        return HPAC_RESET_BROWNOUT;
    case ESP_RST_PANIC:
    case ESP_RST_INT_WDT:
    case ESP_RST_TASK_WDT:
    case ESP_RST_WDT:
    case RST_CPU_LOCKUP:
        return HPAC_RESET_CRASH;
    default:
        return HPAC_RESET_OTHER;
    }
}

static void start_watchdog(void)
{
    const esp_task_wdt_config_t settings = { .timeout_ms = LOOP_TIMEOUT_MS, .idle_core_mask = 0, .trigger_panic = true };
    ESP_ERROR_CHECK(esp_task_wdt_reconfigure(&settings)); /* the start-up code has initialised it */
    ESP_ERROR_CHECK(esp_task_wdt_add(NULL));
}

void app_main(void)
{
    servo_output_quiet();
    board_quiet();
    loop_start(&loop, &config, reset_reason(), &kept);
    board_start();
    loop.period_us = PERIOD_US;
    loop.next_us = (uint64_t)servo_output_start() + AFTER_PERIOD_US;
    start_watchdog();
    for (;;) {
        loop_once(&loop);
        ESP_ERROR_CHECK(esp_task_wdt_reset());
        vTaskDelay(1);
    }
}
