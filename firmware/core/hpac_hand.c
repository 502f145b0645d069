#include "hpac_hand.h"

#include "hpac_answer.h"
#include "hpac_load.h"
#include "hpac_motion.h"

#define US_PER_MS 1000u
#define ALL_ATTACHED ((1u << HPAC_SERVOS) - 1u)
/* A longer silence between two calls says nothing about the servos' heat. */
#define LOAD_STEPS_MAX 100

void hpac_config_default(hpac_config_t *config)
{
    static const hpac_servo_t table[HPAC_SERVOS] = HPAC_SERVO_TABLE;
    for (int i = 0; i < HPAC_SERVOS; i++) {
        config->servo[i] = table[i];
    }
}

static void count(uint16_t *counter)
{
    if (*counter < UINT16_MAX) {
        (*counter)++;
    }
}

static void detach(hpac_hand_t *hand)
{
    hpac_motion_rest(hand);
    hand->attached = 0;
    hand->relaxing = false;
}

static void go_idle(hpac_hand_t *hand)
{
    detach(hand);
    hand->state = HPAC_STATE_IDLE;
    hand->fault = HPAC_FAULT_NONE;
}

static void enter_fault(hpac_hand_t *hand, hpac_fault_t fault, unsigned servo)
{
    hpac_action_t action = HPAC_ACTION_DETACH;
    if (fault == HPAC_FAULT_WATCHDOG) {
        action = (hpac_action_t)hand->action;
    } else if (fault == HPAC_FAULT_OVERLOAD) {
        action = HPAC_ACTION_RELAX;
    }
    hand->state = HPAC_STATE_FAULT;
    hand->fault = (uint8_t)fault;
    hpac_motion_stop(hand);
    hand->relaxing = action == HPAC_ACTION_RELAX;
    if (hand->relaxing) {
        hpac_motion_relax(hand);
    } else if (action == HPAC_ACTION_DETACH) {
        detach(hand);
    }
    hpac_answer_fault(hand, servo);
}

void hpac_hand_init(hpac_hand_t *hand, const hpac_config_t *config, hpac_reset_t reset, uint16_t boot_count)
{
    *hand = (hpac_hand_t){ .config = *config, .reset = (uint8_t)reset, .boot_count = boot_count, .usable = true };
    hpac_rx_init(&hand->rx);
    for (int i = 0; i < HPAC_SERVOS; i++) {
        hand->usable = hand->usable && hpac_servo_usable(&config->servo[i]);
    }
    detach(hand);
    hand->state = HPAC_STATE_BOOT;
    if (!hand->usable) {
        enter_fault(hand, HPAC_FAULT_CONFIG, HPAC_NO_SERVO);
    } else if (reset == HPAC_RESET_BROWNOUT) {
        enter_fault(hand, HPAC_FAULT_BROWNOUT, HPAC_NO_SERVO);
    } else if (reset == HPAC_RESET_CRASH) {
        enter_fault(hand, HPAC_FAULT_CRASH, HPAC_NO_SERVO);
    }
}

/* --- time ------------------------------------------------------------------------------------------------------- */

static void watch_host(hpac_hand_t *hand)
{
    if (hand->state == HPAC_STATE_ARMED && hand->now_us - hand->heard_us >= HPAC_WATCHDOG_MS * US_PER_MS) {
        count(&hand->count.watchdog_trips);
        enter_fault(hand, HPAC_FAULT_WATCHDOG, HPAC_NO_SERVO);
    }
}

static void attach_in_turn(hpac_hand_t *hand)
{
    for (unsigned i = 0; hand->state == HPAC_STATE_ARMED && i < HPAC_SERVOS; i++) {
        if (hand->now_us - hand->armed_us >= (uint64_t)i * HPAC_STAGGER_MS * US_PER_MS) {
            hand->attached = (uint8_t)(hand->attached | (1u << i));
        }
    }
}

static void step_load(hpac_hand_t *hand)
{
    for (int steps = 0; hand->now_us - hand->load_us >= HPAC_LOAD_STEP_US; steps++) {
        if (steps == LOAD_STEPS_MAX) {
            hand->load_us = hand->now_us;
            return;
        }
        hand->load_us += HPAC_LOAD_STEP_US;
        for (unsigned i = 0; i < HPAC_SERVOS; i++) {
            hand->heat[i] = hpac_load_step(hand->heat[i], hpac_motion_effort(hand, i));
        }
    }
}

