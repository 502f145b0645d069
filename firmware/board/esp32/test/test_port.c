/* The ESP32 port on a chip that is not there: app_main() runs, a host talks to it, the pins are watched. Compiled once a
 * chip and output; the oracle's codec speaks to it. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bench.h"
#include "board.h"
#include "fake.h"
#include "oracle.h"
#include "pins.h"
#include "soc/soc_caps.h"

static int failures;

#define CHECK(condition) check((condition), #condition, __LINE__)

static void check(bool holds, const char *what, int line)
{
    if (!holds) {
        failures++;
        printf("test_port.c:%d: failed: %s\n", line, what);
    }
}

#define SESSION 0x0badcafeu

static const int32_t trims[HPAC_SERVOS] = { SERVO_TRIMS_NS };
static const int32_t directions[HPAC_SERVOS] = { SERVO_DIRECTIONS };
static const int16_t target[HPAC_SERVOS] = { 500, 1900, 3300, 4700, 6100, 7500 };

/* --- a host --- */

static void say(uint8_t type, const uint8_t *payload, size_t length)
{
    static uint16_t seq;
    uint8_t wire[128];
    uint8_t body[64] = { 0 };
    if (payload != NULL) {
        memcpy(body, payload, length);
    }
    if (length >= 4u) {
        hpac_put_u32(body, SESSION);
    }
    fake_receive(wire, oracle_encode(wire, HPAC_VERSION, type, ++seq, 0, body, length));
}

static uint32_t hash_of_this_copy(void)
{
    oracle_servo_t table[ORACLE_SERVOS];
    oracle_table(table, 2.0);
    for (int i = 0; i < HPAC_SERVOS; i++) {
        table[i].trim_ns = trims[i];
        table[i].direction = directions[i];
    }
    return oracle_hash(table);
}

static void say_arm(void)
{
    uint8_t arm[HPAC_ARM_LENGTH] = { 0 };
    hpac_put_u32(arm + HPAC_ARM_AT_LIMITS_HASH, hash_of_this_copy());
    hpac_put_u16(arm + HPAC_ARM_AT_WATCHDOG_MS, HPAC_WATCHDOG_MAX_MS);
    say(HPAC_ARM, arm, sizeof arm);
}

static void say_move(uint16_t duration_ms)
{
    uint8_t move[HPAC_MOVE_LENGTH];
    hpac_put_u16(move + HPAC_MOVE_AT_DURATION_MS, duration_ms);
    for (int i = 0; i < HPAC_SERVOS; i++) {
        hpac_put_u16(move + HPAC_MOVE_AT_SERVO + 2 * i, (uint16_t)target[i]);
    }
    say(HPAC_MOVE, move, sizeof move);
}

static unsigned answers; /* of the type that heard() was called with last */

/* The payload of the latest answer of a type, or NULL. */
static const uint8_t *heard(uint8_t type)
{
    static uint8_t latest[128];
    answers = 0;
    size_t start = 0;
    for (size_t i = 0; i < fake.sent_length; i++) {
        if (fake.sent[i] != 0u) {
            continue;
        }
        uint8_t frame[128];
        size_t length = 0;
        if (i > start && i - start < 100u && oracle_decode(fake.sent + start, i - start, frame, &length) == ORACLE_INTACT
            && frame[HPAC_AT_TYPE] == type) {
            memcpy(latest, frame, sizeof latest);
            answers++;
        }
        start = i + 1u;
    }
    return answers > 0u ? latest + HPAC_HEADER_LENGTH : NULL;
}

/* Ask for STATUS, to be heard one ms later. */
static void ask_status(void)
{
    uint8_t payload[HPAC_STATUS_LENGTH] = { 0 };
    fake.sent_length = 0;
    say(HPAC_STATUS, payload, sizeof payload);
}

static unsigned status_of(unsigned at, unsigned bytes)
{
    const uint8_t *status = heard(HPAC_DEVICE_STATUS);
    CHECK(status != NULL);
    return status == NULL ? 0u : bytes == 1u ? status[at] : hpac_get_u16(status + at);
}

/* --- the pins --- */

static bool silent(void)
{
    for (int i = 0; i < HPAC_SERVOS; i++) {
        if (fake_pulse_ns(i) > 0) {
            return false;
        }
    }
    return true;
}

