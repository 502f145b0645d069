#include "hpac_dispatch.h"

#include "hpac_answer.h"
#include "hpac_load.h"
#include "hpac_motion.h"
#include "hpac_state.h"

#define US_PER_MS 1000u
#define ALL_ATTACHED ((1u << HPAC_SERVOS) - 1u)

/* Each handler returns why it refuses, or HPAC_REASON_OK once it has carried the frame out. */

static hpac_reason_t on_hello(hpac_hand_t *hand)
{
    hand->any_move = false;
    hand->status_period_us = 0;
    if (hand->state != HPAC_STATE_FAULT) {
        hpac_state_idle(hand);
    }
    return HPAC_REASON_OK;
}

static hpac_reason_t on_arm(hpac_hand_t *hand, const uint8_t *payload, uint8_t *servo)
{
    uint8_t action = payload[HPAC_ARM_AT_ACTION];
    if (hand->state != HPAC_STATE_IDLE && hand->state != HPAC_STATE_ARMED) {
        return HPAC_REASON_STATE;
    }
    if (hpac_get_u32(payload + HPAC_ARM_AT_LIMITS_HASH) != HPAC_LIMITS_HASH) {
        return HPAC_REASON_LIMITS;
    }
    if (action > HPAC_ACTION_DETACH) {
        return HPAC_REASON_ACTION;
    }
    for (unsigned i = 0; hand->state == HPAC_STATE_IDLE && i < HPAC_SERVOS; i++) {
        if (hpac_load_rate_permille(hand->heat[i]) < 1000u) {
            *servo = (uint8_t)i;
            return HPAC_REASON_HOT;
        }
    }
    hand->action = action;
    if (hand->state == HPAC_STATE_IDLE) {
        hand->state = HPAC_STATE_ARMED;
        hand->armed_us = hand->now_us;
        hpac_state_attach(hand);
    }
    return HPAC_REASON_OK;
}

static hpac_reason_t on_move(hpac_hand_t *hand, const uint8_t *frame, uint8_t *servo)
{
    const uint8_t *payload = frame + HPAC_HEADER_LENGTH;
    uint16_t seq = hpac_get_u16(frame + HPAC_AT_SEQ);
    uint32_t crc = hpac_get_u32(payload + HPAC_MOVE_LENGTH);
    if (hand->state != HPAC_STATE_ARMED) {
        return HPAC_REASON_STATE;
    }
    if (hand->attached != ALL_ATTACHED) {
        return HPAC_REASON_STARTING;
    }
    if (hand->any_move && seq == hand->last_seq && crc == hand->last_move_crc) {
        return HPAC_REASON_OK; /* the same frame again: its ACK was lost, the move already runs */
    }
    uint16_t ahead = (uint16_t)(seq - hand->last_seq);
    if (hand->any_move && (ahead == 0u || ahead >= 0x8000u)) {
        return HPAC_REASON_STALE;
    }
    hpac_reason_t reason = hpac_motion_move(hand, payload, frame[HPAC_AT_FLAGS], servo);
    if (reason == HPAC_REASON_OK) {
        hand->any_move = true;
        hand->last_seq = seq;
        hand->last_move_crc = crc;
    }
    return reason;
}

static hpac_reason_t on_estop(hpac_hand_t *hand)
{
    hpac_state_fault(hand, HPAC_FAULT_ESTOP, HPAC_NO_SERVO);
    return HPAC_REASON_OK;
}

static hpac_reason_t on_clear(hpac_hand_t *hand)
{
    if (hand->state == HPAC_STATE_BOOT || !hand->usable) {
        return HPAC_REASON_STATE;
    }
    hpac_state_idle(hand);
    return HPAC_REASON_OK;
}

static hpac_reason_t on_status(hpac_hand_t *hand, const uint8_t *payload)
{
    uint16_t period_ms = hpac_get_u16(payload + HPAC_STATUS_AT_PERIOD_MS);
    if (period_ms != 0u && period_ms < HPAC_STATUS_MIN_MS) {
        return HPAC_REASON_PERIOD;
    }
    hand->status_period_us = period_ms * US_PER_MS;
    hand->status_us = hand->now_us;
    return HPAC_REASON_OK;
}

