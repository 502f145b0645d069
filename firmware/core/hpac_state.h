/* The hand's states: entering them, and what time does to them. Drawn in firmware/README.md. */
#ifndef HPAC_STATE_H
#define HPAC_STATE_H

#include "hpac_hand.h"

/* One more, unless the counter is at its largest. */
void hpac_state_count(uint16_t *counter);

/* IDLE, without pulses; the commanded pose stays what it was. */
void hpac_state_idle(hpac_hand_t *hand);

/* ARMED: the servos start one after another. */
void hpac_state_arm(hpac_hand_t *hand);

/* FAULT, latched, with the action that this fault asks for; tells the host. `servo` may be HPAC_NO_SERVO. */
void hpac_state_fault(hpac_hand_t *hand, hpac_fault_t fault, unsigned servo);

/* Let time pass: e-stop input, watchdog, start, supply, end of hold and relax, load estimate, periodic STATUS. */
void hpac_state_advance(hpac_hand_t *hand, uint64_t now_us);

#endif
