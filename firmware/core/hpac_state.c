#include "hpac_state.h"

#include "hpac_answer.h"
#include "hpac_load.h"
#include "hpac_motion.h"

#define US_PER_MS 1000u
#define STEP_MAX_US (HPAC_STEP_MAX_MS * US_PER_MS)
#define HOLD_MAX_US (HPAC_HOLD_MAX_MS * US_PER_MS)
/* A longer silence between two calls says nothing about the servos' heat. */
#define LOAD_STEPS_MAX 100

void hpac_state_count(uint16_t *counter)
{
    if (*counter < UINT16_MAX) {
        (*counter)++;
    }
}

/* No pulses. The last move is not repeatable: a repeat that comes now would be acknowledged and never run. */
static void detach(hpac_hand_t *hand)
{
    hand->attached = 0;
    hand->starting = false;
    hand->relaxing = false;
    hand->holding = false;
    hand->repeatable = false;
}

void hpac_state_idle(hpac_hand_t *hand)
{
    hpac_motion_stop(hand);
    detach(hand);
    hand->state = HPAC_STATE_IDLE;
    hand->fault = HPAC_FAULT_NONE;
}

void hpac_state_arm(hpac_hand_t *hand)
{
    hand->state = HPAC_STATE_ARMED;
    hand->starting = true;
    hand->start_left_us = HPAC_POWER_ON_MS * US_PER_MS;
}

static void relax(hpac_hand_t *hand)
{
    if (!hand->relaxing) { /* one that begins anew has no more time */
        hand->safe_until_us = hand->now_us + hpac_motion_relax_max_us(hand);
    }
    hand->relaxing = true;
    hand->holding = false;
    hpac_motion_relax(hand);
}

static hpac_action_t action_of(const hpac_hand_t *hand, hpac_fault_t fault)
{
    if (fault == HPAC_FAULT_OVERLOAD) {
        return HPAC_ACTION_RELAX;
    }
    return fault == HPAC_FAULT_WATCHDOG ? (hpac_action_t)hand->action : HPAC_ACTION_DETACH;
}

void hpac_state_fault(hpac_hand_t *hand, hpac_fault_t fault, unsigned servo)
{
    hpac_action_t action = action_of(hand, fault);
    hand->state = HPAC_STATE_FAULT;
    if (hand->fault == HPAC_FAULT_CONFIG && hand->attached == 0u) {
        hpac_answer_fault(hand, servo); /* with that table there is nothing to stop and nothing to compute */
        return;
    }
    hand->fault = (uint8_t)fault;
    hand->starting = false;
    if (fault == HPAC_FAULT_INTERNAL) { /* nothing of the motion can be trusted but its last good output */
        hpac_motion_stand(hand, hand->pose);
    } else {
        hpac_motion_stop(hand);
    }
    if (action == HPAC_ACTION_RELAX) {
        relax(hand);
    } else if (action == HPAC_ACTION_HOLD) {
        hand->holding = true;
        hand->safe_until_us = hand->now_us + HOLD_MAX_US;
    } else {
        detach(hand);
    }
    hpac_answer_fault(hand, servo);
}

/* Take up the time. Returns for how long motions may go on: a late call brings no more than STEP_MAX_US between two
 * outputs, and what it holds back is counted. */
static uint32_t pass(hpac_hand_t *hand, uint64_t now_us)
{
    if (!hand->started) {
        hand->started = true;
        hand->now_us = now_us;
        hand->load_us = now_us;
    } else if (hand->now_us != ~hand->not_now_us || hand->now_us > now_us + HPAC_CLOCK_BACK_MAX_MS * US_PER_MS) {
        hand->now_us = now_us;
        hpac_state_fault(hand, HPAC_FAULT_INTERNAL, HPAC_NO_SERVO);
    }
    uint64_t late_us = now_us > hand->now_us ? now_us - hand->now_us : 0u;
    uint32_t room_us = hand->step_us < STEP_MAX_US ? STEP_MAX_US - hand->step_us : 0u;
    uint32_t step_us = late_us < room_us ? (uint32_t)late_us : room_us;
    uint64_t behind_us = hand->behind_us + (late_us - step_us);
    hand->behind_us = behind_us < UINT32_MAX ? (uint32_t)behind_us : UINT32_MAX;
    hand->now_us += late_us;
    hand->not_now_us = ~hand->now_us;
    hand->step_us += step_us;
    return step_us;
}

