#include "board.h"

#include <string.h>

#include "driver/gpio.h"
#include "esp_adc/adc_cali_scheme.h"
#include "esp_adc/adc_oneshot.h"
#include "esp_attr.h"
#include "esp_err.h"
#include "esp_private/system_internal.h"
#include "esp_rom_sys.h"
#include "hpac_protocol.h"
#include "pins.h"
#include "soc/gpio_reg.h"
#if PORT_IS_USB
#include "driver/usb_serial_jtag.h"
#else
#include "driver/uart.h"
#endif

#define RING_BYTES 1024

static adc_oneshot_unit_handle_t adc;
static adc_cali_handle_t calibration; /* of the factory: bare, an ESP32 reads 5.0 V as 4.3 */

/* Answers that the port has not taken yet. */
static struct {
    uint8_t bytes[2u * HPAC_WIRE_MAX];
    size_t length;
} pending;

void board_output(int pin, uint32_t level)
{
    const gpio_config_t output = { .pin_bit_mask = 1ull << (pin & 63), .mode = GPIO_MODE_OUTPUT };
    ESP_ERROR_CHECK(gpio_set_level((gpio_num_t)pin, level)); /* first: it never drives another one, not for a moment */
    ESP_ERROR_CHECK(gpio_config(&output));
}

void board_quiet(void) { board_output(SUPPLY_SWITCH_PIN, 0); }

_Static_assert(SUPPLY_SWITCH_PIN < 32 && PCA9685_OE_PIN < 32, "SUPPLY_SWITCH_PIN, PCA9685_OE_PIN: a restart can set pins 0 to 31 only");

/* The linker puts it in the place of ESP-IDF's, with which a panic ends: that one resets the processor alone, so pins and LEDC
 * would go on through the reboot, and pulses be twice as long. Caches may be off: nothing that it calls lies in flash. */
void IRAM_ATTR __wrap_esp_restart_noos(void)
{
    REG_WRITE(GPIO_OUT_W1TC_REG, 1u << SUPPLY_SWITCH_PIN);
#if SERVOS_ON_PCA9685
    REG_WRITE(GPIO_OUT_W1TS_REG, 1u << PCA9685_OE_PIN);
#endif
#if CONFIG_IDF_TARGET_ESP32
    esp_restart_noos_dig(); /* its PLL would outlive the reset */
#endif
    esp_rom_software_reset_system();
    for (;;) {
    }
}

static void start_port(void)
{
#if PORT_IS_USB
    usb_serial_jtag_driver_config_t settings = { .rx_buffer_size = RING_BYTES, .tx_buffer_size = RING_BYTES };
    ESP_ERROR_CHECK(usb_serial_jtag_driver_install(&settings));
#else
    const uart_config_t settings = {
        .baud_rate = HPAC_BAUD,
        .data_bits = UART_DATA_8_BITS,
        .parity = UART_PARITY_DISABLE,
        .stop_bits = UART_STOP_BITS_1,
        .flow_ctrl = UART_HW_FLOWCTRL_DISABLE,
        .source_clk = UART_SCLK_DEFAULT,
    };
    ESP_ERROR_CHECK(uart_driver_install(UART_NUM_0, RING_BYTES, 0, 0, NULL, 0)); /* its own buffer for answers would wait */
    ESP_ERROR_CHECK(uart_param_config(UART_NUM_0, &settings));
    /* without a console nobody else has routed UART0 to its pins, and the port would be deaf */
    ESP_ERROR_CHECK(uart_set_pin(UART_NUM_0, UART_TX_PIN, UART_RX_PIN, UART_PIN_NO_CHANGE, UART_PIN_NO_CHANGE));
#endif
}

/* A chip that has none has no supply that can be read. */
static void start_calibration(void)
{
#if ADC_CALI_SCHEME_CURVE_FITTING_SUPPORTED
    const adc_cali_curve_fitting_config_t curve = {
        .unit_id = ADC_UNIT_1, .chan = (adc_channel_t)SUPPLY_ADC_CHANNEL, .atten = ADC_ATTEN_DB_12, .bitwidth = ADC_BITWIDTH_12
    };
    adc_cali_create_scheme_curve_fitting(&curve, &calibration);
#else
    const adc_cali_line_fitting_config_t line = {
        .unit_id = ADC_UNIT_1, .atten = ADC_ATTEN_DB_12, .bitwidth = ADC_BITWIDTH_12, .default_vref = 1100
    };
    adc_cali_create_scheme_line_fitting(&line, &calibration);
#endif
}

void board_start(void)
{
    if (ESTOP_PIN != NO_PIN) {
        const gpio_config_t input = { .pin_bit_mask = 1ull << (ESTOP_PIN & 63), .mode = GPIO_MODE_INPUT, .pull_up_en = GPIO_PULLUP_ENABLE };
        ESP_ERROR_CHECK(gpio_config(&input));
    }
    if (SUPPLY_ADC_CHANNEL != NO_PIN) {
        const adc_oneshot_unit_init_cfg_t unit = { .unit_id = ADC_UNIT_1 };
        const adc_oneshot_chan_cfg_t channel = { .atten = ADC_ATTEN_DB_12, .bitwidth = ADC_BITWIDTH_12 };
        ESP_ERROR_CHECK(adc_oneshot_new_unit(&unit, &adc));
        ESP_ERROR_CHECK(adc_oneshot_config_channel(adc, (adc_channel_t)SUPPLY_ADC_CHANNEL, &channel));
        start_calibration();
    }
    start_port();
}

size_t board_read(uint8_t *bytes, size_t capacity)
{
#if PORT_IS_USB
    int length = usb_serial_jtag_read_bytes(bytes, (uint32_t)capacity, 0);
#else
    int length = uart_read_bytes(UART_NUM_0, bytes, (uint32_t)capacity, 0);
#endif
    return length > 0 ? (size_t)length : 0u;
}

/* Neither waits: the UART's FIFO takes what it has room for, the USB driver a whole piece or nothing. */
size_t board_room(void)
{
    if (pending.length > 0u) {
#if PORT_IS_USB
        int sent = usb_serial_jtag_write_bytes(pending.bytes, pending.length, 0);
#else
        int sent = uart_tx_chars(UART_NUM_0, (const char *)pending.bytes, (uint32_t)pending.length);
#endif
        size_t taken = sent > 0 ? (size_t)sent : 0u;
        pending.length -= taken;
        memmove(pending.bytes, pending.bytes + taken, pending.length);
    }
    return sizeof pending.bytes - pending.length;
}

void board_write(const uint8_t *bytes, size_t length)
{
    memcpy(pending.bytes + pending.length, bytes, length);
    pending.length += length;
    board_room();
}

void board_power(bool on) { ESP_ERROR_CHECK(gpio_set_level(SUPPLY_SWITCH_PIN, on ? 1 : 0)); }

bool board_estop_pressed(void) { return ESTOP_PIN != NO_PIN && gpio_get_level(ESTOP_PIN) != 0; }

uint16_t board_supply_mv(void)
{
    int pin_mv = 0;
    if (SUPPLY_ADC_CHANNEL == NO_PIN) {
        return 0;
    }
    if (adc_oneshot_get_calibrated_result(adc, calibration, (adc_channel_t)SUPPLY_ADC_CHANNEL, &pin_mv) != ESP_OK) {
        return 1; /* it cannot be read: as good as none */
    }
    int mv = pin_mv * SUPPLY_PER_MILLE / 1000;
    return (uint16_t)(mv > 0 ? mv : 1);
}
