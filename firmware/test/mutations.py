"""Small faults in C sources, made by rule: delete a statement, flip a comparison, exchange `&&` and `||`,
delete one operand of them, replace an index by 0, add one to a constant, swap two arguments."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Mutant:
    """One fault: `source` with the characters `start` to `end` replaced."""

    source: Path
    rule: str
    start: int
    end: int
    text: str

    def mutated(self, code: str) -> str:
        """The source text with the fault in it."""
        return code[: self.start] + self.text + code[self.end :]

    def describe(self, code: str) -> str:
        """One line that does not change with line numbers."""
        begin = code.rfind("\n", 0, self.start) + 1
        line = self.mutated(code)[
            begin : code.find("\n", self.end) + len(self.text) - (self.end - self.start)
        ]
        return f"{self.source.name}: {self.rule}: {' '.join(line.split())}"


_STATEMENT = re.compile(
    r"^ +(?! |return \S|break|static|const|case|typedef|enum|else|default|\w+ \*?\w+[^;=(]*;)([^;{}#\n]*(?:\n[^;{}#\n]*)*?);",
    re.M,
)
_DECLARATION = re.compile(r"(?:unsigned |const |struct )*\w+ [*]?\w+(?:\[[^]]*\])* =")
_FLIPS = {"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "=="}
_COMPARISON = re.compile(r"(?<=[\w)\]] )(<=|>=|==|!=|<|>)(?= )")
_LEAST = re.compile(r"(?=\b([\w>.()\[\], -]+?) ([<>]) ([\w>.()\[\], *-]+?) \? \1 : \3)")
_LOGIC = re.compile(r"(&&|\|\|)")
_CONSTANT = re.compile(
    r"(?<![\w.#%\[])(\d+u?l?l?|HPAC_[A-Z_]+(?:MS|US|MV|URAD|URAD_S|PERMILLE|MAX|MIN|SERVO|SERVOS|LENGTH|NS))(?![\w.(])"
)
_PARAMETER = re.compile(r"\b\w+_t \*?\w+$")
_INDEX = re.compile(r"\[((?!0[u]?\])[^\[\]\n]+)\](?! = \{)")
_CALL = re.compile(r"\b([a-z_]\w*)\(((?:[^(),]|\([^()]*\))+), ((?:[^(),]|\([^()]*\))+)([,)])")


def _operands(body: str, start: int, end: int) -> list[tuple[int, int]]:
    """Spans whose deletion leaves one operand of the `&&` or `||` at `start` to `end`: the operator
    with the operand before it, and with the one after it.
    """
    left = _edge(body, start - 1, -1, "([{,;?:=")
    right = _edge(body, end, 1, ")]},;?:")
    return [(left, end), (start, right)]


def _edge(body: str, at: int, step: int, stops: str) -> int:
    """Where an operand ends: at a bracket that it lies in, a stop, or another `&&` or `||`."""
    depth = 0
    while 0 < at < len(body) - 1:
        here = body[at]
        pair = body[at : at + 2]
        if depth == 0 and (pair in ("&&", "||") or body[at - 1 : at + 1] in ("&&", "||")):
            break
        if here in "([{" if step > 0 else here in ")]}":
            depth += 1
        elif (
            depth == 0 and here in stops and pair not in ("==", "!=") and body[at - 1] not in "=!<>"
        ):
            break
        elif here in ")]}" if step > 0 else here in "([{":
            depth -= 1
        elif depth == 0 and step < 0 and re.match(r"\breturn\b", body[at - 5 : at + 1]):
            break
        at += step
    return at if step > 0 else at + 1


def mutants_of(source: Path) -> list[Mutant]:
    """Every mutant of one file."""
    code = source.read_text()
    # Without comments, directives, strings and the tables of a CRC.
    nothing = r"/\*.*?\*/|^#.*?(?<!\\)$|\"[^\"\n]*\""
    body = re.sub(nothing, lambda m: " " * len(m[0]), code, flags=re.M | re.S)
    tables = r"\[(?:16|256)\] = \{.*?\};"
    body = re.sub(tables, lambda m: " " * len(m[0]), body, flags=re.S)
    least = [m.start(2) for m in _LEAST.finditer(body)]  # of two equal ones either may be taken
    rules = (  # name, what is replaced: its first group, by what, and where it counts
        (
            "deleted",
            _STATEMENT,
            lambda m: f"/* {' '.join(code[m.start(1) : m.end(1)].split())} */",
            lambda m: not _DECLARATION.match(m[1].strip()) and m[1].count("(") == m[1].count(")"),
        ),
        ("flipped", _COMPARISON, lambda m: _FLIPS[m[1]], lambda m: m.start(1) not in least),
        ("and/or", _LOGIC, lambda m: "||" if m[1] == "&&" else "&&", bool),
        ("constant", _CONSTANT, lambda m: f"({m[1]} + 1)", bool),
        ("indexed", _INDEX, lambda m: "0", lambda m: not _PARAMETER.search(body[: m.start()])),
    )
    found = [
        Mutant(source, rule, m.start(1), m.end(1), text(m))
        for rule, pattern, text, counts in rules
        for m in pattern.finditer(body)
        if counts(m)
    ]
    found += [
        Mutant(source, "operand", start, end, "")
        for m in _LOGIC.finditer(body)
        for start, end in _operands(body, m.start(), m.end())
    ]
    for m in _CALL.finditer(body):
        first = code[m.start(2) : m.end(2)]
        second = code[m.start(3) : m.end(3)]
        own_head = re.search(r"\n\w[^;{]*$", body[: m.start()])  # of a function
        if first != second and not own_head:
            found.append(Mutant(source, "swapped", m.start(2), m.end(3), f"{second}, {first}"))
    return found
