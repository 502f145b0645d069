#include "trace.h"

#include "bench.h"

/* CRC-32 in a chain: the next value covers the last one and the new words. */
static uint32_t fold(uint32_t crc, const uint32_t *words, unsigned count)
{
    uint8_t bytes[4u * (1u + HPAC_SERVOS)];
    hpac_put_u32(bytes, crc);
    for (unsigned i = 0; i < count; i++) {
        hpac_put_u32(bytes + 4u * (1u + i), words[i]);
    }
    return hpac_crc32(bytes, 4u * (1u + count));
}

static uint32_t next_random(uint32_t *state)
{
    *state ^= *state << 13;
    *state ^= *state >> 17;
    *state ^= *state << 5;
    return *state;
}

static uint32_t run(bench_t *bench, uint32_t crc, uint32_t ms)
{
    for (uint32_t i = 0; i < ms; i++) {
        bench_run(bench, 1);
        crc = fold(crc, bench->pulses, HPAC_SERVOS);
    }
    return crc;
}

uint32_t hpac_trace(void)
{
    static bench_t bench;
    uint32_t random = 2463534242u;
    uint32_t crc = 0;
    bench_armed(&bench, HPAC_ACTION_RELAX);
    for (int move = 0; move < 60; move++) {
        int16_t servo[HPAC_SERVOS];
        for (int i = 0; i < HPAC_SERVOS; i++) {
            servo[i] = (int16_t)(next_random(&random) % 14500u); /* now and then past a limit */
        }
        uint16_t ms = (uint16_t)(150u + next_random(&random) % 500u);
        uint8_t flags = (uint8_t)(next_random(&random) & HPAC_FLAG_MINIMUM_JERK);
        uint32_t answer[2];
        answer[0] = (uint32_t)bench_move(&bench, flags, ms, servo);
        answer[1] = bench.hand.heat[move % HPAC_SERVOS];
        crc = fold(crc, answer, 2);
        crc = run(&bench, crc, next_random(&random) % 450u);
    }
    crc = run(&bench, crc, 1500);
    bench_send(&bench, HPAC_ESTOP, 0, NULL, 0);
    return run(&bench, crc, 10);
}
