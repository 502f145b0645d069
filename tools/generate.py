"""Write every generated file of the checkout: ``make generate``. ``--check`` compares; status 1 if
one is out of date. ``--hand FILE`` writes the firmware's limits for another hand.

Model files come from ``hpac_gym/body/data`` and the hand's parameters, the procedural objects from
``tools/object_families.py``, the firmware's header, ``docs/wire.md`` and its test vectors from the
protocol and the hand's parameters, the tables of ``docs/environments`` and ``docs/grasps.md`` from
the tasks, those of ``docs/benchmark.md`` from ``docs/results``."""

import re
import sys
from pathlib import Path

import numpy as np

from experiments.deployed import deployed_table
from experiments.gap import gap_table
from hpac_gym.body.geometry import load_geometry
from hpac_gym.body.object_models import load_object_models
from hpac_gym.body.urdf import HAND_ON_WRIST_URDF, HAND_URDF, hand_urdf, object_urdf
from hpac_gym.command import command_parser, run
from hpac_gym.model import load_hand
from hpac_gym.physics.mjcf import FILES, hand_mjcf
from hpac_gym.physics.settings import BODIES
from hpac_gym.registration import GENTLE, GRASP, GRASP_ANY, GRASP_TYPE, PICK_PLACE, POSTURE
from tools import result_tables
from tools.grasp_types import all_successes_table, rule_table
from tools.object_families import procedural_objects
from tools.result_tables import DOCS, experiment
from tools.task_tables import PAGE_OF_ALL, Makers, object_table, task_tables
from tools.wire_files import wire_files

ROOT = Path(__file__).parents[1]
_NUMBER = re.compile(r"-?\d+\.?\d*(?:e-?\d+)?")


PAGES: dict[str, Makers] = {
    "environments/README.md": PAGE_OF_ALL,
    "environments/grasp.md": task_tables(GRASP) | {"scale": result_tables.scale_table},
    "environments/grasp_any.md": task_tables(GRASP_ANY),
    "environments/grasp_type.md": task_tables(GRASP_TYPE),
    "environments/gentle.md": task_tables(GENTLE)
    | {
        "gentle": result_tables.gentle_table,
        "gentle-elsewhere": result_tables.gentle_elsewhere_table,
    },
    "environments/pick_place.md": task_tables(PICK_PLACE),
    "environments/posture.md": task_tables(POSTURE),
    "benchmark.md": {"results": result_tables.results_table},
    "camera.md": {
        "objects": result_tables.seen_objects_table,
        "hands": result_tables.seen_hands_table,
    },
    "deploy.md": {
        "deployed": lambda: deployed_table(experiment("deployed")["cells"]),
        "gap": lambda: gap_table(experiment("gap")["cells"]),
    },
    "grasps.md": {
        "objects": object_table,
        "types": rule_table,
        "success": all_successes_table,
    },
}
"""Tables of every page in `DOCS`, by name. A table stands between ``<!-- NAME -->`` and
``<!-- /NAME -->``; all else in the page is written by hand.
"""


def filled(page: str, tables: Makers) -> str:
    """The page with all its tables regenerated.

    Raises:
        ValueError: The page has no placeholder for a table.
    """
    for name, make in tables.items():
        begin = f"<!-- {name} -->"
        end = f"<!-- /{name} -->"
        if page.count(begin) != 1 or page.count(end) != 1:
            raise ValueError(f"the page needs '{begin}' and '{end}' once")
        before, rest = page.split(begin)
        page = f"{before}{begin}\n{make()}\n{end}{rest.split(end)[1]}"
    return page


def generated() -> dict[Path, str]:
    """Path and required contents of every generated file."""
    urdf = ROOT / "assets" / "urdf"
    mjcf = ROOT / "assets" / "mjcf"
    geometry = load_geometry()
    return {
        urdf / HAND_URDF: hand_urdf(geometry),
        urdf / HAND_ON_WRIST_URDF: hand_urdf(geometry, on_wrist=True),
        **{
            urdf / "objects" / f"{name}.urdf": object_urdf(model)
            for name, model in load_object_models().items()
        },
        **{
            mjcf / name: hand_mjcf(geometry, BODIES[body], on_wrist)
            for name, (body, on_wrist) in FILES.items()
        },
        ROOT / "hpac_gym" / "body" / "data" / "procedural_objects.toml": procedural_objects(),
        **wire_files(),
        **{
            DOCS / name: filled((DOCS / name).read_text(encoding="utf-8"), tables)
            for name, tables in PAGES.items()
        },
    }


def is_stale(path: Path, text: str) -> bool:
    """Whether a file is missing or has other contents.

    Numbers of a model file may differ after the eighth digit, since the last digit of a sine
    depends on the processor."""
    if not path.exists():
        return True
    committed = path.read_text(encoding="utf-8")
    if committed == text:
        return False
    if path.suffix not in (".urdf", ".xml") or _NUMBER.sub("#", committed) != _NUMBER.sub(
        "#", text
    ):
        return True
    one, other = (
        [float(number) for number in _NUMBER.findall(version)] for version in (committed, text)
    )
    return not np.allclose(one, other, rtol=1e-8, atol=1e-14)


def main(argv: list[str] | None = None) -> int:
    """Write or check the files; the exit status is 1 if ``--check`` finds one out of date."""
    parser = command_parser("tools.generate", __doc__)
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    parser.add_argument(
        "--hand", metavar="FILE", help="only the firmware's files, for the hand of this file (TOML)"
    )
    options = parser.parse_args(argv)
    wanted = wire_files(load_hand(options.hand)) if options.hand else generated()
    stale = {path: text for path, text in wanted.items() if is_stale(path, text)}
    for path, text in stale.items():
        print(
            f"{path.relative_to(ROOT)}: {'out of date, run make generate' if options.check else 'written'}"
        )
        if not options.check:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    return 1 if options.check and stale else 0


if __name__ == "__main__":
    sys.exit(run(main))