static bool powered(void) { return fake.output[SUPPLY_SWITCH_PIN] && fake.level[SUPPLY_SWITCH_PIN] == 1u; }

/* What a servo on channel i would read [urad]. */
static double angle_at_pin(int i)
{
    oracle_servo_t table[ORACLE_SERVOS];
    oracle_table(table, 2.0);
    return table[i].centre + directions[i] * (fake_pulse_ns(i) - trims[i] - table[i].centre_ns) / table[i].ns_per_rad * 1e6;
}

static double half_a_step_urad(void)
{
    double step_ns = SERVOS_ON_PCA9685 ? 4881.0 : ceil((double)HPAC_PULSE_PERIOD_NS / (1u << fake.bits));
    return 0.5 * step_ns / HPAC_PULSE_NS_PER_RAD * 1e6;
}

/* Greeted, armed, at rest by 2600 ms, moving to `target` by 3100 ms. */
static void open_session(int ms)
{
    if (ms == 5) {
        say(HPAC_HELLO, NULL, HPAC_HELLO_LENGTH);
    } else if (ms == 10 || ms == 1500) {
        say_arm();
    } else if (ms == 2600) {
        say_move(400);
    }
}

static void whole_session(int ms)
{
    open_session(ms);
    CHECK(ms > 5 || (silent() && !powered()));
    CHECK(ms != 10 || (silent() && heard(HPAC_DEVICE_HELLO) != NULL));
    CHECK(ms < 12 || ms > 60 || (powered() && silent())); /* the supply first */
    if (ms == 3100) {
        for (int i = 0; i < HPAC_SERVOS; i++) {
            CHECK(abs((int)(angle_at_pin(i) - target[i] * 100)) <= (int)(half_a_step_urad() + 2.0));
        }
        CHECK(SERVOS_ON_PCA9685 || fake.channels[0].changed_us == fake.channels[5].changed_us);
        say(HPAC_ESTOP, NULL, 0);
    }
    CHECK(ms < 3102 || !powered());
    CHECK(ms < 3122 || silent()); /* heard within 1 ms, and the next period starts within 20 ms */
    CHECK(!SERVOS_ON_PCA9685 || ms < 3102 || (silent() && fake.level[PCA9685_OE_PIN] == 1u)); /* OE does not wait for a period */
}

/* The e-stop comes when one servo alone has pulses, at any time within a period. */
static int estop_ms;

static void one_servo_is_stopped(int ms)
{
    open_session(ms);
    CHECK(ms != estop_ms || (fake_pulse_ns(0) > 0 && fake_pulse_ns(1) == 0));
    for (int i = 1; ms == estop_ms && SERVOS_ON_PCA9685 && i < HPAC_SERVOS; i++) {
        CHECK(fake.i2c[0x09 + 4 * i] == 0x10u); /* full off: on and off at the same count would be anybody's guess */
    }
    if (ms == estop_ms) {
        say(HPAC_ESTOP, NULL, 0);
    }
    CHECK(ms < estop_ms + 22 || silent());
}

static void a_frame_comes_byte_by_byte(int ms)
{
    static uint8_t wire[128];
    static size_t length;
    uint8_t nonce[4] = { 1, 2, 3, 4 };
    length = ms == 1 ? oracle_encode(wire, HPAC_VERSION, HPAC_HELLO, 1, 0, nonce, sizeof nonce) : length;
    if (ms >= 5 && ms < 5 + (int)length) {
        fake_receive(&wire[ms - 5], 1);
    }
    CHECK(ms != 40 || heard(HPAC_DEVICE_HELLO) != NULL);
}

/* Outputs are written once a period, with and without pulses, and nothing is taken for a frame that was not sent. */
static void once_a_period(int ms)
{
    static unsigned writes;
    open_session(ms);
    if (ms == 200 || ms == 3300) {
        writes = fake.writes;
    } else if (ms == 1200 || ms == 4300) {
        CHECK(fake.writes - writes <= (SERVOS_ON_PCA9685 ? 4u : 1u) * 51u && fake.writes - writes >= 49u);
    } else if (ms == 3200) {
        say(HPAC_CLEAR, NULL, HPAC_CLEAR_LENGTH);
    } else if (ms == 4310) {
        ask_status();
    } else if (ms == 4315) {
        CHECK(status_of(HPAC_DEVICE_STATUS_AT_BAD_FRAME, 2) == 0u && status_of(HPAC_DEVICE_STATUS_AT_BAD_CRC, 2) == 0u);
        CHECK(status_of(HPAC_DEVICE_STATUS_AT_OVERRUN, 2) == 0u && status_of(HPAC_DEVICE_STATUS_AT_REFUSED, 2) == 0u);
        CHECK(silent() && !powered());
    }
}

