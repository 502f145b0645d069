/* The hand's states: entering them, and what time does to them. Drawn in firmware/README.md. */
#ifndef HPAC_STATE_H
#define HPAC_STATE_H

#include "hpac_hand.h"

/* One more, unless the counter is at its largest. */
void hpac_state_count(uint16_t *counter);

/* No pulses, no motion; the pose is rest. */
void hpac_state_detach(hpac_hand_t *hand);

/* IDLE, without pulses. */
void hpac_state_idle(hpac_hand_t *hand);

/* FAULT, latched, with the action that this fault asks for; tells the host. `servo` may be HPAC_NO_SERVO. */
void hpac_state_fault(hpac_hand_t *hand, hpac_fault_t fault, unsigned servo);

/* While armed: pulses for every servo whose turn has come. */
void hpac_state_attach(hpac_hand_t *hand);

/* Let time pass: watchdog, staggered start, end of relax, load estimate, periodic STATUS. */
void hpac_state_advance(hpac_hand_t *hand, uint64_t now_us);

#endif
