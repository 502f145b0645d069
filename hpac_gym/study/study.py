"""``hpac study``: what the compensation is worth on other hands than its own, and what the paper leaves to future work."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hpac_gym.errors import HpacError
from hpac_gym.output import write_text
from hpac_gym.study import commanding, figures, hidden, population, rivals, seeds, tracking, trials
from hpac_gym.study.accuracy import ALL_BELOW_DEG, PRINTED
from hpac_gym.study.intervals import Mean
from hpac_gym.study.reference import REFERENCE_FILE, load_reference

TRIAL_PROTOCOL = {"points": 15, "seconds_per_point": 3.0}
"""Slow: a finger that stops from a faster move overshoots into the band where friction holds it, and the hysteresis is gone."""
QUICK_PROTOCOL = {"points": 9, "seconds_per_point": 1.0}
COMMANDED = "all of these, geometry 1 %"
"""The workshop whose hands are calibrated and commanded."""


class StudyError(HpacError, ValueError):
    """The command line names a part that is not there."""


@dataclass(frozen=True, slots=True)
class Part:
    """One part's result."""

    text: str
    """Markdown."""
    data: object
    """For the JSON file."""
    figures: dict[str, Figure] = field(default_factory=dict)
    caption: str = ""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"which of {', '.join(PARTS)} (default: all)")
    parser.add_argument("--hands", type=_count(2), metavar="N", help="hands of each population (400; of the costly parts fewer)")
    parser.add_argument("--seeds", type=_count(2), default=20, metavar="N", help="seeds of the reference sweep (%(default)s)")
    parser.add_argument("--trials", type=_count(3), default=5, metavar="N", help="trials, tracking runs (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of all of them (%(default)s)")
    parser.add_argument("--quick", action="store_true", help="few and coarse: a test of the command, not a result")
    parser.add_argument("--reference", type=Path, default=REFERENCE_FILE, metavar="TOML", help="the simulated hand and camera")
    parser.add_argument("--out", type=Path, default=Path("runs/study"), metavar="DIR", help="where results go (%(default)s)")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the report")
    parser.set_defaults(run=run)


def _count(least: int) -> Callable[[str], int]:
    def parse(text: str) -> int:
        if not text.isdigit() or int(text) < least:
            raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of at least {least}")
        return int(text)

    return parse


def run(arguments: argparse.Namespace) -> int:
    """Run the parts one after the other; each writes its table, its figures and its numbers when it is done."""
    unknown = [name for name in arguments.parts if name not in PARTS]
    if unknown:
        raise StudyError(f"{', '.join(unknown)}: hpac study knows the parts {', '.join(PARTS)}")
    results = {}
    for name in arguments.parts or PARTS:
        part = PARTS[name](arguments)
        for stem, figure in part.figures.items():
            figures.save(figure, arguments.out / f"{stem}.png", part.caption)
        write_text(arguments.out / f"{name}.md", part.text)
        results[name] = part.data
        write_text(arguments.out / f"{name}.json", json.dumps(part.data, indent=2) + "\n")
        if not arguments.json:
            print(part.text)
    print(json.dumps(results) if arguments.json else f"written to {arguments.out}")
    return 0


def _hands(arguments: argparse.Namespace, usual: int) -> int:
    return arguments.hands or (4 if arguments.quick else usual)


def _table(head: tuple[str, ...], rows: list[tuple[object, ...]]) -> str:
    lines = [f"| {' | '.join(head)} |", "|---|" + "--:|" * (len(head) - 1)]
    return "\n".join([*lines, *(f"| {' | '.join(map(str, row))} |" for row in rows)])


# Populations --------------------------------------------------------------------------


def populations(arguments: argparse.Namespace) -> Part:
    """Nominal compensation on hands as a workshop makes them."""
    count = _hands(arguments, 400)
    errors = population.population_errors(count, arguments.seed, not arguments.json)
    rows = {name: population.population_row(item) for name, item in errors.items()}
    head = ("hands", "index DIP without [°]", "index DIP with", "worst of nine", "MP and MCP", "joints made worse")
    body = [
        (name, row.uncompensated_index_dip, row.index_dip, row.worst_joint, row.driven, f"{row.made_worse:.0%}",
         f"{row.all_below:.0%}")
        for name, row in rows.items()
    ]  # fmt: skip
    head = (*head, f"hands with all nine below {ALL_BELOW_DEG}°")
    text = f"## Populations: {count} hands each, seed {arguments.seed}; median and the middle 95 %\n\n{_table(head, body)}\n"
    figure = population.population_figure(errors)
    caption = f"{count} hands in metal each, seed {arguments.seed}, nominal compensation"
    return Part(text, {name: asdict(row) for name, row in rows.items()}, {"populations": figure}, caption)