/* A host that asks for more than the line carries, or does not read its USB: answers come whole, or are counted. */
static void asks_too_much(int ms)
{
    static unsigned lost;
    open_session(ms);
    fake.unread = ms > 30 && ms < 100;
    if (ms > 20 && ms <= 140) {
        uint8_t payload[HPAC_STATUS_LENGTH] = { 0 };
        say(HPAC_STATUS, payload, sizeof payload);
    } else if (ms == 200) {
        heard(HPAC_DEVICE_STATUS);
        CHECK(answers > 0u && answers < 120u);
        lost = 120u - answers;
        ask_status();
    }
    CHECK(ms != 210 || status_of(HPAC_DEVICE_STATUS_AT_DROPPED, 2) == lost);
}

static void stays_silent(int ms)
{
    open_session(ms);
    CHECK(silent() && !powered());
}

static const uint8_t *hello_after(esp_reset_reason_t reset)
{
    fake_boot(reset, stays_silent, 8);
    return heard(HPAC_DEVICE_HELLO);
}

static void resets_are_told(void)
{
    static const struct { esp_reset_reason_t reason; uint8_t told, state; } rows[] = {
        { ESP_RST_POWERON, HPAC_RESET_POWER_ON, HPAC_STATE_IDLE },  { ESP_RST_SW, HPAC_RESET_SOFTWARE, HPAC_STATE_IDLE },
        { ESP_RST_BROWNOUT, HPAC_RESET_BROWNOUT, HPAC_STATE_FAULT }, { ESP_RST_PANIC, HPAC_RESET_CRASH, HPAC_STATE_FAULT },
        { ESP_RST_INT_WDT, HPAC_RESET_CRASH, HPAC_STATE_FAULT },     { ESP_RST_TASK_WDT, HPAC_RESET_CRASH, HPAC_STATE_FAULT },
        { ESP_RST_WDT, HPAC_RESET_CRASH, HPAC_STATE_FAULT },         { ESP_RST_EXT, HPAC_RESET_OTHER, HPAC_STATE_IDLE },
        { ESP_RST_UNKNOWN, HPAC_RESET_OTHER, HPAC_STATE_IDLE },
        { (esp_reset_reason_t)14, HPAC_RESET_BROWNOUT, HPAC_STATE_FAULT }, /* a glitch of the supply */
        { (esp_reset_reason_t)15, HPAC_RESET_CRASH, HPAC_STATE_FAULT },    /* the processor locked up */
    };
    for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
        const uint8_t *hello = hello_after(rows[i].reason);
        CHECK(hello != NULL && hello[HPAC_DEVICE_HELLO_AT_RESET] == rows[i].told && hello[HPAC_DEVICE_HELLO_AT_STATE] == rows[i].state);
        CHECK(hello != NULL && hpac_get_u16(hello + HPAC_DEVICE_HELLO_AT_BOOT_COUNT) == i + 1u);
    }
    const uint8_t *hello = hello_after(ESP_RST_POWERON); /* what is in that memory now is not to be believed */
    CHECK(hello != NULL && hpac_get_u16(hello + HPAC_DEVICE_HELLO_AT_BOOT_COUNT) == 1u);
}

static void this_copy_is_told(void)
{
    const uint8_t *hello = hello_after(ESP_RST_POWERON);
    CHECK(hello != NULL && hpac_get_u32(hello + HPAC_DEVICE_HELLO_AT_LIMITS_HASH) == hash_of_this_copy());
    for (int i = 0; hello != NULL && i < HPAC_SERVOS; i++) {
        CHECK(hpac_get_i16(hello + HPAC_DEVICE_HELLO_AT_TRIM_NS + 2 * i) == trims[i]);
        CHECK((hello[HPAC_DEVICE_HELLO_AT_REVERSED] >> i & 1) == (directions[i] < 0));
    }
}

