"""The card of an exported policy: inputs, outputs and provenance, for programs and for readers."""

import json
from pathlib import Path
from typing import Any

from hpac_gym.errors import PolicyError
from hpac_gym.output import markdown
from hpac_gym.policies.policy_file import PolicyFile

CARD = "card.json"
MODEL = "model.onnx"
FILM = "replay.mp4"


def card(policy: PolicyFile, evaluation: dict[str, Any] | None = None) -> dict[str, Any]:
    """Inputs, outputs and provenance of the exported policy; `evaluation` is a result of
    `hpac evaluate`.
    """
    about = policy.about
    closures = policy.closures
    fits = about.get("made_for", {})
    names = ("name", "label", "unit", "low", "high")
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
        "inputs": policy.actor.sizes[0],
        "observation": [
            dict(zip(names, entry, strict=True)) for entry in fits.get("observation", [])
        ],
        "decision": decision | {"increments": about.get("increments")},
        "action": fits.get("action", []),
        "control_hz": fits.get("control_hz"),
        "hand_sha256": fits.get("hand_sha256"),
        "task_sha256": fits.get("task_sha256"),
        "weights_sha256": about.get("sha256"),
        "training": {
            name: about[name]
            for name in ("algorithm", "settings", "episodes", "seconds")
            if name in about
        },
        "versions": about.get("versions", {}),
        "evaluation": evaluation,
    }


def read_card(folder: Path) -> dict[str, Any]:
    """The card of an exported policy.

    Raises:
        PolicyError: It is missing or damaged.
    """
    try:
        told: dict[str, Any] = json.loads((folder / CARD).read_text(encoding="utf-8"))
        str.rpartition(told["env_id"], ":")
        return told
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise PolicyError(f"'{folder}' is not an exported policy: {error}") from None


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
    if told["obs"]:
        lines += [f'With `obs="{told["obs"]}"`, whose own entries follow those below.', ""]
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
