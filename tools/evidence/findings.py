"""What the oracle finds."""

from collections import Counter
from dataclasses import dataclass

RULES = ("range", "rate", "start", "unarmed", "estop", "silence", "accept")


@dataclass(frozen=True, slots=True)
class Complaint:
    """A violated rule."""

    rule: str
    now_us: int
    text: str


class Findings:
    """The violations found so far.

    Attributes:
        complaints: the first hundred violations, in order.
        broken: number of violations, by rule.
        tried: number of checks of each of `RULES`.
    """

    def __init__(self) -> None:
        self.complaints: list[Complaint] = []
        self.broken: Counter[str] = Counter()
        self.tried: Counter[str] = Counter(dict.fromkeys(RULES, 0))

    def complain(self, rule: str, now_us: int, text: str) -> None:
        """Note a violation."""
        self.broken[rule] += 1
        if len(self.complaints) < 100:
            self.complaints.append(Complaint(rule, now_us, text))