/* A software reset in the middle of a session: heat and pose are what they were; the springs have opened the hand. */
static void until_the_reset(int ms) { open_session(ms); }

static void after_the_reset(int ms)
{
    if (ms == 5) {
        ask_status();
    } else if (ms == 7) {
        for (unsigned i = 0; i < HPAC_SERVOS; i++) {
            CHECK(abs((int)status_of(HPAC_DEVICE_STATUS_AT_SERVO + 2u * i, 2) - target[i]) <= 1);
        }
        say(HPAC_HELLO, NULL, HPAC_HELLO_LENGTH);
    } else if (ms == 9) {
        say_arm();
    } else if (ms == 100) {
        CHECK(abs((int)angle_at_pin(0)) <= (int)(half_a_step_urad() + 2.0) && fake_pulse_ns(0) > 0);
        CHECK(fake_pulse_ns(1) == 0);
    }
}

static void memory_outlives_a_reset(void)
{
    fake_boot(ESP_RST_POWERON, until_the_reset, 3100);
    fake_boot(ESP_RST_SW, stays_silent, 0); /* and again before its first output */
    fake_boot(ESP_RST_SW, after_the_reset, 120);
}

static void a_session_with_pins(int ms)
{
    open_session(ms);
    if (ms == 1) {
        CHECK(ESTOP_PIN == NO_PIN || (fake.pulled_up[ESTOP_PIN & 63] && fake.input[ESTOP_PIN & 63]));
    } else if (ms == 3100) {
        CHECK(!silent() && powered());
        ask_status();
    } else if (ms == 3103) {
        CHECK(abs((int)status_of(HPAC_DEVICE_STATUS_AT_SUPPLY_MV, 2) - (SUPPLY_ADC_CHANNEL != NO_PIN ? 6000 : 0)) <= 3);
    }
}

static void the_button(int ms)
{
    a_session_with_pins(ms);
    if (ms == 3110) {
        fake.level[ESTOP_PIN & 63] = 1; /* pressed, or the wire has come off */
    } else if (ms == 3140) {
        CHECK(silent() && !powered());
        say(HPAC_CLEAR, NULL, HPAC_CLEAR_LENGTH);
        ask_status();
    } else if (ms == 3145) {
        CHECK(status_of(HPAC_DEVICE_STATUS_AT_FAULT, 1) == HPAC_FAULT_ESTOP);
        fake.level[ESTOP_PIN & 63] = 0;
    } else if (ms == 3150) {
        say(HPAC_CLEAR, NULL, HPAC_CLEAR_LENGTH);
        ask_status();
    } else if (ms == 3155) {
        CHECK(status_of(HPAC_DEVICE_STATUS_AT_STATE, 1) == HPAC_STATE_IDLE && silent() && !powered());
    }
}

static void the_supply(int ms)
{
    a_session_with_pins(ms);
    if (ms == 3110) {
        fake.supply_mv = HPAC_SUPPLY_MIN_MV - 100;
    } else if (ms == 3125) {
        CHECK(powered()); /* a dip is none */
    } else if (ms == 3155) {
        CHECK(silent() && !powered());
        ask_status();
    } else if (ms == 3158) {
        CHECK(status_of(HPAC_DEVICE_STATUS_AT_FAULT, 1) == HPAC_FAULT_SUPPLY);
    }
}

static void the_supply_is_gone(int ms) /* 0 V: not to be mistaken for a supply that is not measured */
{
    a_session_with_pins(ms);
    if (ms == 3110) {
        fake.supply_mv = 0;
    } else if (ms == 3155) {
        CHECK(silent() && !powered());
        ask_status();
    } else if (ms == 3158) {
        CHECK(status_of(HPAC_DEVICE_STATUS_AT_FAULT, 1) == HPAC_FAULT_SUPPLY && status_of(HPAC_DEVICE_STATUS_AT_SUPPLY_MV, 2) == 1u);
    }
}

