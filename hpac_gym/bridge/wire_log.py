"""A log of every frame, one JSON object a line."""

from __future__ import annotations

import json
from os import PathLike

from hpac_gym.bridge.frame import Frame
from hpac_gym.bridge.protocol import MESSAGE_BY_CODE, Reason, State, name_of


class WireLog:
    """Writes frames as they pass; a context manager.

    Each line has `t` [s], `direction` (`sent` or `received`), `hex` (the frame between its zeros), `message`, `seq`,
    `flags` and `fields` (raw integers, units in docs/wire.md). An ACK's line also has `acked`, `reason` and `state` by
    name, and every answer `round_trip` [s].

    Raises:
        OSError: The file cannot be written.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        self._file = open(path, "w", encoding="utf-8")  # noqa: SIM115 - closed by close()

    def __enter__(self) -> WireLog:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def record(self, time: float, direction: str, encoded: bytes, frame: Frame, round_trip: float | None = None) -> None:
        """Write one line; `round_trip` [s] if the frame is an answer."""
        line = {
            "t": round(time, 6),
            "direction": direction,
            "hex": encoded.hex(),
            "message": frame.name,
            "seq": frame.seq,
            "flags": frame.flags,
            "fields": dict(frame.fields),
        }
        if frame.name == "ack":
            acked = MESSAGE_BY_CODE.get(frame.fields["acked"])
            line["acked"] = acked.name if acked else f"unknown_{frame.fields['acked']}"
            line["reason"] = name_of(Reason, frame.fields["reason"])
            line["state"] = name_of(State, frame.fields["state"])
        if round_trip is not None:
            line["round_trip"] = round(round_trip, 7)
        self._file.write(json.dumps(line) + "\n")

    def close(self) -> None:
        """Finish the file."""
        self._file.close()
