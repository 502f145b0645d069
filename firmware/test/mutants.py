"""Mutants: small faults made by rule in the firmware's sources, each of which the tests must
notice.

`make -C firmware mutants` makes them all over core and ESP32 port and prints the score; it takes
tens of minutes. What it has found stands in build/mutants.txt, and a run that was cut short goes on
from there: a mutant that was noticed is not tried again while its source stays as it is, a survivor
is. `--sample N` draws N of them. `--controls` tries the `named_faults` alone, in seconds: the
negative controls of the tests themselves.

The rules are in `mutations`. A mutant that compiles to the same object code is no mutant. The judges
run in turn, the quickest first, until one notices: the unit tests, the hostile host, the flipped bits
(core) or the chips that are not there (port); and once more with sanitizers."""

from __future__ import annotations

import argparse
import hashlib
import random
import subprocess
import sys
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock

from mutations import Mutant, mutants_of
from named_faults import CONTROLS

FIRMWARE = Path(__file__).parents[1]
BOARD = FIRMWARE / "board"
PORT = BOARD / "esp32"
JUDGES = {"plain": ("glance", "unit", "driver", "flips"), "sanitized": ("unit", "driver")}
FRAMES = {"glance": "15000", "driver": "150000"}
"""A glance is the hostile host for a moment."""
VARIANTS = {
    "esp32": ("-DSTUB_TARGET=32", "-DSUPPLY_ADC_CHANNEL=6"),
    "c6": (
        "-DSTUB_TARGET=6",
        "-DESTOP_PIN=11",
        "-DSUPPLY_ADC_CHANNEL=0",
        "-DSERVO_TRIMS_NS=0, -1, 1, -20000, 20000, 300",
        "-DSERVO_DIRECTIONS=1, -1, 1, 1, -1, 1",
    ),
    "c3": ("-DSTUB_TARGET=13", "-DPORT_IS_USB=1", "-DESTOP_PIN=0"),
    "s3": ("-DSTUB_TARGET=3", "-DSERVOS_ON_PCA9685=1", "-DESTOP_PIN=18", "-DSUPPLY_ADC_CHANNEL=0"),
}
"""The chips and wirings of board/esp32/test/check.sh, which the port is tested with."""

RECORD = FIRMWARE / "build" / "mutants.txt"
"""What was noticed before."""
EQUIVALENT = FIRMWARE / "test" / "mutants.txt"
"""Survivors that were looked at: one line each, `file: rule: code | reason`; `=` before it if
nothing that the hand does differs. Those are not tried again and left out of the score, the others
count against it."""


PATIENCE = {"plain": 15, "sanitized": 60}
"""A judge that takes more processor time hangs; the slowest takes a few seconds [s]."""


