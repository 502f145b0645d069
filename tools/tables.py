"""Pages of ``docs`` with tables that are generated; ``make generate`` writes them.

A table stands between ``<!-- NAME -->`` and ``<!-- /NAME -->``; all else in the page is written by
hand."""

from pathlib import Path

from experiments.deployed import deployed_table
from experiments.gap import gap_table
from hpac_gym.registration import GENTLE, GRASP, GRASP_ANY, GRASP_TYPE, PICK_PLACE, POSTURE
from tools import result_tables
from tools.grasp_types import all_successes_table, rule_table
from tools.result_tables import DOCS, experiment
from tools.task_tables import PAGE_OF_ALL, Makers, object_table, task_tables

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
"""Tables of every page in `DOCS`, by name."""


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


def documents() -> dict[Path, str]:
    """All pages with regenerated tables."""
    return {
        DOCS / name: filled((DOCS / name).read_text(encoding="utf-8"), tables)
        for name, tables in PAGES.items()
    }
