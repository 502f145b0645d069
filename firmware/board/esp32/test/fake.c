#include "fake.h"

#include <setjmp.h>
#include <stdio.h>
#include <string.h>

#include "driver/gpio.h"
#include "driver/i2c_master.h"
#include "driver/ledc.h"
#include "driver/uart.h"
#include "driver/usb_serial_jtag.h"
#include "esp_adc/adc_cali_scheme.h"
#include "esp_adc/adc_oneshot.h"
#include "esp_private/system_internal.h"
#include "esp_rom_sys.h"
#include "esp_task_wdt.h"
#include "esp_timer.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"
#include "pins.h"
#include "soc/gpio_reg.h"
#include "soc/soc_caps.h"

#define FIFO_BYTES 128
#define BYTES_A_MS (HPAC_BAUD / 10 / 1000)

void app_main(void);

fake_t fake;

static jmp_buf power_off;
static void (*script)(int ms);
static int ms_passed;
static int ms_in_all;
static uint8_t to_receive[1024];
static size_t to_receive_length;

void fake_boot(esp_reset_reason_t reset, void (*every_ms)(int ms), int ms)
{
    int errors = fake.errors; /* of all boots */
    memset(&fake, 0, sizeof fake);
    fake.errors = errors;
    fake.reset = reset;
    fake.now_us = 300000; /* the boot loader took its time */
    fake.supply_mv = 6000;
    for (int pin = 0; pin < 64; pin++) {
        bool grounded = pin == ESTOP_PIN || (SERVOS_ON_PCA9685 && pin == PCA9685_OE_PIN);
        fake.of_gpio[pin] = STUB_TARGET != 13 || pin < 4 || pin > 7; /* the C3 wakes up with JTAG on 4 to 7 */
        fake.level[pin] = !grounded; /* an output's register holds what does most harm; the button is closed to ground */
    }
    fake.tx_pin = fake.rx_pin = fake.adc_channel = -1;
    fake.i2c[0x00] = 0x11; /* as the PCA9685 wakes up: asleep, divider 30, everything off */
    fake.i2c[0xfe] = 0x1e;
    for (int i = 0; i < 16; i++) {
        fake.i2c[0x09 + 4 * i] = 0x10;
    }
    script = every_ms;
    ms_passed = 0;
    ms_in_all = ms;
    to_receive_length = 0;
    if (setjmp(power_off) == 0) {
        app_main();
    }
}

void fake_receive(const uint8_t *bytes, size_t length)
{
    memcpy(to_receive + to_receive_length, bytes, length);
    to_receive_length += length;
}

double fake_pulse_ns(int i)
{
    const uint8_t *led = fake.i2c + 0x06 + 4 * i;
    if (!SERVOS_ON_PCA9685) {
        return (double)fake.channels[i].output * HPAC_PULSE_PERIOD_NS / (double)(1u << fake.bits);
    }
    bool asleep = (fake.i2c[0x00] & 0x10u) != 0u;
    bool enabled = fake.output[PCA9685_OE_PIN] && fake.level[PCA9685_OE_PIN] == 0u;
    if (asleep || !enabled || (led[3] & 0x10u) != 0u) {
        return 0;
    }
    return (led[2] + 256 * led[3] - (led[0] + 256 * led[1])) * (fake.i2c[0xfe] + 1) * 1e9 / PCA9685_CLOCK_HZ;
}

static esp_err_t fine(bool holds)
{
    fake.errors += !holds;
    return holds ? ESP_OK : ESP_FAIL;
}

void stub_check(esp_err_t error, const char *what)
{
    if (error != ESP_OK) {
        fake.errors++;
        printf("failed: %s\n", what);
    }
}

esp_reset_reason_t esp_reset_reason(void) { return fake.reset; }

int64_t esp_timer_get_time(void) { return fake.now_us; }

void esp_restart_noos_dig(void)
{
    fake.pll_off = true;
    fine(STUB_TARGET == 32); /* most versions of ESP-IDF have it for this chip only */
    esp_rom_software_reset_system();
    __builtin_unreachable();
}

void esp_rom_software_reset_system(void)
{
    fake.restarted = fake.pll_off || STUB_TARGET != 32;
    longjmp(power_off, 1);
}