static void the_adc_breaks(int ms)
{
    a_session_with_pins(ms);
    fake.adc_broken = ms >= 3110;
    CHECK(ms < 3155 || (silent() && !powered()));
    if (ms == 3155) {
        ask_status();
    }
    CHECK(ms != 3158 || status_of(HPAC_DEVICE_STATUS_AT_SUPPLY_MV, 2) == 1u);
}

static void panics(int ms)
{
    open_session(ms);
    if (ms == 3100) {
        CHECK(powered() && !silent());
        __wrap_esp_restart_noos();
    }
}

static void a_panic_ends_everything(void)
{
    static uint32_t before[64];
    fake_boot(ESP_RST_POWERON, until_the_reset, 3099);
    memcpy(before, fake.level, sizeof before);
    before[SUPPLY_SWITCH_PIN] = 0;
    before[PCA9685_OE_PIN] = SERVOS_ON_PCA9685 ? 1u : before[PCA9685_OE_PIN];
    fake_boot(ESP_RST_POWERON, panics, 3200);
    CHECK(fake.restarted && !powered() && memcmp(before, fake.level, sizeof before) == 0);
}

static void signals_come_out_of_the_pins_that_pins_h_names(void)
{
    static const int servos[] = SERVO_PINS;
    for (int i = 0; i < 6 && !SERVOS_ON_PCA9685; i++) {
        CHECK(fake.channels[i].pin == servos[i] && fake.output[servos[i]]);
    }
    CHECK(PORT_IS_USB ? fake.usb : fake.tx_pin == UART_TX_PIN && fake.rx_pin == UART_RX_PIN);
}

#if SERVOS_ON_PCA9685
static void bus_dies(int ms)
{
    open_session(ms);
    fake.i2c_faults = ms >= 2700 ? 1000 : 0;
    CHECK(ms < 2745 || (silent() && !powered()));
    CHECK(ms < 2700 || !silent() || !powered()); /* the supply goes with the pulses, not a moment later */
}

/* Three attempts, of which the first asks twice and then sets up: four failures in a row are overcome, five are not. */
static int bus_failures;

static void bus_fails_for_so_long(int ms)
{
    open_session(ms);
    if (ms == 2700) {
        fake.i2c_faults = bus_failures;
    }
    CHECK(ms < 2800 || powered() == (bus_failures == 4));
}

static void an_estop_does_not_wait_for_the_bus(int ms)
{
    static int64_t stopped_us;
    open_session(ms);
    if (ms == 2700) {
        say(HPAC_ESTOP, NULL, 0);
        fake.i2c_faults = 1000;
        stopped_us = fake.now_us;
    }
    CHECK(ms != 2710 || (silent() && !powered() && fake.level_us[PCA9685_OE_PIN] - stopped_us < 1000));
}

static void bus_stumbles(int ms)
{
    open_session(ms);
    if (ms > 2600 && ms % 50 == 0) {
        fake.i2c_faults = 2;
    } else if (ms > 2600 && ms % 50 == 25) {
        fake.i2c_flips = 1;
    }
    CHECK(ms < 2600 || ms > 3050 || powered());
    CHECK(ms != 3100 || abs((int)(angle_at_pin(3) - target[3] * 100)) <= (int)(half_a_step_urad() + 2.0));
}

/* Neither a read that is lost nor a RESTART bit ends pulses that are right. */
static void pulses_go_on(int ms)
{
    open_session(ms);
    fake.i2c_faults = ms == 2900 || ms == 2950 ? 1 : fake.i2c_faults;
    fake.i2c[0x00] |= ms == 3000 ? 0x80u : 0u;
    CHECK(ms < 2900 || (fake.level[PCA9685_OE_PIN] == 0u && fake.now_us - fake.level_us[PCA9685_OE_PIN] > 100000));
}

static void chip_loses_its_supply(int ms)
{
    open_session(ms);
    if (ms == 2900) {
        fake.i2c[0x00] = 0x11;
        fake.i2c[0xfe] = 0x1e;
    }
    CHECK(ms != 3100 || (fake.i2c[0xfe] == 121 && fake.i2c[0x00] == 0x20));
    CHECK(ms != 3100 || abs((int)(angle_at_pin(3) - target[3] * 100)) <= (int)(half_a_step_urad() + 2.0));
}