def causes(arguments: argparse.Namespace) -> Part:
    """What each cause alone adds to the compensated error."""
    found = population.run_causes()
    head = ("cause, alone, on the nominal hand", "index DIP [°]", "index PIP", "worst of nine", "worst of MP and MCP")
    body = [(name, *(f"{value:.2f}" for value in asdict(row).values())) for name, row in found.items()]
    text = f"## What each cause adds to the compensated error\n\n{_table(head, body)}\n"
    return Part(text, {name: asdict(row) for name, row in found.items()})


def reference_seeds(arguments: argparse.Namespace) -> Part:
    """The reference sweep over seeds and speeds."""
    speeds = {0.75: 1.0} if arguments.quick else seeds.SPEEDS
    runs = seeds.run_seeds(arguments.reference, 2 if arguments.quick else arguments.seeds, speeds, not arguments.json)
    return seeds_part(runs)


def seeds_part(runs: list[seeds.SeedRun]) -> Part:
    """The tables of finished runs."""
    rows = seeds.by_speed(runs)
    head = ("seconds a point", "seeds", "index DIP without [°]", "with", "worst of nine", "nine below 0.23°", "all five printed")
    body = [
        (f"{seconds:g}", row.seeds, row.uncompensated, row.compensated, row.worst_joint, f"{row.met[PRINTED[3]]} of {row.seeds}",
         f"{row.all_met} of {row.seeds}")
        for seconds, row in rows.items()
    ]  # fmt: skip
    text = f"## The reference sweep, other seeds and speeds; median and the middle 95 % of the seeds\n\n{_table(head, body)}\n"
    return Part(text, [asdict(run) for run in runs])


# Calibration, commands, rivals ----------------------------------------------------------


