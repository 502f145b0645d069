#include "hpac_state.h"

#include "hpac_answer.h"
#include "hpac_load.h"
#include "hpac_motion.h"

#define US_PER_MS 1000u
/* A longer silence between two calls says nothing about the servos' heat. */
#define LOAD_STEPS_MAX 100

void hpac_state_count(uint16_t *counter)
{
    if (*counter < UINT16_MAX) {
        (*counter)++;
    }
}

void hpac_state_detach(hpac_hand_t *hand)
{
    hpac_motion_rest(hand);
    hand->attached = 0;
    hand->relaxing = false;
}

void hpac_state_idle(hpac_hand_t *hand)
{
    hpac_state_detach(hand);
    hand->state = HPAC_STATE_IDLE;
    hand->fault = HPAC_FAULT_NONE;
}

void hpac_state_fault(hpac_hand_t *hand, hpac_fault_t fault, unsigned servo)
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
        hpac_state_detach(hand);
    }
    hpac_answer_fault(hand, servo);
}

static void watch_host(hpac_hand_t *hand)
{
    if (hand->state == HPAC_STATE_ARMED && hand->now_us - hand->heard_us >= HPAC_WATCHDOG_MS * US_PER_MS) {
        hpac_state_count(&hand->count.watchdog_trips);
        hpac_state_fault(hand, HPAC_FAULT_WATCHDOG, HPAC_NO_SERVO);
    }
}

void hpac_state_attach(hpac_hand_t *hand)
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
            hpac_state_fault(hand, HPAC_FAULT_OVERLOAD, i);
            already = true;
        }
    }
}

void hpac_state_advance(hpac_hand_t *hand, uint64_t now_us)
{
    if (!hand->started) {
        hand->started = true;
        hand->load_us = now_us;
    }
    hand->now_us = now_us > hand->now_us ? now_us : hand->now_us;
    watch_host(hand);
    hpac_state_attach(hand);
    if (hand->relaxing && !hpac_ramp_moving(&hand->ramp, hand->now_us)) {
        hpac_state_detach(hand);
    }
    step_load(hand);
    watch_load(hand);
    if (hand->status_period_us != 0u && hand->now_us - hand->status_us >= hand->status_period_us) {
        hand->status_us = hand->now_us;
        hpac_answer_status(hand, 0);
    }
}
