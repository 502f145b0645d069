"""`hpac export`: a policy file as ONNX with a card, in the layout that Hugging Face's hub expects.

The folder gets ``model.onnx`` (the scaling of the observation is inside), ``card.json`` (inputs,
outputs and provenance), ``README.md`` (the same in readable form, with the hub's header) and
``replay.mp4``, which the hub shows."""

import argparse
import json
from pathlib import Path
from typing import Any

from hpac_gym.command import add_json, say
from hpac_gym.errors import PolicyError
from hpac_gym.output import replacing, writable_folder
from hpac_gym.policies.card import CARD, FILM, MODEL, card, page
from hpac_gym.policies.onnx_model import onnx_model
from hpac_gym.policies.policy_file import read_policy


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
            `film` is not an MP4 file, or the folder holds an exported policy.
        OutputError: The folder cannot be written.
    """
    if (out / CARD).exists():
        raise PolicyError(f"'{out}' holds an exported policy already: name another folder")
    policy = read_policy(path)
    judged = None if evaluation is None else _evaluation(evaluation, policy.about["sha256"])
    video = b"" if film is None else _film(film)
    try:
        told = card(policy, judged)
        text = page(told, bool(video))
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise PolicyError(
            f"'{evaluation or path}' is damaged, no card can be made of it: {error!r}"
        ) from None
    files = {
        MODEL: onnx_model(policy).SerializeToString(),
        CARD: f"{json.dumps(told, indent=2)}\n".encode(),
    }
    files |= {"README.md": text.encode()} | ({FILM: video} if video else {})
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