/* Time passes here alone; at each start of a period the duties that were handed over reach the pins. */
void vTaskDelay(uint32_t ticks)
{
    for (uint32_t i = ms_passed == 0 ? 800u : 0u; i < ticks * 1000u; i++) { /* up to the next tick, which may come soon */
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
    fake.fifo -= fake.fifo < BYTES_A_MS * ticks ? fake.fifo : BYTES_A_MS * ticks;
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
    fake.watchdog_ms = config->trigger_panic && config->idle_core_mask == 0u ? config->timeout_ms : 0u;
    return ESP_OK;
}

esp_err_t esp_task_wdt_add(void *task)
{
    fake.fed_us = fake.now_us;
    fake.watched = true;
    return task == NULL ? ESP_OK : ESP_FAIL;
}

esp_err_t esp_task_wdt_reset(void)
{
    fake.fed_us = fake.now_us;
    return fake.watched ? ESP_OK : ESP_FAIL;
}

/* --- pins --- */

esp_err_t gpio_set_level(gpio_num_t pin, uint32_t level)
{
    fake.enabled_blind = fake.enabled_blind || (SERVOS_ON_PCA9685 && pin == PCA9685_OE_PIN && level == 0u && fake.i2c_failed);
    fine(!SERVOS_ON_PCA9685 || pin != PCA9685_OE_PIN || level == 1u || fake.now_us >= fake.woke_us + 500);
    fake.level_us[pin] = fake.level[pin] != level ? fake.now_us : fake.level_us[pin];
    fake.level[pin] = level;
    return fine(level <= 1u);
}

void stub_write(int level, uint32_t pins)
{
    for (int pin = 0; pin < 32; pin++) {
        fake.level[pin] = (pins >> pin & 1u) != 0u ? (uint32_t)level : fake.level[pin];
    }
}

esp_err_t gpio_set_direction(gpio_num_t pin, gpio_mode_t mode)
{
    fake.output[pin] = mode == GPIO_MODE_OUTPUT && fake.of_gpio[pin];
    fake.glitches |= fake.output[pin] && fake.level[pin] != 0u ? 1ull << pin : 0u;
    return ESP_OK;
}

esp_err_t gpio_config(const gpio_config_t *config)
{
    for (int pin = 0; pin < 64; pin++) {
        if ((config->pin_bit_mask >> pin & 1u) != 0u) {
            fake.of_gpio[pin] = true; /* it alone selects the function in the IO MUX */
            gpio_set_direction(pin, config->mode);
            fake.input[pin] = config->mode == GPIO_MODE_INPUT;
            fake.pulled_up[pin] = config->pull_up_en == GPIO_PULLUP_ENABLE && config->pull_down_en == GPIO_PULLDOWN_DISABLE;
        }
    }
    return ESP_OK;
}

int gpio_get_level(gpio_num_t pin)
{
    fine(fake.input[pin]);
    return (int)fake.level[pin];
}

esp_err_t adc_oneshot_new_unit(const adc_oneshot_unit_init_cfg_t *config, adc_oneshot_unit_handle_t *unit)
{
    *unit = (adc_oneshot_unit_handle_t)&fake;
    return fine(config->unit_id == ADC_UNIT_1);
}

esp_err_t adc_oneshot_config_channel(adc_oneshot_unit_handle_t unit, adc_channel_t channel, const adc_oneshot_chan_cfg_t *config)
{
    fake.adc_channel = (int)channel;
    return fine(unit != NULL && config->atten == ADC_ATTEN_DB_12 && config->bitwidth == ADC_BITWIDTH_12);
}

esp_err_t adc_cali_create_scheme_curve_fitting(const adc_cali_curve_fitting_config_t *config, adc_cali_handle_t *calibration)
{
    *calibration = (adc_cali_handle_t)&fake;
    return fine((int)config->chan == fake.adc_channel && config->unit_id == ADC_UNIT_1 && config->atten == ADC_ATTEN_DB_12
                && config->bitwidth == ADC_BITWIDTH_12);
}

esp_err_t adc_cali_create_scheme_line_fitting(const adc_cali_line_fitting_config_t *config, adc_cali_handle_t *calibration)
{
    *calibration = (adc_cali_handle_t)&fake;
    return fine(config->default_vref == 1100u && config->unit_id == ADC_UNIT_1 && config->atten == ADC_ATTEN_DB_12
                && config->bitwidth == ADC_BITWIDTH_12);
}

/* Behind the divider of README.md. */
esp_err_t adc_oneshot_get_calibrated_result(adc_oneshot_unit_handle_t unit, adc_cali_handle_t calibration, adc_channel_t channel, int *mv)
{
    *mv = fake.supply_mv / 3;
    fine(unit != NULL && calibration != NULL && (int)channel == fake.adc_channel);
    return fake.adc_broken ? ESP_FAIL : ESP_OK;
}

/* --- the port --- */

esp_err_t uart_driver_install(int port, int rx_bytes, int tx_bytes, int queue_length, void *queue, int flags)
{
    fake.uart_installed = true;
    return fine(port == UART_NUM_0 && rx_bytes > 128 && tx_bytes == 0 && queue_length == 0 && queue == NULL && flags == 0);
}

esp_err_t uart_param_config(int port, const uart_config_t *config)
{
    bool plain = config->data_bits == UART_DATA_8_BITS && config->parity == UART_PARITY_DISABLE
                 && config->stop_bits == UART_STOP_BITS_1 && config->flow_ctrl == UART_HW_FLOWCTRL_DISABLE;
    fake.uart_set = true;
    return fine(port == UART_NUM_0 && plain && config->baud_rate == HPAC_BAUD && config->source_clk == UART_SCLK_DEFAULT);
}

esp_err_t uart_set_pin(int port, int tx, int rx, int rts, int cts)
{
    fake.tx_pin = tx;
    fake.rx_pin = rx;
    return fine(port == UART_NUM_0 && rts == UART_PIN_NO_CHANGE && cts == UART_PIN_NO_CHANGE);
}

static int receive(void *buffer, uint32_t length)
{
    size_t taken = to_receive_length < length ? to_receive_length : length;
    memset(buffer, 0x55, length); /* a driver may leave anything in what it does not fill */
    memcpy(buffer, to_receive, taken);
    to_receive_length -= taken;
    memmove(to_receive, to_receive + taken, to_receive_length);
    return (int)taken;
}

static int send(const void *bytes, size_t length)
{
    size_t room = sizeof fake.sent - fake.sent_length;
    memcpy(fake.sent + fake.sent_length, bytes, length < room ? length : room);
    fake.sent_length += length < room ? length : room;
    return (int)length;
}

int uart_read_bytes(int port, void *buffer, uint32_t length, uint32_t ticks)
{
    fine(port == UART_NUM_0 && ticks == 0u && fake.uart_installed && fake.uart_set);
    return fake.rx_pin < 0 ? 0 : receive(buffer, length);
}

int uart_tx_chars(int port, const char *bytes, uint32_t length)
{
    size_t room = FIFO_BYTES - fake.fifo;
    size_t taken = length < room ? length : room;
    fine(port == UART_NUM_0 && fake.uart_installed && fake.uart_set);
    fake.fifo += taken;
    return fake.tx_pin < 0 ? (int)taken : send(bytes, taken);
}

esp_err_t usb_serial_jtag_driver_install(usb_serial_jtag_driver_config_t *config)
{
    fake.usb = true;
    return fine(config->rx_buffer_size > 64u && config->tx_buffer_size > 64u);
}

int usb_serial_jtag_read_bytes(void *buffer, uint32_t length, uint32_t ticks)
{
    fine(fake.usb && ticks == 0u);
    return receive(buffer, length);
}

int usb_serial_jtag_write_bytes(const void *bytes, size_t length, uint32_t ticks)
{
    fine(fake.usb && ticks == 0u && length > 0u);
    return fake.unread ? 0 : send(bytes, length);
}

/* --- LEDC --- */

esp_err_t ledc_timer_config(const ledc_timer_config_t *config)
{
    fake.bits = (unsigned)config->duty_resolution;
    fake.hz = config->freq_hz;
    bool clocked = config->clk_cfg == (SOC_LEDC_SUPPORT_APB_CLOCK ? LEDC_USE_APB_CLK : LEDC_USE_PLL_DIV_CLK);
    return fine(config->speed_mode == LEDC_LOW_SPEED_MODE && config->freq_hz == 50u && clocked && fake.bits <= SOC_LEDC_TIMER_BIT_WIDTH && config->timer_num == LEDC_TIMER_0);
}

esp_err_t ledc_channel_config(const ledc_channel_config_t *config)
{
    fake.channels[config->channel].pin = config->gpio_num;
    fake.channels[config->channel].configured = fake.hz != 0u;
    return fine(config->speed_mode == LEDC_LOW_SPEED_MODE && config->duty == 0u && config->hpoint == 0 && config->timer_sel == LEDC_TIMER_0);
}

esp_err_t ledc_timer_rst(ledc_mode_t mode, ledc_timer_t timer)
{
    fake.period_start_us = fake.now_us;
    return fine(mode == LEDC_LOW_SPEED_MODE && timer == LEDC_TIMER_0);
}

esp_err_t ledc_set_duty(ledc_mode_t mode, ledc_channel_t channel, uint32_t duty)
{
    fake.channels[channel].set = duty;
    return fine(mode == LEDC_LOW_SPEED_MODE && duty < (1u << fake.bits) && fake.channels[channel].configured && fake.period_start_us != 0);
}

esp_err_t ledc_update_duty(ledc_mode_t mode, ledc_channel_t channel)
{
    fine(mode == LEDC_LOW_SPEED_MODE);
    fake.channels[channel].pending = fake.channels[channel].set;
    fake.writes += channel == HPAC_SERVOS - 1;
    return ESP_OK;
}

/* --- I2C and the PCA9685's registers --- */

esp_err_t i2c_new_master_bus(const i2c_master_bus_config_t *config, i2c_master_bus_handle_t *bus)
{
    *bus = (i2c_master_bus_handle_t)&fake;
    return fine(config->i2c_port == -1 && config->sda_io_num == PCA9685_SDA_PIN && config->scl_io_num == PCA9685_SCL_PIN
                && config->clk_source == I2C_CLK_SRC_DEFAULT && config->glitch_ignore_cnt == 7 && config->flags.enable_internal_pullup);
}

esp_err_t i2c_master_bus_add_device(i2c_master_bus_handle_t bus, const i2c_device_config_t *config, i2c_master_dev_handle_t *device)
{
    *device = (i2c_master_dev_handle_t)&fake;
    return fine(bus != NULL && config->device_address == PCA9685_ADDRESS
                && config->dev_addr_length == I2C_ADDR_BIT_LEN_7 && config->scl_speed_hz == 400000u);
}

static esp_err_t transfer(int timeout_ms)
{
    fine(timeout_ms > 0 && timeout_ms <= 5); /* three attempts within a period */
    fake.writes++;
    fake.i2c_failed = fake.i2c_faults > 0;
    if (fake.i2c_failed) {
        fake.i2c_faults--;
        fake.now_us += 1000 * timeout_ms;
        return ESP_FAIL;
    }
    return ESP_OK;
}

void esp_rom_delay_us(uint32_t us) { fake.now_us += us; }

static bool some_channel_runs(void)
{
    for (int i = 0; i < 16; i++) {
        if ((fake.i2c[0x09 + 4 * i] & 0x10u) == 0u) {
            return true;
        }
    }
    return false;
}

/* A write to MODE1. RESTART (bit 7) is set by the chip when it falls asleep while a channel runs; writing 0 leaves it, writing
 * 1 awake clears it. */
static uint8_t mode1(uint8_t value)
{
    uint8_t was = fake.i2c[0x00];
    bool sleeps = (value & 0x10u) != 0u;
    bool restart = (was & 0x80u) != 0u && (sleeps || (value & 0x80u) == 0u);
    if (sleeps && (was & 0x10u) == 0u) {
        restart = restart || some_channel_runs();
        fine(!some_channel_runs() && fake.level[PCA9685_OE_PIN] == 1u);
    }
    fake.woke_us = sleeps ? INT64_MAX / 2 : (was & 0x10u) != 0u ? fake.now_us : fake.woke_us;
    return (uint8_t)((value & 0x7fu) | (restart ? 0x80u : 0u));
}

static void store(uint8_t at, uint8_t value)
{
    bool sleeps = (fake.i2c[0x00] & 0x10u) != 0u;
    if (at == 0x00u) {
        fake.i2c[at] = mode1(value);
    } else if (at == 0xfdu) { /* ALL_LED_OFF_H: written only, it reads as 0 */
        for (int i = 0; i < 16; i++) {
            fake.i2c[0x09 + 4 * i] = value;
        }
    } else if (at != 0xfeu || sleeps) { /* the divider can be written asleep only */
        fake.i2c[at] = value;
    }
    if (at >= 0x06u && at <= 0xfdu) { /* so does a write to any channel */
        fake.i2c[0x00] &= 0x7fu;
    }
}

static uint8_t next_register(uint8_t at) { return (uint8_t)((fake.i2c[0x00] & 0x20u) != 0u ? at + 1u : at); }

esp_err_t i2c_master_transmit(i2c_master_dev_handle_t device, const uint8_t *bytes, size_t length, int timeout_ms)
{
    fine(device != NULL);
    if (transfer(timeout_ms) != ESP_OK) {
        return ESP_FAIL;
    }
    uint8_t at = bytes[0];
    for (size_t i = 1; i < length; i++) {
        uint8_t value = bytes[i];
        if (fake.i2c_flips > 0 && i == length - 2u) {
            fake.i2c_flips--;
            value ^= 0x40u;
        }
        store(at, value);
        at = next_register(at);
    }
    return ESP_OK;
}

esp_err_t i2c_master_transmit_receive(i2c_master_dev_handle_t device, const uint8_t *bytes, size_t length, uint8_t *back,
                                      size_t back_length, int timeout_ms)
{
    fine(device != NULL && length == 1u);
    if (transfer(timeout_ms) != ESP_OK) {
        return ESP_FAIL;
    }
    uint8_t at = bytes[0];
    for (size_t i = 0; i < back_length; i++) {
        back[i] = fake.i2c[at];
        at = next_register(at);
    }
    return ESP_OK;
}
