/* One intact frame: judged, carried out whole or refused whole, and answered. */
#ifndef HPAC_DISPATCH_H
#define HPAC_DISPATCH_H

#include "hpac_hand.h"

/* Take the frame in hand->rx. */
void hpac_dispatch(hpac_hand_t *hand);

#endif
