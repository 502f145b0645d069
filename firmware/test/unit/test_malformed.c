/* One broken field a row, fed whole, byte by byte, and after junk: nothing is carried out, the right counter counts,
 * and the next good frame is. */
#include <string.h>

#include "bench.h"
#include "check.h"
#include "tests.h"

typedef enum { COUNT_CRC, COUNT_FRAME, COUNT_VERSION, COUNT_OVERRUN, COUNT_REFUSED } counter_t;

typedef struct {
    const char *name;
    uint8_t version, type, flags;
    uint8_t length;    /* of the payload */
    uint8_t flip_byte; /* on the wire, 0 for none */
    uint8_t cut;       /* bytes taken off before the last zero */
    counter_t counter;
} row_t;

static const row_t rows[] = {
    { "CRC", HPAC_VERSION, HPAC_MOVE, 0, HPAC_MOVE_LENGTH, 22, 0, COUNT_CRC },
    { "payload", HPAC_VERSION, HPAC_MOVE, 0, HPAC_MOVE_LENGTH, 12, 0, COUNT_CRC },
    { "first code byte", HPAC_VERSION, HPAC_MOVE, 0, HPAC_MOVE_LENGTH, 1, 0, COUNT_FRAME },
    { "version", HPAC_VERSION + 1u, HPAC_MOVE, 0, HPAC_MOVE_LENGTH, 0, 0, COUNT_VERSION },
    { "cut short", HPAC_VERSION, HPAC_MOVE, 0, HPAC_MOVE_LENGTH, 0, 3, COUNT_FRAME },
    { "one byte too many", HPAC_VERSION, HPAC_HEARTBEAT, 0, 1, 0, 0, COUNT_REFUSED },
    { "one byte too few", HPAC_VERSION, HPAC_MOVE, 0, HPAC_MOVE_LENGTH - 1u, 0, 0, COUNT_REFUSED },
    { "too long for any", HPAC_VERSION, HPAC_MOVE, 0, 40, 0, 0, COUNT_OVERRUN },
    { "unknown type", HPAC_VERSION, 0x70, 0, 0, 0, 0, COUNT_REFUSED },
    { "our own ACK", HPAC_VERSION, HPAC_ACK, 0, HPAC_ACK_LENGTH, 0, 0, COUNT_FRAME },
    { "unknown flag", HPAC_VERSION, HPAC_MOVE, 0x80, HPAC_MOVE_LENGTH, 0, 0, COUNT_REFUSED },
    { "flag of another", HPAC_VERSION, HPAC_CLEAR, HPAC_FLAG_NO_ACK, 0, 0, 0, COUNT_REFUSED },
};

static unsigned counted(const hpac_counters_t *count, counter_t counter)
{
    const unsigned values[] = { count->bad_crc, count->bad_frame, count->bad_version, count->overrun, count->refused };
    return values[counter];
}

static size_t broken_frame(const row_t *row, uint16_t seq, uint8_t *wire)
{
    uint8_t payload[64];
    memset(payload, 3, sizeof payload); /* a duration of 771 ms, angles of 0.0771 rad: admissible in itself */
    size_t length = bench_frame(wire, row->version, row->type, seq, row->flags, payload, row->length);
    if (row->flip_byte != 0u) {
        wire[row->flip_byte] ^= 0x10u;
    }
    length -= row->cut;
    wire[length - 1u] = 0;
    return length;
}

typedef enum { WHOLE, BYTE_BY_BYTE, AFTER_JUNK, WAYS } way_t;

static void feed(bench_t *bench, way_t way, const uint8_t *wire, size_t length)
{
    static const uint8_t junk[] = "rst:0x1 (POWERON_RESET)\r\n";
    if (way == AFTER_JUNK) {
        bench_feed(bench, junk, 10);
    }
    if (way == BYTE_BY_BYTE) {
        for (size_t i = 0; i < length; i++) {
            bench_feed(bench, wire + i, 1);
        }
    } else {
        bench_feed(bench, wire, length);
    }
}

void test_malformed(void)
{
    for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
        for (way_t way = WHOLE; way < WAYS; way++) {
            uint8_t wire[128];
            bench_t bench;
            bench_armed(&bench, HPAC_ACTION_HOLD);
            unsigned junk = way == AFTER_JUNK ? 1u : 0u; /* the junk ends at the frame's first zero: one bad piece */
            hpac_counters_t before = bench.hand.count;
            feed(&bench, way, wire, broken_frame(&rows[i], 77, wire));
            hpac_counters_t after = bench.hand.count;
            counter_t counter = rows[i].counter;
            unsigned extra = counter == COUNT_FRAME ? junk : 0u;
            CHECK(counted(&after, counter) == counted(&before, counter) + 1u + extra);
            CHECK(after.accepted == before.accepted);
            CHECK(!bench.hand.any_move && !hpac_ramp_moving(&bench.hand.ramp, bench.now_us));
            CHECK(bench_send(&bench, HPAC_HEARTBEAT, 0, NULL, 0) == HPAC_REASON_OK);
        }
    }
}
