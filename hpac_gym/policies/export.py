"""`hpac export`: a policy file as ONNX with a card, in the layout that Hugging Face's hub expects.

The folder gets ``model.onnx`` (the scaling of the observation is inside), ``card.json`` (inputs,
outputs and provenance), ``README.md`` (the same in readable form, with the hub's header) and
``replay.mp4``, which the hub shows."""

import argparse
import json
import os
from pathlib import Path
from typing import Any

from hpac_gym.command import add_json, say
from hpac_gym.errors import PolicyError
from hpac_gym.output import markdown, read_text, replacing
from hpac_gym.policies.made_for import options_of
from hpac_gym.policies.onnx_model import CARD, ENTRY, MODEL, onnx_model
from hpac_gym.policies.policy_file import PolicyFile, read_policy

FILM = "replay.mp4"


def export(
    path: Path, out: Path, evaluation: Path | None = None, film: Path | None = None
) -> list[Path]:
    """Export a policy file into a folder and return the written files.

    Args:
        path: the policy file.
        out: the folder.
        evaluation: output of `hpac evaluate --out` for this policy, copied into the card.
        film: video of the policy (MP4), such as one of ``hpac show --record``, copied into the
            folder.

    Raises:
        PolicyError: `path` is not a policy file, `evaluation` is not an evaluation of this policy,
            `film` is not an MP4 file, or the folder holds a file of this name already.
        OutputError: The folder cannot be written.
    """
    policy = read_policy(path)
    video = b"" if film is None else _film(film)
    try:
        judged = None if evaluation is None else _evaluation(evaluation, policy.about["sha256"])
        told = card(policy, judged)
        text = page(told, bool(video))
    except PolicyError:
        raise
    except (LookupError, TypeError, ValueError, AttributeError, RecursionError) as error:
        what = "a policy" if evaluation is None else "a result of hpac evaluate"
        raise PolicyError(
            f"'{evaluation or path}' is not {what}, or is damaged: no card can be made of it: {error!r}"
        ) from None
    files = {
        MODEL: onnx_model(policy).SerializeToString(),
        CARD: f"{json.dumps(told, indent=2)}\n".encode(),
    }
    files |= {"README.md": text.encode()} | ({FILM: video} if video else {})
    if taken := next((name for name in files if os.path.lexists(out / name)), None):
        raise PolicyError(f"'{out / taken}' exists already: name another folder")
    for name, data in files.items():
        with replacing(out / name) as temporary:
            temporary.write_bytes(data)
    return [out / name for name in files]


def card(policy: PolicyFile, evaluation: dict[str, Any] | None = None) -> dict[str, Any]:
    """Inputs, outputs and provenance of the exported policy; `evaluation` is a result of
    `hpac evaluate`.
    """
    about = policy.about
    closures = policy.closures
    fits = about.get("made_for", {})
    decision: dict[str, Any] = {
        "control_steps": policy.action_repeat,
        "numbers": fits.get("action", []),
        "closure": None,
    }
    if closures is not None:
        low, high = closures.bounds.tolist()
        numbers = [
            {"name": name, "low": a, "high": b}
            for name, a, b in zip(closures.names, low, high, strict=True)
        ]
        decision = {
            "control_steps": "the whole episode",
            "numbers": numbers,
            "closure": about["closure"],
        }
    return {
        "env_id": about["env_id"],
        "obs": about.get("obs"),
        "wrist": about.get("wrist"),
        "inputs": policy.actor.sizes[0],
        "observation": [
            dict(zip(ENTRY, entry, strict=True)) for entry in fits.get("observation", [])
        ],
        "decision": decision | {"increments": about.get("increments")},
        "action": fits.get("action", []),
        "control_hz": fits.get("control_hz"),
        "hand_sha256": fits.get("hand_sha256"),
        "task_sha256": fits.get("task_sha256"),
        "weights_sha256": about.get("sha256"),
        "training": {
            name: about[name]
            for name in ("algorithm", "settings", "episodes", "env_steps", "seconds")
            if name in about
        },
        "versions": about.get("versions", {}),
        "evaluation": evaluation,
    }


