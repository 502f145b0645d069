/* The ESP32 port on a chip that is not there: app_main() runs, a host talks to it, the pins are watched. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bench.h"
#include "fake.h"
#include "servo_pwm.h"

static int failures;

#define CHECK(condition) check((condition), #condition, __LINE__)

static void check(bool holds, const char *what, int line)
{
    if (!holds) {
        failures++;
        printf("test_port.c:%d: failed: %s\n", line, what);
    }
}

static const int16_t target[HPAC_SERVOS] = { 500, 900, 1300, 1700, 2100, 2500 };

static void say(uint8_t type, uint16_t seq, const uint8_t *payload, size_t length)
{
    uint8_t wire[128];
    fake_receive(wire, bench_frame(wire, HPAC_VERSION, type, seq, 0, payload, length));
}

static void say_arm(void)
{
    uint8_t arm[HPAC_ARM_LENGTH] = { 0 };
    hpac_put_u32(arm + HPAC_ARM_AT_LIMITS_HASH, HPAC_LIMITS_HASH);
    say(HPAC_ARM, 2, arm, sizeof arm);
}

static void say_move(uint16_t duration_ms)
{
    uint8_t move[HPAC_MOVE_LENGTH];
    hpac_put_u16(move, duration_ms);
    for (int i = 0; i < HPAC_SERVOS; i++) {
        hpac_put_u16(move + HPAC_MOVE_AT_SERVO + 2 * i, (uint16_t)target[i]);
    }
    say(HPAC_MOVE, 3, move, sizeof move);
}

static bool silent(void)
{
    for (int i = 0; i < HPAC_SERVOS; i++) {
        if (fake.channels[i].output != 0u) {
            return false;
        }
    }
    return true;
}

/* What a servo on pin i would read, in 1e-6 rad. */
static double angle_at_pin(int i)
{
    hpac_config_t config;
    hpac_config_default(&config);
    double ns = (double)fake.channels[i].output * HPAC_PULSE_PERIOD_NS / (double)(1u << fake.bits);
    return config.servo[i].centre_urad + (ns - config.servo[i].centre_ns) / config.servo[i].ns_per_rad * 1e6;
}

static void session(int ms)
{
    if (ms == 5) {
        CHECK(silent());
        say(HPAC_HELLO, 1, NULL, 0);
    } else if (ms == 10) {
        CHECK(fake_sent() > 0u && silent());
        say_arm();
    } else if (ms == 300) {
        say_move(400);
    } else if (ms > 700 && ms <= 760) {
        CHECK(ms < 745 || abs((int)(fake.channels[0].changed_us - fake.channels[5].changed_us)) == 0);
    } else if (ms == 770) {
        double half_step = 0.5 * HPAC_PULSE_PERIOD_NS / (double)(1u << fake.bits) / HPAC_PULSE_NS_PER_RAD * 1e6;
        for (int i = 0; i < HPAC_SERVOS; i++) {
            CHECK(abs((int)(angle_at_pin(i) - target[i] * 100)) <= (int)(half_step + 2.0));
        }
        printf("esp32 port at %u bits: half a step is %.1e rad\n", fake.bits, half_step * 1e-6);
        say(HPAC_ESTOP, 4, NULL, 0);
    } else if (ms == 792) { /* heard within 1 ms, and the next period starts within 20 ms */
        CHECK(silent());
    }
}

static void stays_silent(int ms)
{
    if (ms == 5) {
        say(HPAC_HELLO, 1, NULL, 0);
    } else if (ms == 10) {
        say_arm();
    }
    CHECK(silent());
}

static void exact_frequency(void)
{
    unsigned bits = servo_pwm_bits();
    CHECK(bits == (STUB_LEDC_BITS == 20 ? 17u : 14u));
    CHECK((uint64_t)80000000u * 256u % (50ull << bits) == 0u);
    CHECK(servo_pwm_duty(0) == 0u);
    CHECK(servo_pwm_duty(HPAC_PULSE_PERIOD_NS / 2) == 1u << (bits - 1u));
}

int main(void)
{
    exact_frequency();
    fake_boot(ESP_RST_POWERON, session, 900);
    CHECK(fake.errors == 0);
    CHECK(fake.watchdog_ms > 0u && fake.longest_unfed_us < (int64_t)fake.watchdog_ms * 1000 / 10);
    for (int i = 0; i < HPAC_SERVOS; i++) {
        for (int j = 0; j < i; j++) {
            CHECK(fake.channels[i].pin != fake.channels[j].pin);
        }
    }
    fake_boot(ESP_RST_BROWNOUT, stays_silent, 300);
    fake_boot(ESP_RST_TASK_WDT, stays_silent, 300);
    return failures == 0 ? 0 : 1;
}
