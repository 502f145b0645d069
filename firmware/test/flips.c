/* One bit of the hand's state turns by itself, while it moves, starts, holds, relaxes, stands, has an unusable table: every bit, one after another.
 * Afterwards no pulse may lie outside of the table and none beyond the slew limit from the one before, and a host that has
 * fallen silent finds the pulses gone. The guard of oracle.h judges; it knows nothing of the state.
 *
 * Prints the figures; exits with 1 if anything was wrong. With the argument `first` it ends there, and leaves out the bytes
 * that wait to be sent; with `every` it tries every moment of every scene: dense at first, then ever further apart. */
#include <stdio.h>
#include <string.h>

#include "bench.h"
#include "oracle.h"

/* After the last frame: watchdog, hold, relax from the far end, and the start that a bit may have held up. */
#define SILENCE_MS (BENCH_WATCHDOG_MS + HPAC_HOLD_MAX_MS + HPAC_START_MAX_MS)
#define FINE_MS 80
#define SCENES 11

typedef struct {
    unsigned long tried, outside, fast, powered, stopped;
} figures_t;

static const int16_t far_end[HPAC_SERVOS] = { 13000, 13500, 13000, 13100, 13000, 15000 };

static void arm_again(bench_t *bench, hpac_action_t action)
{
    bench_send(bench, HPAC_CLEAR, 0, NULL, 0);
    bench_arm(bench, (uint8_t)action, 0);
}

static void scene(bench_t *bench, int which)
{
    if (which == 10) { /* no table to move by */
        bench_start(bench);
        bench->config.servo[0].trim_ns = HPAC_TRIM_MAX_NS + 1;
        hpac_hand_init(&bench->hand, &bench->config, HPAC_RESET_POWER_ON, 1, NULL);
        return;
    }
    bench_armed(bench, which == 3 ? HPAC_ACTION_HOLD : which % 2 == 0 ? HPAC_ACTION_RELAX : HPAC_ACTION_DETACH);
    bench_send(bench, HPAC_HEARTBEAT, 0, NULL, 0);
    if (which == 8) {
        return; /* armed, at rest */
    }
    bench_move(bench, which % 2 == 0 ? HPAC_FLAG_MINIMUM_JERK : 0, which == 7 ? 400 : 1000, far_end);
    bench_run(bench, 333); /* in the middle of a move */
    if (which == 3 || which == 4) {
        bench_run(bench, BENCH_WATCHDOG_MS - 333 + 50); /* holding or relaxing */
    } else if (which == 5) {
        arm_again(bench, HPAC_ACTION_RELAX); /* two servos have started, four not */
        bench_run(bench, 400);
    } else if (which == 9) { /* under way to a target near the limit, with speed: a wrong speed would overshoot it */
        static const int16_t under_way[HPAC_SERVOS] = { 10500, 10500, 10500, 10500, 10500, 10500 };
        bench_armed(bench, HPAC_ACTION_DETACH);
        bench_send(bench, HPAC_HEARTBEAT, 0, NULL, 0);
        bench_move(bench, 0, 700, under_way);
        bench_run(bench, 400);
        bench_send(bench, HPAC_HEARTBEAT, 0, NULL, 0);
        bench_run(bench, 200);
        bench_move(bench, HPAC_FLAG_MINIMUM_JERK, 600, far_end);
    } else if (which == 6) {
        bench_send(bench, HPAC_ESTOP, 0, NULL, 0);
    }
}

static void try_bit(const bench_t *before, size_t bit, figures_t *figures)
{
    oracle_servo_t table[ORACLE_SERVOS];
    oracle_guard_t guard;
    bench_t bench = *before;
    uint8_t *state = (uint8_t *)&bench.hand;
    bench.hand.config = &bench.config;
    oracle_table(table, 4.0);
    oracle_guard_start(&guard, table);
    for (int i = 0; i < 3; i++) { /* what the pins show before */
        bench.now_us += 1000;
        hpac_hand_tick(&bench.hand, &bench.config, bench.now_us, bench.pulses);
        oracle_guard(&guard, bench.now_us, bench.pulses);
    }
    state[bit / 8u] = (uint8_t)(state[bit / 8u] ^ (1u << (bit % 8u)));
    for (uint32_t ms = 0; ms < SILENCE_MS; ms += ms < FINE_MS ? 1u : 20u) {
        uint8_t ignored[HPAC_TX_CAPACITY];
        bench.now_us += ms < FINE_MS ? 1000u : 20000u;
        hpac_hand_tick(&bench.hand, &bench.config, bench.now_us, bench.pulses);
        hpac_hand_transmit(&bench.hand, ignored, sizeof ignored);
        oracle_guard(&guard, bench.now_us, bench.pulses);
        if (ms >= FINE_MS && bench_silent(&bench) && !hpac_hand_powered(&bench.hand)) {
            break;
        }
    }
    figures->tried++;
    figures->outside += guard.outside != 0u;
    figures->fast += guard.fast != 0u;
    figures->powered += !bench_silent(&bench) || hpac_hand_powered(&bench.hand);
    figures->stopped += bench.hand.fault == HPAC_FAULT_INTERNAL;
}

/* After the scene's own moment [ms]: through the watchdog's time and whatever follows it. */
#define FAULT_MS (BENCH_WATCHDOG_MS - 333) /* from the middle of a move to the fault of the watchdog */
static const uint32_t moments[] = { 0, 1, 2, 3, 5, 20, 60, FAULT_MS - 1, FAULT_MS, FAULT_MS + 1, FAULT_MS + 2, FAULT_MS + 3,
                                    FAULT_MS + 5, FAULT_MS + 7, FAULT_MS + 20, 300, 700, 1500, 2500, 3400 };

int main(int count, char **arguments)
{
    bool first = count > 1 && strcmp(arguments[1], "first") == 0;
    bool every = count > 1 && strcmp(arguments[1], "every") == 0;
    size_t tried = every ? sizeof moments / sizeof moments[0] : 1u;
    figures_t figures = { 0 };
    for (size_t turn = 0; turn < tried * SCENES; turn++) {
        bench_t bench;
        scene(&bench, (int)(turn % SCENES));
        bench_run(&bench, moments[turn / SCENES]);
        size_t end = first ? offsetof(hpac_hand_t, tx) : sizeof bench.hand;
        for (size_t bit = 0; bit < 8u * end; bit++) {
            try_bit(&bench, bit, &figures);
            if (first && figures.outside + figures.fast + figures.powered > 0u) {
                return 1;
            }
        }
    }
    printf("flips: %lu bits; a pulse outside of the table %lu, beyond the slew limit %lu, powered in the end %lu; caught as `internal` %lu\n",
           figures.tried, figures.outside, figures.fast, figures.powered, figures.stopped);
    return figures.outside + figures.fast + figures.powered == 0u && figures.stopped > 0u ? 0 : 1;
}