def calibration(arguments: argparse.Namespace) -> Part:
    """`hpac calibrate` on hidden hands."""
    count, shown = _hands(arguments, 100), not arguments.json
    found = {laws: hidden.summarised(hidden.run_hidden(count, arguments.seed, laws, shown)) for laws in hidden.LAWS}
    if not arguments.quick:
        physics = hidden.run_hidden_in_physics(max(count // 20, 2), arguments.seed, shown)
        found["physics engine"] = hidden.summarised(physics)
    head = ("hidden", "hands", "refused", "file's error, median [°]", "worst joint", "joints within the mark", "stops missed")
    body = [
        (name, row.hands, row.refused, f"{row.median_deg:.3f}", f"{row.worst_deg:.3f}", f"{row.within:.1%}", row.stops_missed)
        for name, row in found.items()
    ]
    lines = [f"## `hpac calibrate` on hidden hands, seed {arguments.seed}", "", _table(head, body), ""]
    told = found["laws of the fit"]
    head = ("combination", "95 % interval holds the truth", "told by the data")
    lines += [_table(head, [(name, f"{share:.0%}", f"{told.told[name]:.0%}") for name, share in told.coverage.items()]), ""]
    if "physics engine" in found:
        shares = found["physics engine"].coverage.values()
        lines += [f"In the physics engine {np.mean(list(shares)):.0%} of the intervals hold the truth.", ""]
    return Part("\n".join(lines), {name: asdict(row) for name, row in found.items()})


def commands(arguments: argparse.Namespace) -> Part:
    """Command maps before and after one sweep of calibration, on hands that obey the laws of the fit."""
    return _commands(arguments, COMMANDED, population.WORKSHOPS[COMMANDED], tuple(commanding.MAPS))


def commands_other_laws(arguments: argparse.Namespace) -> Part:
    """The same before and after, on hands whose physics is not that of the fit."""
    return _commands(arguments, "physics that is not the model's", rivals.OTHER_METAL, commanding.BEFORE_AND_AFTER)


def _commands(arguments: argparse.Namespace, name: str, workshop: population.Workshop, maps: tuple[str, ...]) -> Part:
    count = _hands(arguments, 100)
    camera = replace(hidden.CAMERA, outliers=0.005)
    rows = commanding.run_commanding(workshop, count, arguments.seed, camera, maps, not arguments.json)
    goal = f"hands with all nine ≤ {commanding.GOAL_DEG}°"
    head = ("map", "flexion: worst of nine [°]", goal, f"< {ALL_BELOW_DEG}°", "extension: worst of nine", goal, "off target")
    body = [
        (name, row.flexion_worst, f"{row.all_within_goal:.0%}", f"{row.all_below_papers:.0%}", row.extension_worst,
         f"{row.all_within_goal_back:.0%}", row.off_target)
        for name, row in rows.items()
    ]  # fmt: skip
    text = f"## Commands: {count} hands ({name}), seed {arguments.seed}, one sweep each; median and the middle 95 %\n\n"
    return Part(text + _table(head, body) + "\n", {name: asdict(row) for name, row in rows.items()})


def race(arguments: argparse.Namespace) -> Part:
    """Rival calibrations on physics that is not the model's."""
    return _race(arguments, "rivals", "physics that is not the model's", rivals.OTHER_METAL)


def race_at_home(arguments: argparse.Namespace) -> Part:
    """Rival calibrations on the physics of the fit."""
    return _race(arguments, "rivals-at-home", "physics of the fit", rivals.HOME_METAL)


def _race(arguments: argparse.Namespace, stem: str, title: str, workshop: population.Workshop) -> Part:
    count, numbers = _hands(arguments, 8), (3, 8) if arguments.quick else rivals.SAMPLES
    found = rivals.run_race(workshop, count, arguments.seed, numbers, shown=not arguments.json)
    lines = [f"## Rival calibrations on {title}: mean absolute error of the nine joints [°]", ""]
    lines += [f"{found.hands} hands, seed {arguments.seed}; mean and 95 % interval.", ""]
    body = [(name, *(table[n] for n in numbers)) for name, table in found.trained.items()]
    body += [(f"{name}, untrained", value, *[""] * (len(numbers) - 1)) for name, value in found.untrained.items()]
    body.append(("best", *(found.winners()[n] for n in numbers)))
    lines += [_table(("method", *(f"{n} points" for n in numbers)), body), ""]
    lines += [f"The camera's scale alone, which no method can see, leaves {found.camera}°.", ""]
    caption = f"{found.hands} hands in metal, {title}, camera with common errors, seed {arguments.seed}"
    return Part("\n".join(lines), asdict(found), {stem: rivals.race_figure(found)}, caption)


# Both directions, repeated trials, tracking -----------------------------------------------


def repeated(arguments: argparse.Namespace) -> Part:
    """Hysteresis and repeatability."""
    reference = load_reference(arguments.reference)
    slow = replace(reference, rig=reference.rig.with_protocol(**(QUICK_PROTOCOL if arguments.quick else TRIAL_PROTOCOL)))
    record = trials.run_trials(slow, arguments.trials, arguments.seed, shown=not arguments.json)
    joints = trials.by_joint(record, reference.cutoff_hz)
    widths, spreads = trials.hysteresis_deg(joints), trials.spread_deg(joints)
    body = [(figures.label(name), widths[name], spreads[name]) for name in joints]
    text = f"## Both directions and repeated trials: {arguments.trials} trials, seed {arguments.seed}; mean and 95 % interval\n\n"
    text += _table(("joint", "hysteresis width [°]", "trial-to-trial standard deviation [°]"), body) + "\n"
    data = {"hysteresis_width_deg": _means(widths), "trial_to_trial_sd_deg": _means(spreads)}
    drawn = {"hysteresis": trials.hysteresis_figure(joints), "repeatability": trials.spread_figure(joints)}
    return Part(text, data, drawn, f"reference hand, {arguments.trials} trials, seed {arguments.seed}")


def tracked(arguments: argparse.Namespace) -> Part:
    """Dynamic tracking, open loop and with the camera."""
    reference = load_reference(arguments.reference)
    rates = (0.5,) if arguments.quick else tracking.RATES_HZ
    found = tracking.run_tracking(reference, arguments.trials, arguments.seed, rates, not arguments.json)
    body = []
    for item in found:
        lag = item.lag_s["mean"]
        loop = "camera at 20 Hz" if item.closed else "open"
        lags = f"{1e3 * lag.mean:.1f} [{1e3 * lag.low:.1f}, {1e3 * lag.high:.1f}]"
        body.append((item.profile.replace("_", " "), f"{item.rate_hz:g}", loop, lags, item.rms_deg["mean"]))
    text = f"## Tracking, mean over the nine joints: {arguments.trials} runs, seed {arguments.seed}; mean and 95 % interval\n\n"
    text += _table(("command", "rate [Hz]", "loop", "lag [ms]", "RMS error [°]"), body) + "\n"
    caption = f"reference hand, {arguments.trials} runs, seed {arguments.seed}"
    return Part(text, [asdict(item) for item in found], {"tracking": tracking.tracking_figure(found)}, caption)


def _means(found: dict[str, Mean]) -> dict[str, dict[str, float]]:
    return {name: asdict(value) for name, value in found.items()}


PARTS: dict[str, Callable[[argparse.Namespace], Part]] = {
    "populations": populations,
    "causes": causes,
    "seeds": reference_seeds,
    "rivals": race,
    "rivals-at-home": race_at_home,
    "calibration": calibration,
    "commands": commands,
    "commands-other-laws": commands_other_laws,
    "trials": repeated,
    "tracking": tracked,
}
"""Parts by the name that the command line takes."""
