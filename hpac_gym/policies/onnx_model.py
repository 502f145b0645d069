"""A policy as an ONNX model, written and read, and the card beside it."""

import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hpac_gym.errors import PolicyError, install
from hpac_gym.policies.closure import Closures
from hpac_gym.policies.increments import Increments
from hpac_gym.policies.made_for import options_of, require_fit
from hpac_gym.policies.policy import LearnedPolicy
from hpac_gym.policies.policy_file import PolicyFile, from_description, sizes_of

MODEL = "model.onnx"
CARD = "card.json"
"""Files of an exported policy; the card tells its inputs, outputs and provenance."""
ENTRY = ("name", "label", "unit", "low", "high")
"""What a card tells of an entry of the observation, in the order of a policy file."""
OPSET = 17
IR_VERSION = 8
"""ONNX versions, old enough for current and older runtimes."""


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
    last = f"sum_{len(actor.layers) - 1}"
    nodes += [
        helper.make_node("Clip", [last, "mean_low", "mean_high"], ["bounded"]),
        helper.make_node("Tanh", ["bounded"], ["exact_decision"]),
        helper.make_node("Cast", ["exact_decision"], ["decision"], to=TensorProto.FLOAT),
    ]
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


def read_card(folder: Path) -> dict[str, Any]:
    """The card of an exported policy.

    Raises:
        PolicyError: It is missing or damaged.
    """
    try:
        told: dict[str, Any] = json.loads((folder / CARD).read_text(encoding="utf-8"))
        str.rpartition(told["env_id"], ":")
        options_of(told)
        return told
    except OSError as error:
        raise PolicyError(
            f"'{folder}' is not an exported policy: {CARD}: {error.strerror}"
        ) from None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise PolicyError(f"'{folder}' is not an exported policy: {error}") from None


def read_onnx(folder: Path, env: gymnasium.Env[Any, Any]) -> LearnedPolicy:
    """Load an exported policy for an environment.

    Raises:
        PolicyError: A file is missing or damaged, or the policy was made for another layout or
            rate.
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
        entries = [[*map(entry.get, ENTRY)] for entry in told["observation"]]
        described = told | {"made_for": told | {"observation": entries}}
        closures = from_description(Closures, decision["closure"])
        moves = from_description(Increments, decision.get("increments"))
        repeat = 1 if closures else decision["control_steps"]
        if not (isinstance(repeat, int) and repeat >= 1):
            raise ValueError(f"control_steps is {repeat}, and must be a whole number of at least 1")
        if (inputs := [entry.name for entry in session.get_inputs()]) != ["observation"]:
            raise ValueError(f"the inputs of its model are {', '.join(inputs)}, not observation")
        ends = session.get_inputs()[0].shape[1], session.get_outputs()[0].shape[1]
        sizes = sizes_of(ends, closures, moves)
    except Exception as error:  # a damaged file can make its reader raise anything
        raise PolicyError(
            f"'{folder}' is not an exported policy: {str(error).splitlines()[0]}"
        ) from None
    require_fit(f"exported policy '{folder}'", described, sizes, env)

    def decide(observation: NDArray[Any]) -> NDArray[np.float32]:
        seen = np.asarray(observation, np.float32)[None]
        decided: NDArray[np.float32] = session.run(None, {"observation": seen})[0][0]
        return decided

    return LearnedPolicy(decide, repeat, closures, moves, sizes[0])
