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
    { "CRC", HPAC_VERSION, HPAC_MOVE, 0, HPAC_MOVE_LENGTH, 26, 0, COUNT_CRC },
    { "payload", HPAC_VERSION, HPAC_MOVE, 0, HPAC_MOVE_LENGTH, 12, 0, COUNT_CRC },
    { "first code byte", HPAC_VERSION, HPAC_MOVE, 0, HPAC_MOVE_LENGTH, 1, 0, COUNT_FRAME },
    { "version", HPAC_VERSION + 1u, HPAC_MOVE, 0, HPAC_MOVE_LENGTH, 0, 0, COUNT_VERSION },
    { "cut short", HPAC_VERSION, HPAC_MOVE, 0, HPAC_MOVE_LENGTH, 0, 3, COUNT_FRAME },
    { "one byte too many", HPAC_VERSION, HPAC_HEARTBEAT, 0, 1, 0, 0, COUNT_REFUSED },
    { "one byte too few", HPAC_VERSION, HPAC_MOVE, 0, HPAC_MOVE_LENGTH - 1u, 0, 0, COUNT_REFUSED },
    { "too long for any", HPAC_VERSION, HPAC_MOVE, 0, HPAC_FRAME_MAX, 0, 0, COUNT_OVERRUN },
    { "unknown type", HPAC_VERSION, 0x70, 0, 0, 0, 0, COUNT_REFUSED },
    { "our own ACK", HPAC_VERSION, HPAC_ACK, 0, HPAC_ACK_LENGTH, 0, 0, COUNT_FRAME },
    { "unknown flag", HPAC_VERSION, HPAC_MOVE, 0x80, HPAC_MOVE_LENGTH, 0, 0, COUNT_REFUSED },
    { "flag of another", HPAC_VERSION, HPAC_CLEAR, HPAC_FLAG_NO_ACK, HPAC_CLEAR_LENGTH, 0, 0, COUNT_REFUSED },
    { "session", HPAC_VERSION, HPAC_MOVE, 0, HPAC_MOVE_LENGTH, 0, 0, COUNT_REFUSED },
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

/* A host that asks and does not read: whole answers are dropped and counted, what was kept is whole and in order. */
static void a_full_queue_drops_whole_answers(void)
{
    enum { ASKED = 60 };
    bench_t bench;
    uint8_t payload[HPAC_STATUS_LENGTH] = { 0 };
    bench_armed(&bench, HPAC_ACTION_HOLD);
    for (int round = 0; round < 3; round++) { /* the queue's start moves on */
        uint8_t wire[64];
        uint8_t said[2 * HPAC_TX_CAPACITY];
        uint16_t dropped = bench.hand.count.dropped;
        int kept = 0;
        for (uint16_t i = 1; i <= ASKED; i++) {
            size_t length = bench_frame(wire, HPAC_VERSION, HPAC_STATUS, i, 0, payload, sizeof payload);
            hpac_hand_receive(&bench.hand, &bench.config, bench.now_us, wire, length);
        }
        size_t length = 0;
        for (size_t got = 1; got > 0u; length += got) { /* in pieces */
            got = hpac_hand_transmit(&bench.hand, said + length, 7);
            CHECK(got <= 7u);
        }
        hpac_rx_t rx;
        hpac_rx_init(&rx);
        for (size_t i = 0; i < length; i++) {
            if (hpac_rx_push(&rx, said[i]) == HPAC_RX_FRAME) {
                kept++;
                CHECK(rx.frame[HPAC_AT_TYPE] == HPAC_DEVICE_STATUS && hpac_get_u16(rx.frame + HPAC_AT_SEQ) == kept);
            }
        }
        CHECK(length <= HPAC_TX_CAPACITY && length > HPAC_TX_CAPACITY - HPAC_WIRE_MAX);
        CHECK(kept > 0 && bench.hand.count.dropped - dropped == ASKED - kept);
    }
    bench.hand.count.dropped = UINT16_MAX;
    for (int i = 0; i < 20; i++) {
        uint8_t wire[64];
        size_t length = bench_frame(wire, HPAC_VERSION, HPAC_STATUS, 1, 0, payload, sizeof payload);
        hpac_hand_receive(&bench.hand, &bench.config, bench.now_us, wire, length);
    }
    CHECK(bench.hand.count.dropped == UINT16_MAX);
    bench.hand.count.refused = UINT16_MAX;
    bench_send(&bench, 0x70, 0, NULL, 0);
    CHECK(bench.hand.count.refused == UINT16_MAX);
}

/* An ACK takes 16 bytes: 32 of them fill the queue to its last byte. */
static void the_queue_can_be_filled_to_its_last_byte(void)
{
    bench_t bench;
    uint8_t wire[64];
    uint8_t said[HPAC_TX_CAPACITY];
    bench_start(&bench);
    for (int i = 0; i <= (int)HPAC_TX_CAPACITY / 16; i++) {
        size_t length = bench_frame(wire, HPAC_VERSION, HPAC_ESTOP + 0x60u, 0x101, 0, NULL, 0);
        hpac_hand_receive(&bench.hand, &bench.config, bench.now_us, wire, length);
        CHECK(bench.hand.count.dropped == (i < (int)HPAC_TX_CAPACITY / 16 ? 0u : 1u));
    }
    CHECK(hpac_hand_transmit(&bench.hand, said, sizeof said) == HPAC_TX_CAPACITY);
}

static void each_type_has_its_flags_and_no_others(void)
{
    static const uint8_t allowed[] = { 0, 0, 0, 3, 2, 0xff, 0, 0 };
    static const uint8_t lengths[] = { 0, HPAC_HELLO_LENGTH, HPAC_ARM_LENGTH, HPAC_MOVE_LENGTH, 4, 0, 4, HPAC_STATUS_LENGTH };
    for (uint8_t type = HPAC_HELLO; type <= HPAC_STATUS; type++) {
        for (unsigned bit = 0; bit < 8u; bit++) {
            bench_t bench;
            uint8_t payload[HPAC_MOVE_LENGTH] = { 0 };
            bench_idle(&bench);
            int reason = bench_send(&bench, type, (uint8_t)(1u << bit), payload, lengths[type]);
            CHECK((reason == HPAC_REASON_FLAGS) == ((allowed[type] >> bit & 1) == 0));
        }
    }
}

void test_malformed(void)
{
    each_type_has_its_flags_and_no_others();
    a_full_queue_drops_whole_answers();
    the_queue_can_be_filled_to_its_last_byte();
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
            CHECK(!bench.hand.any_move && !hpac_ramp_moving(&bench.hand.ramp));
            CHECK(bench_send(&bench, HPAC_HEARTBEAT, 0, NULL, 0) == HPAC_REASON_OK);
        }
    }
}