/* True if no single bit of the state has turned by itself into something that the rest denies. */
static bool sound(const hpac_hand_t *hand)
{
    bool powered = hand->attached != 0u;
    bool faulty = hand->fault != HPAC_FAULT_NONE;
    bool in_order = false;
    if (hand->state == HPAC_STATE_BOOT || hand->state == HPAC_STATE_IDLE) {
        in_order = !powered && !faulty;
    } else if (hand->state == HPAC_STATE_ARMED) {
        in_order = !faulty;
    } else if (hand->state == HPAC_STATE_FAULT) {
        uint32_t longest_us = hand->relaxing ? hpac_motion_relax_max_us(hand) : HOLD_MAX_US;
        in_order = faulty && (!powered || ((hand->relaxing || hand->holding) && hand->safe_until_us <= hand->now_us + longest_us));
    }
    return in_order && (hand->fault == HPAC_FAULT_CONFIG ? !powered : hpac_motion_sound(hand));
}

static void watch_estop_input(hpac_hand_t *hand)
{
    bool nothing_to_stop = hand->fault == HPAC_FAULT_ESTOP || hand->fault == HPAC_FAULT_CONFIG;
    if (hand->estop_pressed && !nothing_to_stop) {
        hpac_state_fault(hand, HPAC_FAULT_ESTOP, HPAC_NO_SERVO);
    }
}

static void watch_host(hpac_hand_t *hand)
{
    uint32_t watchdog_ms = hand->watchdog_ms < HPAC_WATCHDOG_MAX_MS ? hand->watchdog_ms : HPAC_WATCHDOG_MAX_MS;
    if (hand->state == HPAC_STATE_ARMED && hand->now_us - hand->heard_us >= watchdog_ms * US_PER_MS) {
        hpac_state_count(&hand->count.watchdog_trips);
        hpac_state_fault(hand, HPAC_FAULT_WATCHDOG, HPAC_NO_SERVO);
    }
}

static void watch_supply(hpac_hand_t *hand, uint32_t step_us)
{
    bool low = hand->supply_mv != 0u && hand->supply_mv < HPAC_SUPPLY_MIN_MV;
    uint32_t most_us = HPAC_SUPPLY_LOW_MS * US_PER_MS, left_us = most_us - hand->supply_low_us;
    hand->supply_low_us = low ? hand->supply_low_us + (step_us < left_us ? step_us : left_us) : 0u;
    if (hand->state == HPAC_STATE_ARMED && hand->supply_low_us >= most_us) {
        hpac_state_fault(hand, HPAC_FAULT_SUPPLY, HPAC_NO_SERVO);
    }
}

/* Servo after servo gets pulses where it stands, as far as that is known; then all go to rest together, slowly. */
static void start_servos(hpac_hand_t *hand, uint32_t step_us)
{
    if (hand->state != HPAC_STATE_ARMED || !hand->starting) {
        return;
    }
    hand->start_left_us -= step_us < hand->start_left_us ? step_us : hand->start_left_us;
    if (hand->start_left_us > 0u || hpac_ramp_moving(&hand->ramp)) {
        return;
    }
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        if ((hand->attached & (1u << i)) == 0u) {
            hand->start_left_us = hpac_motion_start_us(hand, i);
            hpac_motion_place(hand, i);
            hand->attached = (uint8_t)(hand->attached | (1u << i));
            hand->placed = (uint8_t)(hand->placed | (1u << i));
            return;
        }
    }
    hand->starting = !hpac_motion_at_rest(hand);
    if (hand->starting) {
        hpac_motion_relax(hand);
    }
}

/* A safe action ends in seconds of the clock, however rarely the board calls: late calls slow a motion down, but nobody
 * should have to wait for them until the grip is off. */
static void end_safe_action(hpac_hand_t *hand)
{
    if (hand->state != HPAC_STATE_FAULT) {
        return;
    }
    bool over = hand->now_us >= hand->safe_until_us;
    if (hand->relaxing && (over || !hpac_ramp_moving(&hand->ramp))) {
        detach(hand);
    } else if (hand->holding && over) {
        relax(hand);
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
            hpac_state_fault(hand, HPAC_FAULT_OVERLOAD, i);
            already = true;
        }
    }
}

void hpac_state_advance(hpac_hand_t *hand, uint64_t now_us)
{
    uint32_t step_us = pass(hand, now_us);
    if (!sound(hand)) {
        hpac_state_fault(hand, HPAC_FAULT_INTERNAL, HPAC_NO_SERVO);
    }
    hpac_ramp_advance(&hand->ramp, step_us);
    if (!hpac_ramp_moving(&hand->ramp)) {
        hand->behind_us = 0;
    }
    watch_estop_input(hand);
    watch_host(hand);
    watch_supply(hand, step_us);
    start_servos(hand, step_us);
    end_safe_action(hand);
    step_load(hand);
    watch_load(hand);
    if (hand->status_period_us != 0u && hand->now_us - hand->status_us >= hand->status_period_us) {
        hand->status_us = hand->now_us;
        hpac_answer_status(hand, 0);
    }
}
