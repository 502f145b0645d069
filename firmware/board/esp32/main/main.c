/* The core on an ESP32: one loop does everything. */
#include "board.h"
#include "esp_attr.h"
#include "esp_err.h"
#include "esp_system.h"
#include "esp_task_wdt.h"
#include "esp_timer.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"
#include "hpac_hand.h"
#include "pins.h"
#include "servo_output.h"

#define LOOP_TIMEOUT_MS 100
#define PERIOD_US (HPAC_PULSE_PERIOD_NS / 1000)
#define AFTER_PERIOD_US 200 /* widths are written this long after a period has started, far from its end */

#define TABLE(...) HPAC_SERVO_TABLE(__VA_ARGS__)
static const hpac_config_t config = { .servo = TABLE(SERVOS_HOLD_UNPOWERED, SERVO_TRIMS_NS, SERVO_DIRECTIONS) };

/* Survives every reset but power-on, when it is noise. */
typedef struct {
    hpac_memory_t hand;
    uint32_t boots;
    uint32_t crc;
} kept_t;
static RTC_NOINIT_ATTR kept_t kept;

static hpac_hand_t hand;

static uint32_t crc_of_kept(void) { return hpac_crc32((const uint8_t *)&kept, offsetof(kept_t, crc)); }

static hpac_reset_t reset_reason(void)
{
    switch (esp_reset_reason()) {
    case ESP_RST_POWERON:
        return HPAC_RESET_POWER_ON;
    case ESP_RST_SW:
        return HPAC_RESET_SOFTWARE;
    case ESP_RST_BROWNOUT:
        return HPAC_RESET_BROWNOUT;
    case ESP_RST_PANIC:
    case ESP_RST_INT_WDT:
    case ESP_RST_TASK_WDT:
    case ESP_RST_WDT:
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

static void start_hand(void)
{
    hpac_reset_t reset = reset_reason();
    bool known = reset != HPAC_RESET_POWER_ON && kept.crc == crc_of_kept();
    kept.boots = known ? kept.boots + 1u : 1u;
    hpac_hand_init(&hand, &config, reset, (uint16_t)kept.boots, known ? &kept.hand : NULL);
}

static void remember(void)
{
    hpac_hand_remember(&hand, &kept.hand);
    kept.crc = crc_of_kept();
}

static void receive(void)
{
    uint8_t bytes[128];
    size_t length = board_read(bytes, sizeof bytes);
    if (length > 0u) {
        hpac_hand_receive(&hand, &config, (uint64_t)esp_timer_get_time(), bytes, length);
    }
}

/* Only as much as the driver takes without waiting. */
static void transmit(void)
{
    uint8_t bytes[128];
    size_t room = board_room();
    size_t length = hpac_hand_transmit(&hand, bytes, room < sizeof bytes ? room : sizeof bytes);
    if (length > 0u) {
        board_write(bytes, length);
    }
}

static bool some_pulse_ended(const uint32_t pulses[HPAC_SERVOS], const uint32_t written[HPAC_SERVOS])
{
    for (int i = 0; i < HPAC_SERVOS; i++) {
        if (pulses[i] == 0u && written[i] != 0u) {
            return true;
        }
    }
    return false;
}

/* Pulses that end do so at the next period's start, whenever that is; all else changes in step with it. */
static void put_out(int64_t now_us, int64_t *next_us)
{
    static uint32_t written[HPAC_SERVOS];
    uint32_t pulses[HPAC_SERVOS];
    hpac_hand_tick(&hand, &config, (uint64_t)now_us, pulses);
    board_power(hpac_hand_powered(&hand));
    if (now_us < *next_us && !some_pulse_ended(pulses, written)) {
        return;
    }
    if (!servo_output_write(pulses)) {
        hpac_hand_output_failed(&hand);
        board_power(false);
    }
    for (int i = 0; i < HPAC_SERVOS; i++) {
        written[i] = pulses[i];
    }
    remember();
    while (now_us >= *next_us) {
        *next_us += PERIOD_US;
    }
}

void app_main(void)
{
    servo_output_quiet();
    board_quiet();
    start_hand();
    board_start();
    int64_t next_us = servo_output_start() + AFTER_PERIOD_US;
    start_watchdog();
    for (;;) {
        receive();
        hpac_hand_inputs(&hand, board_estop_pressed(), board_supply_mv());
        put_out(esp_timer_get_time(), &next_us);
        transmit();
        ESP_ERROR_CHECK(esp_task_wdt_reset());
        vTaskDelay(1);
    }
}
