/* One armed minimum-jerk move against the machine's own clock: prints "time_us pulse_ns × 6" every tick, then ends.
 * Under qemu -icount the clock counts instructions, so two runs are the same to the bit. */
#include "bench.h"
#include "virt.h"

#define TICK_US 10000u
#define MOVE_MS 500

static void print_byte(uint8_t byte)
{
    while (!virt_write_byte(byte)) {
    }
}

static void print_number(uint32_t number, char end)
{
    char digits[10];
    int count = 0;
    do {
        digits[count++] = (char)('0' + number % 10u);
        number /= 10u;
    } while (number != 0u);
    while (count > 0) {
        print_byte((uint8_t)digits[--count]);
    }
    print_byte((uint8_t)end);
}

static void tick(bench_t *bench)
{
    uint64_t next_us = bench->now_us + TICK_US;
    while (virt_clock_us() < next_us) {
    }
    bench->now_us = virt_clock_us();
    hpac_hand_tick(&bench->hand, &bench->config, bench->now_us, bench->pulses);
    print_number((uint32_t)bench->now_us, ' ');
    for (int i = 0; i < HPAC_SERVOS; i++) {
        print_number(bench->pulses[i], i < HPAC_SERVOS - 1 ? ' ' : '\n');
    }
}

int main(void)
{
    static bench_t bench;
    static const int16_t target[HPAC_SERVOS] = { 500, 1000, 1500, 2000, 2500, 3000 };
    bench_armed(&bench, HPAC_ACTION_HOLD); /* its own time: 1.24 s after power-on */
    hpac_config_default(&bench.config);
    while (virt_clock_us() < bench.now_us) {
    }
    bench.now_us = virt_clock_us();
    bench_send(&bench, HPAC_HEARTBEAT, 0, NULL, 0);
    print_number((uint32_t)bench.now_us, '\n');
    bench_move(&bench, HPAC_FLAG_MINIMUM_JERK, MOVE_MS, target);
    for (int i = 0; i <= MOVE_MS * 1000 / (int)TICK_US - 2; i++) {
        tick(&bench);
    }
    virt_exit(0);
    return 0;
}
