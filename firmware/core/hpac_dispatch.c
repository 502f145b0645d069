#include "hpac_dispatch.h"

#include "hpac_answer.h"
#include "hpac_load.h"
#include "hpac_motion.h"
#include "hpac_state.h"

#define US_PER_MS 1000u

/* Each handler returns why it refuses, or HPAC_REASON_OK once it has carried the frame out. */

static hpac_reason_t on_hello(hpac_hand_t *hand, const uint8_t *payload)
{
    uint32_t nonce = hpac_get_u32(payload + HPAC_HELLO_AT_NONCE);
    if (nonce == 0u) { /* somebody only looks */
        return HPAC_REASON_OK;
    }
    hand->session = nonce;
    hand->any_move = false;
    hand->watchdog_ms = HPAC_WATCHDOG_MS;
    hand->status_period_us = 0;
    if (hand->state != HPAC_STATE_FAULT) {
        hpac_state_idle(hand);
    }
    return HPAC_REASON_OK;
}

static hpac_reason_t on_arm(hpac_hand_t *hand, const uint8_t *payload, uint8_t *servo)
{
    uint8_t action = payload[HPAC_ARM_AT_ACTION];
    uint16_t watchdog_ms = hpac_get_u16(payload + HPAC_ARM_AT_WATCHDOG_MS);
    if (hand->state != HPAC_STATE_IDLE && hand->state != HPAC_STATE_ARMED) {
        return HPAC_REASON_STATE;
    }
    if (hpac_get_u32(payload + HPAC_ARM_AT_LIMITS_HASH) != hpac_servo_hash(hand->config->servo)) {
        return HPAC_REASON_LIMITS;
    }
    if (action > HPAC_ACTION_DETACH) {
        return HPAC_REASON_ACTION;
    }
    if (watchdog_ms < HPAC_WATCHDOG_MIN_MS || watchdog_ms > HPAC_WATCHDOG_MAX_MS) {
        return HPAC_REASON_PERIOD;
    }
    if (hand->supply_low_us > 0u) {
        return HPAC_REASON_SUPPLY;
    }
    for (unsigned i = 0; hand->state == HPAC_STATE_IDLE && i < HPAC_SERVOS; i++) {
        if (hpac_load_rate_permille(hand->heat[i]) < 1000u) {
            *servo = (uint8_t)i;
            return HPAC_REASON_HOT;
        }
    }
    hand->action = action;
    hand->watchdog_ms = watchdog_ms;
    if (hand->state == HPAC_STATE_IDLE) {
        hpac_state_arm(hand);
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
    if (hand->starting || hand->attached != HPAC_ALL_SERVOS) {
        return HPAC_REASON_STARTING;
    }
    if (hand->repeatable && seq == hand->last_seq && crc == hand->last_move_crc) {
        return HPAC_REASON_OK; /* the same frame again: its ACK was lost, the move already runs */
    }
    uint16_t ahead = (uint16_t)(seq - hand->last_seq);
    if (hand->any_move && (ahead == 0u || ahead >= 0x8000u)) {
        return HPAC_REASON_STALE;
    }
    hpac_reason_t reason = hpac_motion_move(hand, payload, frame[HPAC_AT_FLAGS], servo);
    if (reason == HPAC_REASON_OK) {
        hand->any_move = true;
        hand->repeatable = true;
        hand->last_seq = seq;
        hand->last_move_crc = crc;
    }
    return reason;
}

static hpac_reason_t on_clear(hpac_hand_t *hand)
{
    if (!hpac_servo_all_usable(hand->config->servo)) {
        return HPAC_REASON_STATE;
    }
    if (hand->estop_pressed) {
        return HPAC_REASON_ESTOP;
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
    bool in_session; /* the payload begins with the session */
} rule_t;

static hpac_reason_t judge(const hpac_hand_t *hand, const uint8_t *frame, size_t payload_length)
{
    static const rule_t rules[] = {
        { HPAC_HELLO, HPAC_HELLO_LENGTH, 0, false },
        { HPAC_ARM, HPAC_ARM_LENGTH, 0, true },
        { HPAC_MOVE, HPAC_MOVE_LENGTH, HPAC_FLAG_MINIMUM_JERK | HPAC_FLAG_NO_ACK, true },
        { HPAC_HEARTBEAT, HPAC_HEARTBEAT_LENGTH, HPAC_FLAG_NO_ACK, true },
        { HPAC_CLEAR, HPAC_CLEAR_LENGTH, 0, true },
        { HPAC_STATUS, HPAC_STATUS_LENGTH, 0, false },
    };
    for (size_t i = 0; i < sizeof rules / sizeof rules[0]; i++) {
        if (frame[HPAC_AT_TYPE] == rules[i].type) {
            if (payload_length != rules[i].length) {
                return HPAC_REASON_LENGTH;
            }
            if ((frame[HPAC_AT_FLAGS] & (uint8_t)~rules[i].flags) != 0u) {
                return HPAC_REASON_FLAGS;
            }
            bool ours = hand->session != 0u && hpac_get_u32(frame + HPAC_HEADER_LENGTH) == hand->session;
            return rules[i].in_session && !ours ? HPAC_REASON_SESSION : HPAC_REASON_OK;
        }
    }
    return HPAC_REASON_TYPE;
}

static hpac_reason_t carry_out(hpac_hand_t *hand, const uint8_t *frame, uint8_t *servo)
{
    const uint8_t *payload = frame + HPAC_HEADER_LENGTH;
    switch (frame[HPAC_AT_TYPE]) {
    case HPAC_HELLO:
        return on_hello(hand, payload);
    case HPAC_ARM:
        return on_arm(hand, payload, servo);
    case HPAC_MOVE:
        return on_move(hand, frame, servo);
    case HPAC_CLEAR:
        return on_clear(hand);
    case HPAC_STATUS:
        return on_status(hand, payload);
    default: /* HEARTBEAT: that it came is all it says */
        return HPAC_REASON_OK;
    }
}

/* Whoever says ESTOP, and however: nobody's mistake about flags, payload or version keeps a hand from stopping. */
static void estop(hpac_hand_t *hand, uint16_t seq)
{
    hand->count.accepted++;
    hpac_state_fault(hand, HPAC_FAULT_ESTOP, HPAC_NO_SERVO);
    hpac_answer_ack(hand, seq, HPAC_ESTOP, HPAC_REASON_OK, HPAC_NO_SERVO);
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
    if (type == HPAC_ESTOP) {
        estop(hand, seq);
        return;
    }
    hpac_reason_t reason = judge(hand, frame, hand->rx.length - HPAC_HEADER_LENGTH - HPAC_CRC_LENGTH);
    if (reason == HPAC_REASON_OK) {
        reason = carry_out(hand, frame, &servo);
    }
    if (reason != HPAC_REASON_OK) {
        hpac_state_count(&hand->count.refused);
        hpac_answer_ack(hand, seq, type, reason, servo);
        return;
    }
    hand->count.accepted++;
    if (type == HPAC_HELLO) {
        hpac_answer_hello(hand, seq);
    } else if (type == HPAC_STATUS) {
        hpac_answer_status(hand, seq);
    } else {
        hand->heard_us = hand->now_us; /* only what carries the session comes here */
        if ((frame[HPAC_AT_FLAGS] & HPAC_FLAG_NO_ACK) == 0u) {
            hpac_answer_ack(hand, seq, type, reason, servo);
        }
    }
}

void hpac_dispatch_other_version(hpac_hand_t *hand)
{
    const uint8_t *frame = hand->rx.frame;
    uint8_t type = frame[HPAC_AT_TYPE];
    uint16_t seq = hpac_get_u16(frame + HPAC_AT_SEQ);
    hpac_state_count(&hand->count.bad_version);
    if (type == HPAC_ESTOP) {
        estop(hand, seq);
    } else if (type == HPAC_HELLO) {
        hpac_answer_hello(hand, seq);
    } else if ((type & 0x80u) == 0u) {
        hpac_answer_ack(hand, seq, type, HPAC_REASON_VERSION, HPAC_NO_SERVO);
    }
}