static void watch_load(hpac_hand_t *hand)
{
    bool already = hand->fault == HPAC_FAULT_OVERLOAD;
    for (unsigned i = 0; hand->attached != 0u && !already && i < HPAC_SERVOS; i++) {
        if (hand->heat[i] >= HPAC_HEAT_LIMIT) {
            enter_fault(hand, HPAC_FAULT_OVERLOAD, i);
            already = true;
        }
    }
}

static void advance(hpac_hand_t *hand, uint64_t now_us)
{
    if (!hand->started) {
        hand->started = true;
        hand->load_us = now_us;
    }
    hand->now_us = now_us > hand->now_us ? now_us : hand->now_us;
    watch_host(hand);
    attach_in_turn(hand);
    if (hand->relaxing && !hpac_ramp_moving(&hand->ramp, hand->now_us)) {
        detach(hand);
    }
    step_load(hand);
    watch_load(hand);
    if (hand->status_period_us != 0u && hand->now_us - hand->status_us >= hand->status_period_us) {
        hand->status_us = hand->now_us;
        hpac_answer_status(hand, 0);
    }
}

void hpac_hand_tick(hpac_hand_t *hand, uint64_t now_us, uint32_t pulses[HPAC_SERVOS])
{
    advance(hand, now_us);
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        const hpac_servo_t *servo = &hand->config.servo[i];
        int32_t urad = hpac_motion_angle(hand, i);
        if (hand->attached != 0u && (urad < servo->min_urad || urad > servo->max_urad)) {
            enter_fault(hand, HPAC_FAULT_INTERNAL, i);
        }
    }
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        bool attached = (hand->attached & (1u << i)) != 0u;
        pulses[i] = attached ? hpac_servo_pulse(&hand->config.servo[i], hpac_motion_angle(hand, i)) : 0u;
    }
}

/* --- frames: each returns why it refuses, or HPAC_REASON_OK once it has been carried out ------------------------ */

static hpac_reason_t on_hello(hpac_hand_t *hand)
{
    hand->any_move = false;
    hand->status_period_us = 0;
    if (hand->state != HPAC_STATE_FAULT) {
        go_idle(hand);
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
        attach_in_turn(hand);
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
    enter_fault(hand, HPAC_FAULT_ESTOP, HPAC_NO_SERVO);
    return HPAC_REASON_OK;
}

static hpac_reason_t on_clear(hpac_hand_t *hand)
{
    if (hand->state == HPAC_STATE_BOOT || !hand->usable) {
        return HPAC_REASON_STATE;
    }
    go_idle(hand);
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

static void on_frame(hpac_hand_t *hand)
{
    const uint8_t *frame = hand->rx.frame;
    uint8_t type = frame[HPAC_AT_TYPE];
    uint16_t seq = hpac_get_u16(frame + HPAC_AT_SEQ);
    uint8_t servo = HPAC_NO_SERVO;
    if ((type & 0x80u) != 0u) { /* an echo of our own: answering it could go on for ever */
        count(&hand->count.bad_frame);
        return;
    }
    hpac_reason_t reason = judge(frame, hand->rx.length - HPAC_HEADER_LENGTH - HPAC_CRC_LENGTH);
    if (reason == HPAC_REASON_OK) {
        reason = carry_out(hand, frame, &servo);
    }
    if (reason != HPAC_REASON_OK) {
        count(&hand->count.refused);
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

static void on_other_version(hpac_hand_t *hand)
{
    count(&hand->count.bad_version);
    if (hand->rx.frame[HPAC_AT_TYPE] == HPAC_HELLO) {
        hpac_answer_hello(hand, hpac_get_u16(hand->rx.frame + HPAC_AT_SEQ));
    }
}

void hpac_hand_receive(hpac_hand_t *hand, uint64_t now_us, const uint8_t *bytes, size_t length)
{
    advance(hand, now_us);
    for (size_t i = 0; i < length; i++) {
        switch (hpac_rx_push(&hand->rx, bytes[i])) {
        case HPAC_RX_MORE:
            break;
        case HPAC_RX_FRAME:
            on_frame(hand);
            break;
        case HPAC_RX_VERSION:
            on_other_version(hand);
            break;
        case HPAC_RX_CRC:
            count(&hand->count.bad_crc);
            break;
        case HPAC_RX_BAD:
            count(&hand->count.bad_frame);
            break;
        case HPAC_RX_OVERRUN:
            count(&hand->count.overrun);
            break;
        }
    }
}