def page(told: dict[str, Any], film: bool) -> str:
    """Model card for the hub: a YAML header, then text."""
    env_id = told["env_id"].rpartition(":")[2]
    decision = told["decision"]
    judged = told["evaluation"]
    lines = [
        "---",
        "library_name: hpac_gym",
        "pipeline_tag: reinforcement-learning",
        "tags:",
        "- reinforcement-learning",
        "- robotics",
        "- onnx",
        f"- {env_id}",
        "license: mit",
    ]
    if judged:
        lines += [
            "model-index:",
            f"- name: {told['training'].get('algorithm', 'policy')}",
            "  results:",
            "  - task:",
            "      type: reinforcement-learning",
            "    dataset:",
            f"      name: {env_id}",
            f"      type: {env_id}",
            "    metrics:",
            "    - type: success_rate",
            f"      value: {judged['policies']['learned']['success_rate']:.4f}",
        ]
    lines += [
        "---",
        "",
        f"# A policy for {env_id}",
        "",
        f"`{MODEL}` maps `observation`, float32 (n, {told['inputs']}), to `decision`, −1…1; the scaling is inside.",
        f"`{CARD}` contains the same information in machine-readable form.{f' `{FILM}` shows the policy.' * film}",
        "",
    ]
    if decision["closure"]:
        lines += [
            "One decision per episode, on its first observation: the numbers of a closure, each scaled to its range.",
            f"`hpac_gym.policies.Closures` converts it to the action of every step, {told['control_hz']} per second.",
            "",
            markdown(
                ("number", "−1", "1"),
                (
                    (entry["name"], f"{entry['low']:g}", f"{entry['high']:g}")
                    for entry in decision["numbers"]
                ),
            ),
            "",
        ]
    elif decision["increments"]:
        lines += [
            "The input is what `hpac_gym.policies.increments.Increments` shows of the observations below: the mean of the first",
            "ones, then some of the last ones. A decision moves the hand from where it is; its numbers are in the card.",
            "",
        ]
    else:
        lines += [
            f"A decision is an action, held for {decision['control_steps']} steps of {told['control_hz']} per second.",
            "",
        ]
    if needed := ", ".join(f'{name}="{value}"' for name, value in options_of(told).items()):
        lines += [f"It needs `{needed}`: what that adds follows what is listed here.", ""]
    rows = [
        (
            place,
            *map(entry.get, ("name", "label", "unit")),
            f"{entry['low']:g}",
            f"{entry['high']:g}",
        )
        for place, entry in enumerate(told["observation"])
    ]
    lines.append(markdown(("#", "observation", "", "unit", "low", "high"), rows))
    lines += ["", f"Actions, in order: {', '.join(told['action'])}; −1 open, 1 closed.", ""]
    if judged:
        lines += [
            f"Held-out seeds {judged['first_seed']} to {judged['last_seed']}, options {judged.get('options', {})}:",
            "",
        ]
        rows = []
        for name, numbers in judged["policies"].items():
            rate, low, high = (
                f"{100 * share:.1f}" for share in (numbers["success_rate"], *numbers["interval_95"])
            )
            rows.append((name, numbers["episodes"], f"{rate} %", f"{low} … {high}"))
        lines += [markdown(("policy", "episodes", "success", "95 % interval"), rows), ""]
    facts = {
        name: told[name] for name in ("weights_sha256", "hand_sha256", "task_sha256") if told[name]
    }
    return "\n".join(
        [*lines, *(f"* {name} `{value}`" for name, value in (facts | told["versions"]).items()), ""]
    )


def _evaluation(path: Path, sha256: str) -> dict[str, Any]:
    judged: dict[str, Any] = json.loads(read_text(path, "evaluation", PolicyError))
    if "files" in judged:
        raise PolicyError(
            f"'{path}' compares {len(judged['files'])} policies: evaluate this one alone"
        )
    of = judged["policy"]
    weights = str(of["sha256"] if "sha256" in of else of["weights_sha256"])  # of a card
    if weights != sha256:
        raise PolicyError(
            f"'{path}' evaluates other weights, {weights[:12]}…, than those of the policy, {sha256[:12]}…"
        )
    return judged


def _film(path: Path) -> bytes:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise PolicyError(f"cannot read film '{path}': {error.strerror}") from None
    if data[4:8] != b"ftyp":
        raise PolicyError(f"film '{path}' is not an MP4 file")
    return data


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hpac export`."""
    parser.add_argument("policy", type=Path, help="a policy file")
    parser.add_argument("--out", type=Path, required=True, help="folder of the exported policy")
    parser.add_argument(
        "--evaluation",
        type=Path,
        help="output of hpac evaluate --out for this policy",
    )
    parser.add_argument(
        "--film",
        type=Path,
        help="MP4 file that shows the policy, such as one of hpac show --record",
    )
    add_json(parser)
    parser.set_defaults(run=_export)


def _export(options: argparse.Namespace) -> int:
    import onnx  # noqa: F401  fails before anything is written

    for path in export(options.policy, options.out, options.evaluation, options.film):
        say(options.json, str(path), written=str(path))
    return 0