class Workshop:
    """Compiles mutants beside objects of all that stays as it is."""

    def __init__(self, folder: Path, compiler: str, flags: tuple[str, ...]) -> None:
        folder.mkdir()
        self.folder = folder
        self.compiler = compiler
        self.flags = ("-std=gnu11", *flags, "-g0", "-w")
        test = FIRMWARE / "test"
        self.core = sorted((FIRMWARE / "core").glob("*.c"))
        self.port = [*sorted((PORT / "main").glob("*.c")), BOARD / "loop.c"]
        hostile = [test / "oracle.c", test / "driver.c"]
        self.harness = {
            "glance": hostile,
            "driver": hostile,
            "unit": [test / "bench.c", test / "oracle.c", *(test / "unit").glob("*.c")],
            "flips": [test / "bench.c", test / "oracle.c", test / "flips.c"],
        } | {chip: [test / "oracle.c", *(PORT / "test").glob("*.c")] for chip in VARIANTS}
        self.objects: dict[tuple[Path, str], Path] = {}
        self.lock = Lock()

    def object_of(self, path: Path, variant: str) -> Path:
        """The object file of a source as it is, compiled when it is needed first."""
        with self.lock:
            if (path, variant) not in self.objects:
                self.objects[path, variant] = self.compile(path, path, variant)
            return self.objects[path, variant]

    def compile(
        self, path: Path, origin: Path, variant: str, name: str | None = None
    ) -> Path | None:
        """The object file of a source, compiled as its origin is; None if it does not compile."""
        target = self.folder / f"{name or origin.parent.name + '_' + origin.stem}{variant}.o"
        test = FIRMWARE / "test"
        folders = [FIRMWARE / "core", test, test / "unit", origin.parent]
        folders += [BOARD, PORT / "test", PORT / "test" / "stubs", PORT / "main"] if variant else []
        includes = [f"-I{folder}" for folder in folders]
        command = [
            self.compiler,
            *self.flags,
            *VARIANTS.get(variant, ()),
            *includes,
            "-c",
            "-xc",
            "-",  # so that the object does not tell the file's name
            "-o",
            target,
        ]
        done = subprocess.run(command, input=path.read_bytes(), capture_output=True, check=False)
        return target if done.returncode == 0 else None

    def notices(self, judge: str, mutated: Path, instead_of: Path, name: str) -> bool:
        """Whether a judge fails, crashes or hangs with one object put in another one's place."""
        ours = [(path, "") for path in self.core] + [
            (path, judge) for path in self.port if judge in VARIANTS
        ]
        ours += [(path, judge if BOARD in path.parents else "") for path in self.harness[judge]]
        objects = [
            mutated if path == instead_of else self.object_of(path, variant)
            for path, variant in ours
        ]
        program = self.folder / f"{name}_{judge}"
        link = [self.compiler, *self.flags, "-o", program, *objects, "-lm"]
        if subprocess.run(link, capture_output=True, check=False).returncode != 0:
            return True
        arguments = (
            [FRAMES[judge], "3"] if judge in FRAMES else ["first"] if judge == "flips" else []
        )
        limited = [
            "sh",
            "-c",
            f'ulimit -t {PATIENCE[self.folder.name]}; exec "$0" "$@"',
            program,
            *arguments,
        ]
        answer = subprocess.run(limited, capture_output=True, check=False)
        program.unlink()
        return answer.returncode != 0


def judge_mutant(workshops: list[Workshop], mutant: Mutant, number: int) -> str:
    """Who noticed a mutant: a judge's name, `same` for the same object code, `none` if it does not
    compile, or ``.
    """
    for workshop in workshops:
        source = workshop.folder / f"m{number}.c"
        source.write_text(mutant.mutated(mutant.source.read_text()))
        mutated: dict[str, Path | None] = {}
        differs = False
        for judge in VARIANTS if BOARD in mutant.source.parents else JUDGES[workshop.folder.name]:
            variant = judge if judge in VARIANTS else ""
            if variant not in mutated:
                mutated[variant] = workshop.compile(source, mutant.source, variant, f"m{number}")
            ours = mutated[variant]
            if ours is None:
                return "none"
            if ours.read_bytes() != workshop.object_of(mutant.source, variant).read_bytes():
                differs = True
                if workshop.notices(judge, ours, mutant.source, f"m{number}"):
                    return judge
        if not differs:
            return "same"
    return ""


def _line(mutant: Mutant) -> str:
    return mutant.describe(mutant.source.read_text())


def _key(mutant: Mutant) -> str:
    """What a verdict holds for: the mutated source, to the letter."""
    return hashlib.sha256(
        (mutant.source.name + mutant.mutated(mutant.source.read_text())).encode()
    ).hexdigest()[:20]


def _judge_once(
    workshops: list[Workshop], mutant: Mutant, number: int, noticed: dict[str, str]
) -> str:
    """A mutant's verdict, taken from the record or written into it."""
    key = _key(mutant)
    if key in noticed:
        return noticed[key]
    verdict = judge_mutant(workshops, mutant, number)
    if verdict == "":
        print(f"survives: {_line(mutant)}", file=sys.stderr, flush=True)
    else:
        with RECORD.open("a") as file:
            file.write(f"{key} {verdict}\n")
    return verdict


