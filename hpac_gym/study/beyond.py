"""``hpac study``: what the paper leaves to future work: hysteresis, repeatability, tracking, rival calibrations."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from hpac_gym.output import write_text
from hpac_gym.study import figures, rivals, tracking, trials
from hpac_gym.study.intervals import Mean
from hpac_gym.study.reference import REFERENCE_FILE, Reference, load_reference
from hpac_gym.study.trials import JointTrials

TRIAL_PROTOCOL = {"points": 15, "seconds_per_point": 3.0}
"""Slow: a finger that stops from a faster move overshoots into the band where friction holds it, and the hysteresis is gone."""
QUICK_PROTOCOL = {"points": 9, "seconds_per_point": 1.0}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("--trials", type=int, default=5, metavar="N", help="trials and tracking runs, at least 3 (%(default)s)")
    parser.add_argument("--choices", type=int, default=10, metavar="N", help="random choices of training points (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of all of them (%(default)s)")
    parser.add_argument("--quick", action="store_true", help="a coarse protocol: a test of the command, not a result")
    parser.add_argument("--reference", type=Path, default=REFERENCE_FILE, metavar="TOML", help="the simulated hand and camera")
    parser.add_argument("--out", type=Path, default=Path("runs/study"), metavar="DIR", help="where results go (%(default)s)")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the report")


def run(arguments: argparse.Namespace) -> int:
    """All four experiments, then tables, figures and one JSON file."""
    reference = load_reference(arguments.reference)
    count, seed, shown, out = max(arguments.trials, 3), arguments.seed, not arguments.json, arguments.out
    joints = _trials(reference, count, seed, arguments.quick, shown)
    rates = (0.5, 1.0) if arguments.quick else tracking.RATES_HZ
    tracked = tracking.run_tracking(reference, 2 if arguments.quick else count, seed, rates, shown)
    rivalry = _rivals(reference, arguments.choices, seed, arguments.quick, shown)
    result = {
        "seed": seed,
        "trials": count,
        "hysteresis_width_deg": _means(trials.hysteresis_deg(joints)),
        "trial_to_trial_sd_deg": _means(trials.spread_deg(joints)),
        "tracking": [asdict(item) for item in tracked],
        "rivals_mae_deg": asdict(rivalry),
    }
    text = report(joints, tracked, rivalry, count, seed)
    for name, figure in (
        ("hysteresis", trials.hysteresis_figure(joints)),
        ("repeatability", trials.spread_figure(joints)),
        ("tracking", tracking.tracking_figure(tracked)),
        ("rivals", rivals.rivals_figure(rivalry)),
    ):
        figures.save(figure, out / f"{name}.png")
    write_text(out / "study.md", text)
    write_text(out / "study.json", json.dumps(result, indent=2) + "\n")
    print(json.dumps(result) if arguments.json else f"{text}\nwritten to {out}")
    return 0


def _trials(reference: Reference, count: int, seed: int, quick: bool, shown: bool) -> dict[str, JointTrials]:
    protocol = QUICK_PROTOCOL if quick else TRIAL_PROTOCOL
    slow = replace(reference, rig=reference.rig.with_protocol(**protocol))
    return trials.by_joint(trials.run_trials(slow, count, seed, shown=shown), reference.cutoff_hz)


def _rivals(reference: Reference, choices: int, seed: int, quick: bool, shown: bool) -> rivals.Rivalry:
    rig = reference.rig.with_protocol(**QUICK_PROTOCOL) if quick else reference.rig
    train, test = (
        rig.sweep(np.random.default_rng([seed, stream]), label=f"{name} sweep" if shown else "")
        for stream, name in ((10, "training"), (11, "test"))
    )
    samples = tuple(number for number in rivals.SAMPLES if number <= rig.protocol.points)
    return rivals.run_rivals(train, test, min(choices, 2) if quick else choices, seed, samples, shown)


def _means(found: dict[str, Mean]) -> dict[str, dict[str, float]]:
    return {name: asdict(value) for name, value in found.items()}


def report(
    joints: dict[str, JointTrials], tracked: list[tracking.Tracked], rivalry: rivals.Rivalry, count: int, seed: int
) -> str:
    """The four tables as Markdown; every entry is a mean and its 95 % interval."""
    widths, spreads = trials.hysteresis_deg(joints), trials.spread_deg(joints)
    lines = [f"# Beyond the paper (seed {seed}, {count} trials)", "", "## Both directions and repeated trials", ""]
    lines += ["| joint | hysteresis width [°] | trial-to-trial standard deviation [°] |", "|---|---|---|"]
    lines += [f"| {figures.label(name)} | {widths[name]} | {spreads[name]} |" for name in joints]
    lines += ["", "## Dynamic tracking, mean over the nine joints", "", "| command | rate [Hz] | lag [ms] | RMS error [°] |"]
    lines.append("|---|--:|--:|--:|")
    for item in tracked:
        lag = item.lag_s["mean"]
        text = f"{1e3 * lag.mean:.1f} [{1e3 * lag.low:.1f}, {1e3 * lag.high:.1f}]"
        lines.append(f"| {item.profile.replace('_', ' ')} | {item.rate_hz:g} | {text} | {item.rms_deg['mean']} |")
    lines += ["", "## Rival calibrations: mean absolute error of the nine joints on another sweep [°]", ""]
    numbers = sorted({number for table in rivalry.trained.values() for number in table})
    lines += [f"| method | {' | '.join(f'{number} points' for number in numbers)} |", "|---|" + "--:|" * len(numbers)]
    for name, table in rivalry.trained.items():
        lines.append(f"| {name} | {' | '.join(str(table[number]) if number in table else '–' for number in numbers)} |")
    lines += ["", *(f"Untrained, {name}: {value:.3f}°." for name, value in rivalry.untrained.items()), ""]
    return "\n".join(lines)
