#include "hpac_answer.h"

#include "hpac_load.h"
#include "hpac_motion.h"
#include "hpac_state.h"

static uint32_t uptime_ms(const hpac_hand_t *hand) { return (uint32_t)(hand->now_us / 1000u); }

static void queue(hpac_hand_t *hand, uint8_t *frame, uint8_t type, uint16_t seq, size_t payload_length)
{
    uint8_t wire[HPAC_WIRE_MAX];
    size_t length = hpac_frame_encode(frame, type, seq, payload_length, wire);
    if (hand->tx_length + length > HPAC_TX_CAPACITY) {
        hpac_state_count(&hand->count.dropped);
        return;
    }
    for (size_t i = 0; i < length; i++) {
        hand->tx[(hand->tx_start + hand->tx_length + i) % HPAC_TX_CAPACITY] = wire[i];
    }
    hand->tx_length = (uint16_t)(hand->tx_length + length);
}

size_t hpac_hand_transmit(hpac_hand_t *hand, uint8_t *out, size_t capacity)
{
    size_t taken = 0;
    while (taken < capacity && hand->tx_length > 0u) {
        out[taken++] = hand->tx[hand->tx_start % HPAC_TX_CAPACITY];
        hand->tx_start = (uint16_t)((hand->tx_start + 1u) % HPAC_TX_CAPACITY);
        hand->tx_length--;
    }
    return taken;
}

void hpac_answer_hello(hpac_hand_t *hand, uint16_t seq)
{
    uint8_t frame[HPAC_FRAME_MAX];
    uint8_t *payload = frame + HPAC_HEADER_LENGTH;
    hpac_put_u32(payload + HPAC_DEVICE_HELLO_AT_SESSION, hand->session);
    payload[HPAC_DEVICE_HELLO_AT_FIRMWARE_VERSION] = HPAC_FIRMWARE_MAJOR;
    payload[HPAC_DEVICE_HELLO_AT_FIRMWARE_VERSION + 1u] = HPAC_FIRMWARE_MINOR;
    payload[HPAC_DEVICE_HELLO_AT_FIRMWARE_VERSION + 2u] = HPAC_FIRMWARE_PATCH;
    hpac_put_u32(payload + HPAC_DEVICE_HELLO_AT_LIMITS_HASH, hpac_servo_hash(hand->config->servo));
    payload[HPAC_DEVICE_HELLO_AT_REVERSED] = 0;
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        const hpac_servo_t *servo = &hand->config->servo[i];
        hpac_put_u16(payload + HPAC_DEVICE_HELLO_AT_TRIM_NS + 2u * i, (uint16_t)((uint32_t)servo->trim_ns & 0xffffu));
        payload[HPAC_DEVICE_HELLO_AT_REVERSED] |= (uint8_t)(servo->direction < 0 ? 1u << i : 0u);
    }
    hpac_put_u16(payload + HPAC_DEVICE_HELLO_AT_WATCHDOG_MS, hand->watchdog_ms);
    payload[HPAC_DEVICE_HELLO_AT_RESET] = hand->reset;
    hpac_put_u16(payload + HPAC_DEVICE_HELLO_AT_BOOT_COUNT, hand->boot_count);
    payload[HPAC_DEVICE_HELLO_AT_STATE] = hand->state;
    queue(hand, frame, HPAC_DEVICE_HELLO, seq, HPAC_DEVICE_HELLO_LENGTH);
}

void hpac_answer_ack(hpac_hand_t *hand, uint16_t seq, uint8_t acked, hpac_reason_t reason, uint8_t servo)
{
    uint8_t frame[HPAC_FRAME_MAX];
    uint8_t *payload = frame + HPAC_HEADER_LENGTH;
    payload[HPAC_ACK_AT_ACKED] = acked;
    payload[HPAC_ACK_AT_REASON] = (uint8_t)reason;
    payload[HPAC_ACK_AT_SERVO] = servo;
    payload[HPAC_ACK_AT_STATE] = hand->state;
    queue(hand, frame, HPAC_ACK, seq, HPAC_ACK_LENGTH);
}

void hpac_answer_status(hpac_hand_t *hand, uint16_t seq)
{
    uint8_t frame[HPAC_FRAME_MAX];
    uint8_t *payload = frame + HPAC_HEADER_LENGTH;
    hpac_put_u32(payload + HPAC_DEVICE_STATUS_AT_UPTIME_MS, uptime_ms(hand));
    payload[HPAC_DEVICE_STATUS_AT_STATE] = hand->state;
    payload[HPAC_DEVICE_STATUS_AT_FAULT] = hand->fault;
    payload[HPAC_DEVICE_STATUS_AT_ATTACHED] = hand->attached;
    payload[HPAC_DEVICE_STATUS_AT_MOVING] = hand->starting || hpac_ramp_moving(&hand->ramp) ? 1u : 0u;
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        int32_t step = hpac_motion_angle(hand, i) / HPAC_ANGLE_UNIT_URAD;
        hpac_put_u16(payload + HPAC_DEVICE_STATUS_AT_SERVO + 2u * i, (uint16_t)((uint32_t)step & 0xffffu));
        payload[HPAC_DEVICE_STATUS_AT_HEAT_PERCENT + i] = hpac_load_percent(hand->heat[i]);
    }
    hpac_put_u16(payload + HPAC_DEVICE_STATUS_AT_RATE_PERMILLE, hpac_motion_rate_permille(hand));
    hpac_put_u16(payload + HPAC_DEVICE_STATUS_AT_SUPPLY_MV, hand->supply_mv);
    hpac_put_u16(payload + HPAC_DEVICE_STATUS_AT_LAST_SEQ, hand->last_seq);
    hpac_put_u32(payload + HPAC_DEVICE_STATUS_AT_ACCEPTED, hand->count.accepted);
    hpac_put_u16(payload + HPAC_DEVICE_STATUS_AT_REFUSED, hand->count.refused);
    hpac_put_u16(payload + HPAC_DEVICE_STATUS_AT_BAD_CRC, hand->count.bad_crc);
    hpac_put_u16(payload + HPAC_DEVICE_STATUS_AT_BAD_FRAME, hand->count.bad_frame);
    hpac_put_u16(payload + HPAC_DEVICE_STATUS_AT_BAD_VERSION, hand->count.bad_version);
    hpac_put_u16(payload + HPAC_DEVICE_STATUS_AT_OVERRUN, hand->count.overrun);
    hpac_put_u16(payload + HPAC_DEVICE_STATUS_AT_DROPPED, hand->count.dropped);
    hpac_put_u16(payload + HPAC_DEVICE_STATUS_AT_WATCHDOG_TRIPS, hand->count.watchdog_trips);
    queue(hand, frame, HPAC_DEVICE_STATUS, seq, HPAC_DEVICE_STATUS_LENGTH);
}

void hpac_answer_fault(hpac_hand_t *hand, unsigned servo)
{
    uint8_t frame[HPAC_FRAME_MAX];
    uint8_t *payload = frame + HPAC_HEADER_LENGTH;
    payload[HPAC_FAULT_AT_FAULT] = hand->fault;
    payload[HPAC_FAULT_AT_SERVO] = (uint8_t)servo;
    hpac_put_u32(payload + HPAC_FAULT_AT_UPTIME_MS, uptime_ms(hand));
    queue(hand, frame, HPAC_FAULT, 0, HPAC_FAULT_LENGTH);
}
