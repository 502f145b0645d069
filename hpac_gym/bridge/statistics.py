"""What a link has counted since it was made."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

_ROUND_TRIPS_KEPT = 100_000


@dataclass(slots=True)
class LinkStatistics:
    """Counters of one `HandLink`, over all of its connections."""

    sent: int = 0
    """Frames written, repeats included."""
    acked: int = 0
    """Frames answered and carried out."""
    retried: int = 0
    """Frames written again because no answer came in time."""
    rejected: int = 0
    """Frames that the hand refused."""
    timeouts: int = 0
    """Frames given up after the last repeat."""
    received: int = 0
    """Intact frames from the hand."""
    bad_frames: int = 0
    """Received pieces that were no frame, boot text among them."""
    bad_bytes: int = 0
    """Their length [bytes]."""
    connections: int = 0
    """Handshakes that succeeded."""
    round_trips: deque[float] = field(default_factory=lambda: deque(maxlen=_ROUND_TRIPS_KEPT), repr=False)
    """From writing a frame to its answer, repeats left out [s]."""

    def round_trip(self, percentile: float) -> float:
        """A percentile of the round trips [s]; NaN before the first."""
        return float(np.percentile(self.round_trips, percentile)) if self.round_trips else float("nan")