typedef struct {
    uint8_t type;
    uint8_t length; /* of the payload */
    uint8_t flags;  /* allowed */
} rule_t;

static hpac_reason_t judge(const uint8_t *frame, size_t payload_length)
{
    static const rule_t rules[] = {
        { HPAC_HELLO, HPAC_HELLO_LENGTH, 0 },
        { HPAC_ARM, HPAC_ARM_LENGTH, 0 },
        { HPAC_MOVE, HPAC_MOVE_LENGTH, HPAC_FLAG_MINIMUM_JERK | HPAC_FLAG_NO_ACK },
        { HPAC_HEARTBEAT, HPAC_HEARTBEAT_LENGTH, HPAC_FLAG_NO_ACK },
        { HPAC_ESTOP, HPAC_ESTOP_LENGTH, 0xffu }, /* nobody's mistake about flags keeps a hand from stopping */
        { HPAC_CLEAR, HPAC_CLEAR_LENGTH, 0 },
        { HPAC_STATUS, HPAC_STATUS_LENGTH, 0 },
    };
    for (size_t i = 0; i < sizeof rules / sizeof rules[0]; i++) {
        if (frame[HPAC_AT_TYPE] == rules[i].type) {
            if (payload_length != rules[i].length) {
                return HPAC_REASON_LENGTH;
            }
            bool allowed = (frame[HPAC_AT_FLAGS] & (uint8_t)~rules[i].flags) == 0u;
            return allowed ? HPAC_REASON_OK : HPAC_REASON_FLAGS;
        }
    }
    return HPAC_REASON_TYPE;
}

static hpac_reason_t carry_out(hpac_hand_t *hand, const uint8_t *frame, uint8_t *servo)
{
    const uint8_t *payload = frame + HPAC_HEADER_LENGTH;
    switch (frame[HPAC_AT_TYPE]) {
    case HPAC_HELLO:
        return on_hello(hand);
    case HPAC_ARM:
        return on_arm(hand, payload, servo);
    case HPAC_MOVE:
        return on_move(hand, frame, servo);
    case HPAC_ESTOP:
        return on_estop(hand);
    case HPAC_CLEAR:
        return on_clear(hand);
    case HPAC_STATUS:
        return on_status(hand, payload);
    default: /* HEARTBEAT: that it came is all it says */
        return HPAC_REASON_OK;
    }
}

void hpac_dispatch(hpac_hand_t *hand)
{
    const uint8_t *frame = hand->rx.frame;
    uint8_t type = frame[HPAC_AT_TYPE];
    uint16_t seq = hpac_get_u16(frame + HPAC_AT_SEQ);
    uint8_t servo = HPAC_NO_SERVO;
    if ((type & 0x80u) != 0u) { /* an echo of our own: answering it could go on for ever */
        hpac_state_count(&hand->count.bad_frame);
        return;
    }
    hpac_reason_t reason = judge(frame, hand->rx.length - HPAC_HEADER_LENGTH - HPAC_CRC_LENGTH);
    if (reason == HPAC_REASON_OK) {
        reason = carry_out(hand, frame, &servo);
    }
    if (reason != HPAC_REASON_OK) {
        hpac_state_count(&hand->count.refused);
        hpac_answer_ack(hand, seq, type, reason, servo);
        return;
    }
    hand->count.accepted++;
    hand->heard_us = hand->now_us;
    if (type == HPAC_HELLO) {
        hpac_answer_hello(hand, seq);
    } else if (type == HPAC_STATUS) {
        hpac_answer_status(hand, seq);
    } else if ((frame[HPAC_AT_FLAGS] & HPAC_FLAG_NO_ACK) == 0u || type == HPAC_ESTOP) {
        hpac_answer_ack(hand, seq, type, reason, servo);
    }
}
