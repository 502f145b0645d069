"""`hpac export`: a policy file as ONNX with a card, in the layout that Hugging Face's hub expects.

The folder gets ``model.onnx`` (the scaling of the observation is inside), ``card.json`` (inputs,
outputs and provenance), ``README.md`` (the same in readable form, with the hub's header) and
``replay.mp4``, which the hub shows."""

import argparse
import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hpac_gym.command import add_json, say
from hpac_gym.errors import PolicyError, install
from hpac_gym.output import replacing, writable_folder
from hpac_gym.policies.closure import Closures
from hpac_gym.policies.increments import Increments
from hpac_gym.policies.made_for import require_fit
from hpac_gym.policies.policy import LearnedPolicy
from hpac_gym.policies.policy_file import PolicyFile, read_policy

OPSET = 17
IR_VERSION = 8
"""ONNX versions, old enough for current and older runtimes."""
CARD = "card.json"
MODEL = "model.onnx"
FILM = "replay.mp4"


def onnx_model(policy: PolicyFile) -> Any:
    """The actor as an `onnx.ModelProto`: `observation`, float32 (n, k), to `decision`, float32 (n,
    m).

    All computations are in double precision, as in `Actor`.
    """
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    actor = policy.actor
    observed, decided = actor.sizes
    arrays = {
        "mean": actor.observation_mean.astype(np.float64),
        "scale": actor.observation_scale.astype(np.float64),
        "low": np.float64(-actor.observation_clip),
        "high": np.float64(actor.observation_clip),
        "mean_low": np.float64(-actor.mean_clip),
        "mean_high": np.float64(actor.mean_clip),
    }
    nodes = [
        helper.make_node("Cast", ["observation"], ["exact"], to=TensorProto.DOUBLE),
        helper.make_node("Sub", ["exact", "mean"], ["centred"]),
        helper.make_node("Div", ["centred", "scale"], ["scaled"]),
        helper.make_node("Clip", ["scaled", "low", "high"], ["value_0"]),
    ]
    for place, (weight, bias) in enumerate(actor.layers):
        # The weights are stored in single precision, which halves the file size.
        arrays |= {f"single_weight_{place}": weight.T.copy(), f"single_bias_{place}": bias}
        for name in (f"weight_{place}", f"bias_{place}"):
            nodes.append(
                helper.make_node("Cast", [f"single_{name}"], [name], to=TensorProto.DOUBLE)
            )
        out = f"sum_{place}"
        nodes.append(
            helper.make_node("Gemm", [f"value_{place}", f"weight_{place}", f"bias_{place}"], [out])
        )
        if place + 1 < len(actor.layers):
            nodes.append(helper.make_node("Relu", [out], [f"value_{place + 1}"]))
    nodes.append(
        helper.make_node(
            "Clip", [f"sum_{len(actor.layers) - 1}", "mean_low", "mean_high"], ["bounded"]
        )
    )
    nodes.append(helper.make_node("Tanh", ["bounded"], ["exact_decision"]))
    nodes.append(helper.make_node("Cast", ["exact_decision"], ["decision"], to=TensorProto.FLOAT))
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["n", observed])],
        [helper.make_tensor_value_info("decision", TensorProto.FLOAT, ["n", decided])],
        [numpy_helper.from_array(np.asarray(array), name) for name, array in arrays.items()],
    )
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="hpac_gym"
    )
    model.ir_version = IR_VERSION
    onnx.checker.check_model(model)
    return model


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


