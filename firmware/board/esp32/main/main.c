/* The core on an ESP32: UART0 is the port, LEDC makes the pulses, one loop does everything. */
#include "driver/uart.h"
#include "esp_attr.h"
#include "esp_err.h"
#include "esp_system.h"
#include "esp_task_wdt.h"
#include "esp_timer.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"
#include "hpac_hand.h"
#include "pins.h"
#include "servo_pwm.h"

#define PORT UART_NUM_0
#define RING_BYTES 1024
#define LOOP_TIMEOUT_MS 100
#define PERIOD_US (HPAC_PULSE_PERIOD_NS / 1000)
#define AFTER_PERIOD_US 200 /* widths are written this long after a period has started, far from its end */
#define BOOTS_MAGIC 0x48504143u

/* Survives every reset but power-on. */
static RTC_NOINIT_ATTR uint32_t boots_magic;
static RTC_NOINIT_ATTR uint16_t boots;

static hpac_hand_t hand;

static uint16_t count_boot(void)
{
    if (boots_magic != BOOTS_MAGIC) {
        boots_magic = BOOTS_MAGIC;
        boots = 0;
    }
    return ++boots;
}

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

static void start_port(void)
{
    const uart_config_t settings = {
        .baud_rate = HPAC_BAUD,
        .data_bits = UART_DATA_8_BITS,
        .parity = UART_PARITY_DISABLE,
        .stop_bits = UART_STOP_BITS_1,
        .flow_ctrl = UART_HW_FLOWCTRL_DISABLE,
        .source_clk = UART_SCLK_DEFAULT,
    };
    ESP_ERROR_CHECK(uart_driver_install(PORT, RING_BYTES, RING_BYTES, 0, NULL, 0));
    ESP_ERROR_CHECK(uart_param_config(PORT, &settings));
}

static void start_watchdog(void)
{
    const esp_task_wdt_config_t settings = { .timeout_ms = LOOP_TIMEOUT_MS, .idle_core_mask = 0, .trigger_panic = true };
    ESP_ERROR_CHECK(esp_task_wdt_reconfigure(&settings)); /* the start-up code has initialised it */
    ESP_ERROR_CHECK(esp_task_wdt_add(NULL));
}

static void start_hand(void)
{
    static const int32_t trims[HPAC_SERVOS] = SERVO_TRIMS_NS;
    static const int32_t directions[HPAC_SERVOS] = SERVO_DIRECTIONS;
    hpac_config_t config;
    hpac_config_default(&config);
    for (int i = 0; i < HPAC_SERVOS; i++) {
        config.servo[i].trim_ns = trims[i];
        config.servo[i].direction = directions[i];
    }
    hpac_hand_init(&hand, &config, reset_reason(), count_boot());
}

static void receive(void)
{
    uint8_t bytes[128];
    int length = uart_read_bytes(PORT, bytes, sizeof bytes, 0);
    if (length > 0) {
        hpac_hand_receive(&hand, (uint64_t)esp_timer_get_time(), bytes, (size_t)length);
    }
}

/* Only as much as the driver's ring takes without waiting. */
static void transmit(void)
{
    uint8_t bytes[128];
    size_t room = 0;
    ESP_ERROR_CHECK(uart_get_tx_buffer_free_size(PORT, &room));
    size_t length = hpac_hand_transmit(&hand, bytes, room < sizeof bytes ? room : sizeof bytes);
    if (length > 0u) {
        uart_write_bytes(PORT, bytes, length);
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

void app_main(void)
{
    uint32_t pulses[HPAC_SERVOS];
    uint32_t written[HPAC_SERVOS] = { 0 };
    start_hand();
    start_port();
    start_watchdog();
    int64_t next_us = servo_pwm_start() + AFTER_PERIOD_US;
    for (;;) {
        receive();
        int64_t now_us = esp_timer_get_time();
        hpac_hand_tick(&hand, (uint64_t)now_us, pulses);
        /* Pulses that end do so at the next period's start, whenever that is; all else changes in step with it. */
        if (now_us >= next_us || some_pulse_ended(pulses, written)) {
            servo_pwm_write(pulses);
            for (int i = 0; i < HPAC_SERVOS; i++) {
                written[i] = pulses[i];
            }
        }
        while (now_us >= next_us) {
            next_us += PERIOD_US;
        }
        transmit();
        ESP_ERROR_CHECK(esp_task_wdt_reset());
        vTaskDelay(1);
    }
}