static void its_divider_alone_turns(int ms)
{
    open_session(ms);
    fake.i2c[0xfe] = ms == 2900 ? 0x1e : fake.i2c[0xfe];
    CHECK(ms != 3100 || fake.i2c[0xfe] == 121);
}

static void chip_falls_asleep(int ms)
{
    open_session(ms);
    fake.i2c[0x00] = ms == 2900 ? 0x11 : fake.i2c[0x00];
    CHECK(ms != 3100 || fake.i2c[0x00] == 0x20);
    CHECK(ms != 3100 || abs((int)(angle_at_pin(3) - target[3] * 100)) <= (int)(half_a_step_urad() + 2.0));
}

static void clock_stays_wrong(int ms) /* a divider that cannot be set: every pulse would be as wrong */
{
    open_session(ms);
    fake.i2c[0xfe] = ms >= 2700 ? 0x1f : fake.i2c[0xfe];
    fake.i2c_flips = ms >= 2700 ? 1000 : 0;
    CHECK(ms < 2745 || (silent() && !powered()));
}

static void the_bus_and_its_faults(void)
{
    fake_boot(ESP_RST_POWERON, bus_dies, 2900);
    CHECK(!fake.enabled_blind);
    fake_boot(ESP_RST_POWERON, its_divider_alone_turns, 3110);
    fake_boot(ESP_RST_POWERON, an_estop_does_not_wait_for_the_bus, 2900);
    for (bus_failures = 4; bus_failures < 6; bus_failures++) {
        fake_boot(ESP_RST_POWERON, bus_fails_for_so_long, 2900);
    }
    fake_boot(ESP_RST_POWERON, bus_stumbles, 3200);
    fake_boot(ESP_RST_POWERON, pulses_go_on, 3100);
    fake_boot(ESP_RST_POWERON, chip_loses_its_supply, 3200);
    fake_boot(ESP_RST_POWERON, chip_falls_asleep, 3200);
    fake_boot(ESP_RST_POWERON, clock_stays_wrong, 2900);
}
#else
static void the_bus_and_its_faults(void) { CHECK(80000000ull * 256u % (50ull << fake.bits) == 0u); }
#endif

int main(void)
{
    fake_boot(ESP_RST_POWERON, whole_session, 3200);
    CHECK(fake.errors == 0);
    CHECK(SERVOS_ON_PCA9685 || fake.bits == (SOC_LEDC_TIMER_BIT_WIDTH == 20 ? 17u : 14u));
    CHECK(fake.watched && fake.watchdog_ms > 0u && fake.watchdog_ms <= 100u);
    CHECK(fake.longest_unfed_us < (int64_t)fake.watchdog_ms * 1000 / 4);
    CHECK(fake.glitches == (SERVOS_ON_PCA9685 ? 1ull << PCA9685_OE_PIN : 0ull)); /* OE must be high when it becomes an output */
    signals_come_out_of_the_pins_that_pins_h_names();
    for (estop_ms = 110; estop_ms < 130; estop_ms++) {
        fake_boot(ESP_RST_POWERON, one_servo_is_stopped, 160);
    }
    fake_boot(ESP_RST_POWERON, once_a_period, 4320);
    fake_boot(ESP_RST_POWERON, a_frame_comes_byte_by_byte, 50);
    fake_boot(ESP_RST_POWERON, asks_too_much, 210);
    the_bus_and_its_faults();
    fake_boot(ESP_RST_BROWNOUT, stays_silent, 300);
    fake_boot(ESP_RST_TASK_WDT, stays_silent, 300);
    fake_boot(ESP_RST_POWERON, stays_silent, 1);
    resets_are_told();
    this_copy_is_told();
    memory_outlives_a_reset();
    a_panic_ends_everything();
    if (ESTOP_PIN != NO_PIN) {
        fake_boot(ESP_RST_POWERON, the_button, 3200);
    }
    if (SUPPLY_ADC_CHANNEL != NO_PIN) {
        fake_boot(ESP_RST_POWERON, the_supply, 3200);
        fake_boot(ESP_RST_POWERON, the_supply_is_gone, 3200);
        fake_boot(ESP_RST_POWERON, the_adc_breaks, 3200);
    }
    CHECK(fake.errors == 0);
    printf("one step is %.2g rad\n", 2e-6 * half_a_step_urad());
    return failures == 0 ? 0 : 1;
}