def read_onnx(folder: Path, env: gymnasium.Env[Any, Any]) -> LearnedPolicy:
    """Load an exported policy for an environment.

    Raises:
        PolicyError: A file is missing or damaged, or the policy was made for another layout, rate
            or hand.
    """
    try:
        import onnxruntime
    except ImportError:
        raise PolicyError(
            f"exported policy '{folder}' needs ONNX's runtime: {install('onnx')}"
        ) from None
    told = read_card(folder)
    try:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        session = onnxruntime.InferenceSession(
            (folder / MODEL).read_bytes(), options, providers=["CPUExecutionProvider"]
        )
        decision = told["decision"]
        made = told | {"observation": [list(entry.values()) for entry in told["observation"]]}
        closures = None if decision["closure"] is None else Closures.of(decision["closure"])
        told_moves = decision.get("increments")
        moves = None if told_moves is None else Increments.of(told_moves)
        if not (repeat := 1 if closures else decision["control_steps"]) >= 1:
            raise ValueError(f"control_steps is {repeat}, and must be at least 1")
        if (inputs := [entry.name for entry in session.get_inputs()]) != ["observation"]:
            raise ValueError(f"the inputs of its model are {', '.join(inputs)}, not observation")
        require_fit(f"exported policy '{folder}'", told["env_id"], made, env)
    except PolicyError:
        raise
    except Exception as error:  # a damaged file can make its reader raise anything
        raise PolicyError(
            f"'{folder}' is not an exported policy: {str(error).splitlines()[0]}"
        ) from None

    def decide(observation: NDArray[Any]) -> NDArray[np.float32]:
        seen = np.asarray(observation, np.float32)[None]
        decided: NDArray[np.float32] = session.run(None, {"observation": seen})[0][0]
        return decided

    return LearnedPolicy(decide, repeat, closures, moves)


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
            or `film` is not an MP4 file.
        OutputError: The folder cannot be written.
    """
    policy = read_policy(path)
    judged = None if evaluation is None else _evaluation(evaluation, policy.about["sha256"])
    video = b"" if film is None else _film(film)
    try:
        told = card(policy, judged)
        page = _page(told, bool(video))
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise PolicyError(
            f"'{evaluation or path}' is damaged, no card can be made of it: {error!r}"
        ) from None
    files = {
        MODEL: onnx_model(policy).SerializeToString(),
        CARD: f"{json.dumps(told, indent=2)}\n".encode(),
    }
    files |= {"README.md": page.encode()} | ({FILM: video} if video else {})
    writable_folder(out)
    for name, data in files.items():
        with replacing(out / name) as temporary:
            temporary.write_bytes(data)
    return [out / name for name in files]


def _evaluation(path: Path, sha256: str) -> dict[str, Any]:
    try:
        judged: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if "files" in judged:
            raise PolicyError(
                f"'{path}' compares {len(judged['files'])} policies: evaluate this one alone"
            )
        judged["policies"]["learned"], judged["first_seed"], judged["last_seed"]
        weights = str(judged["policy"]["sha256"])
    except PolicyError:
        raise
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise PolicyError(f"'{path}' is not a result of hpac evaluate: {error!r}") from None
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


def _page(told: dict[str, Any], film: bool) -> str:
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
        f"`{MODEL}` maps `observation`, float32 (n, {len(told['observation'])}), to `decision`, −1…1; the scaling is inside.",
        f"`{CARD}` contains the same information in machine-readable form.{f' `{FILM}` shows the policy.' * film}",
        "",
    ]
    if decision["closure"]:
        lines += [
            "One decision per episode, on its first observation: the numbers of a closure, each scaled to its range.",
            f"`hpac_gym.policies.Closures` converts it to the action of every step, {told['control_hz']} per second.",
            "",
            "| number | −1 | 1 |",
            "| --- | --- | --- |",
            *(
                f"| {entry['name']} | {entry['low']:g} | {entry['high']:g} |"
                for entry in decision["numbers"]
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
    lines += ["| # | observation | | unit | low | high |", "| --- | --- | --- | --- | --- | --- |"]
    for place, entry in enumerate(told["observation"]):
        cells = (
            place,
            entry["name"],
            entry["label"],
            entry["unit"],
            f"{entry['low']:g}",
            f"{entry['high']:g}",
        )
        lines.append(f"| {' | '.join(map(str, cells))} |")
    lines += ["", f"Actions, in order: {', '.join(told['action'])}; −1 open, 1 closed.", ""]
    if judged:
        lines += [
            f"Held-out seeds {judged['first_seed']} to {judged['last_seed']}, options {judged.get('options', {})}:",
            "",
            "| policy | episodes | success | 95 % interval |",
            "| --- | --- | --- | --- |",
        ]
        for name, numbers in judged["policies"].items():
            low, high = numbers["interval_95"]
            rate = numbers["success_rate"]
            lines.append(
                f"| {name} | {numbers['episodes']} | {100 * rate:.1f} % | {100 * low:.1f} … {100 * high:.1f} |"
            )
        lines.append("")
    facts = {
        name: told[name] for name in ("weights_sha256", "hand_sha256", "task_sha256") if told[name]
    }
    return "\n".join(
        [*lines, *(f"* {name} `{value}`" for name, value in (facts | told["versions"]).items()), ""]
    )


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