def judge_all(workshops: list[Workshop], mutants: list[Mutant], jobs: int, sampled: bool) -> int:
    """Judge mutants and print the score and the survivors."""
    lines = [
        line for line in EQUIVALENT.read_text().splitlines() if line and not line.startswith("#")
    ]
    known = dict(line.rsplit(" | ", 1) for line in lines)
    noticed_before = (
        dict(line.split() for line in RECORD.read_text().splitlines()) if RECORD.exists() else {}
    )
    noticed_before |= {
        _key(mutant): "equivalent" for mutant in mutants if "= " + _line(mutant) in known
    }
    with ThreadPoolExecutor(jobs) as pool:
        pairs = enumerate(mutants)
        verdicts = list(
            pool.map(lambda pair: _judge_once(workshops, pair[1], pair[0], noticed_before), pairs)
        )
    tally: dict[str, Counter] = {}
    unlisted = 0
    for mutant, verdict in zip(mutants, verdicts, strict=True):
        line = _line(mutant)
        if verdict == "":
            unlisted += line not in known
            print(f"survived: {line}" + (f" | {known[line]}" if line in known else ""))
        tally.setdefault(mutant.source.name, Counter())[verdict or "survived"] += 1
    tally["all"] = total = sum(tally.values(), Counter())
    print(f"{'file':20} {'mutants':>8} {'noticed':>8} {'survived':>8} {'equivalent':>10}")
    for name, counts in tally.items():
        equivalent = counts["equivalent"] + counts["same"]
        noticed = sum(counts[judge] for judge in (*JUDGES["plain"], *VARIANTS))
        print(
            f"{name:20} {noticed + counts['survived']:8} {noticed:8} {counts['survived']:8} {equivalent:10}"
        )
    share = 100 * noticed / (noticed + total["survived"])
    of = ""
    if sampled:
        # Imported here: the firmware's checks run without the package.
        from hpac_gym.evaluation.statistics import wilson_interval

        low, high = wilson_interval(noticed, noticed + total["survived"])
        of = f", a sample: 95 % interval {100 * low:.1f} to {100 * high:.1f} %"
    print(
        f"mutants: {noticed} of {noticed + total['survived']} that change behaviour noticed, {share:.1f} % (mark: 95){of}"
    )
    return 0 if share >= 95 and not unlisted else 1


def judge_controls(workshop: Workshop) -> int:
    """Judge the named faults; each must be noticed by its judge."""
    missed = 0
    for number, (name, file, text, replacement, judge) in enumerate(CONTROLS):
        source = FIRMWARE / "core" / f"hpac_{file}.c"
        code = source.read_text()
        if code.count(text) != 1:
            sys.exit(
                f"control {name!r}: its text stands {code.count(text)} times in {source.name}; bring test/mutants.py up to date"
            )
        path = workshop.folder / f"c{number}.c"
        path.write_text(code.replace(text, replacement))
        mutated = workshop.compile(path, source, "", f"c{number}")
        if mutated is None or not workshop.notices(judge, mutated, source, f"c{number}"):
            missed += 1
            print(f"not noticed by {judge}: {name}")
    print(
        f"controls: {len(CONTROLS) - missed} of {len(CONTROLS)} named faults noticed by the judge that must"
    )
    return 1 if missed else 0


def main() -> int:
    """Judge mutants or controls; the exit status tells whether the mark is reached and every
    survivor has a reason.
    """
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cc", default="cc", help="C compiler")
    parser.add_argument("--controls", action="store_true", help="the named faults alone")
    parser.add_argument("--jobs", type=int, default=2, help="mutants at a time")
    parser.add_argument("--sample", type=int, help="so many of them, drawn at random")
    parser.add_argument("--seed", type=int, default=1, help="of the draw (default: %(default)s)")
    parser.add_argument("files", nargs="*", help="mutate these files only, by name")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        plain = Workshop(Path(folder) / "plain", options.cc, ("-O1",))
        if options.controls:
            return judge_controls(plain)
        flags = ("-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
        workshops = [plain, Workshop(Path(folder) / "sanitized", options.cc, flags)]
        sources = [*plain.core, *plain.port]
        names = [path.name for path in sources]
        if unknown := set(options.files) - set(names):
            parser.error(f"no source '{min(unknown)}': there are {', '.join(names)}")
        chosen = [path for path in sources if not options.files or path.name in options.files]
        mutants = [mutant for source in chosen for mutant in mutants_of(source)]
        if options.sample is not None:
            mutants = random.Random(options.seed).sample(mutants, min(options.sample, len(mutants)))
        RECORD.parent.mkdir(exist_ok=True)
        return judge_all(workshops, mutants, options.jobs, options.sample is not None)


if __name__ == "__main__":
    sys.exit(main())
