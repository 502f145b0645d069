/* Six pulses from a PCA9685: 12 bits of a period, so one step is 4.9 us, 0.44 degrees of a 180-degree servo (7.7e-3 rad), forty
 * times the LEDC's of an ESP32. I2C has no checksum, so all that makes a pulse is read back, and the chip's
 * output enable (OE) is low only while what it holds is known: a pull-up keeps it high while this chip resets. */
#include "pins.h"
#include "servo_output.h"

#if SERVOS_ON_PCA9685

#include <string.h>

#include "board.h"
#include "driver/gpio.h"
#include "driver/i2c_master.h"
#include "esp_err.h"
#include "esp_rom_sys.h"
#include "esp_timer.h"

#define MODE1 0x00
#define MODE1_RESTART 0x80 /* the chip sets it when it falls asleep with a channel on */
#define MODE1_ASLEEP 0x30  /* SLEEP, and AI: a transfer goes from register to register */
#define MODE1_AWAKE 0x20
#define MODE2 0x01
#define MODE2_TOTEM_POLE 0x04 /* outputs change on STOP, low while OE is high */
#define LED0_ON_L 0x06
#define ALL_LED_OFF_H 0xfd
#define PRESCALE 0xfe
#define FULL_OFF 0x10 /* in LEDn_OFF_H */
#define COUNTS 4096
#define BUS_HZ 400000
#define PATIENCE_MS 5
#define ATTEMPTS 3
#define WAKING_US 500
#define FREQUENCY_HZ (1000000000 / HPAC_PULSE_PERIOD_NS)
#define DIVIDER ((PCA9685_CLOCK_HZ + COUNTS * FREQUENCY_HZ / 2) / (COUNTS * FREQUENCY_HZ))

static i2c_master_dev_handle_t chip;
static bool in_order; /* the chip has been set up and has not lost it since */

static void enable(bool on) { ESP_ERROR_CHECK(gpio_set_level(PCA9685_OE_PIN, on ? 0 : 1)); }

void servo_output_quiet(void)
{
    board_output(PCA9685_OE_PIN, 1);
}

/* Write registers from the first on, and read them back. */
static bool put(uint8_t first, const uint8_t *values, size_t count)
{
    uint8_t message[1 + 4 * HPAC_SERVOS] = { first };
    uint8_t back[4 * HPAC_SERVOS];
    memcpy(message + 1, values, count);
    return i2c_master_transmit(chip, message, count + 1u, PATIENCE_MS) == ESP_OK
           && i2c_master_transmit_receive(chip, &first, 1, back, count, PATIENCE_MS) == ESP_OK && memcmp(values, back, count) == 0;
}

static bool holds(uint8_t address, uint8_t value)
{
    uint8_t back;
    return i2c_master_transmit_receive(chip, &address, 1, &back, 1, PATIENCE_MS) == ESP_OK
           && (address == MODE1 ? back & ~MODE1_RESTART : back) == value;
}

static bool write_one(uint8_t address, uint8_t value)
{
    const uint8_t message[] = { address, value };
    return i2c_master_transmit(chip, message, sizeof message, PATIENCE_MS) == ESP_OK;
}

static bool put_one(uint8_t address, uint8_t value) { return write_one(address, value) && holds(address, value); }

static bool is_set_up(void) { return holds(MODE1, MODE1_AWAKE) && holds(PRESCALE, DIVIDER - 1); }

/* Its divider can be written while it sleeps only, and it must not fall asleep with a channel on. ALL_LED_OFF_H cannot be read. */
static bool set_up(void)
{
    enable(false);
    bool done = write_one(ALL_LED_OFF_H, FULL_OFF) && put_one(MODE1, MODE1_ASLEEP) && put_one(PRESCALE, DIVIDER - 1)
                && put_one(MODE2, MODE2_TOTEM_POLE) && put_one(MODE1, MODE1_AWAKE);
    esp_rom_delay_us(WAKING_US);
    return done;
}

int64_t servo_output_start(void)
{
    const i2c_master_bus_config_t bus_settings = {
        .i2c_port = -1,
        .sda_io_num = PCA9685_SDA_PIN,
        .scl_io_num = PCA9685_SCL_PIN,
        .clk_source = I2C_CLK_SRC_DEFAULT,
        .glitch_ignore_cnt = 7,
        .flags.enable_internal_pullup = true,
    };
    const i2c_device_config_t chip_settings = {
        .dev_addr_length = I2C_ADDR_BIT_LEN_7,
        .device_address = PCA9685_ADDRESS,
        .scl_speed_hz = BUS_HZ,
    };
    i2c_master_bus_handle_t bus;
    ESP_ERROR_CHECK(i2c_new_master_bus(&bus_settings, &bus));
    ESP_ERROR_CHECK(i2c_master_bus_add_device(bus, &chip_settings, &chip));
    in_order = set_up();
    return esp_timer_get_time();
}

bool servo_output_write(const uint32_t pulses[HPAC_SERVOS])
{
    uint8_t values[4 * HPAC_SERVOS] = { 0 };
    bool any = false;
    for (int i = 0; i < HPAC_SERVOS; i++) {
        uint64_t clocks = (uint64_t)pulses[i] * PCA9685_CLOCK_HZ / DIVIDER;
        uint32_t counts = (uint32_t)((clocks + 500000000u) / 1000000000u);
        values[4 * i + 2] = (uint8_t)(counts & 0xffu);
        values[4 * i + 3] = (uint8_t)(pulses[i] != 0u ? counts >> 8 : FULL_OFF);
        any = any || pulses[i] != 0u;
    }
    bool done = false;
    if (!any) {
        enable(false); /* at once, whatever the bus does */
    }
    for (int attempt = 0; attempt < ATTEMPTS && !done; attempt++) {
        in_order = (in_order && (is_set_up() || is_set_up())) || set_up(); /* a read that is lost ends no pulse */
        done = in_order && put(LED0_ON_L, values, sizeof values);
    }
    enable(done && any);
    return done || !any;
}

#endif
