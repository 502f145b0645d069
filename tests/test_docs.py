"""The documentation: links lead somewhere, programs run, commands parse, pages are short, and every
picture and table is shown beside the command that made it.
"""

import argparse
import json
import re
import runpy
import shlex
import sys
import textwrap
from pathlib import Path

import pytest

from hpac import COMMANDS, parser_of
from hpac_gym.model import HPAC, hand_to_toml
from tests.options import help_of
from tests.processes import ROOT, python

DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    ROOT / "CONTRIBUTING.md",
    *sorted(
        page
        for page in DOCS.rglob("*.md")
        if page.name != "measured.md" and page.parent.name != "_reference"
    ),
]
IMAGES = sorted((DOCS / "images").iterdir())
TABLES = sorted((DOCS / "results" / "tables").glob("*.json"))

WORDS = {
    "docs/wire.md": 3_800,
    "docs/study.md": 1_800,
    "docs/environments/README.md": 2_100,
    "docs/environments/grasp_any.md": 2_000,
    "docs/environments/grasp_type.md": 1_800,
    "docs/grasps.md": 1_800,
}
"""Most words of the long pages, tables included. Others: `MOST_WORDS`."""
MOST_WORDS = 1_800
ALL_WORDS = 25_000
"""Most words of all pages, less the tables that are generated from the code and the data."""


def words_of(text: str) -> int:
    """Number of words: what has a letter or a digit, between spaces."""
    return sum(any(sign.isalnum() for sign in word) for word in text.split())


def by_hand(text: str) -> str:
    """A page's text without its generated tables."""
    return re.sub(r"<!-- ([\w-]+) -->.*?<!-- /\1 -->", "", text, flags=re.DOTALL)


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def without_code(page: Path) -> str:
    """The text of a page, less its programs and commands."""
    return re.sub(r"^```.*?^```", "", text_of(page), flags=re.DOTALL | re.MULTILINE)


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", text_of(page), re.DOTALL | re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """What GitHub makes of the headings of a page."""
    headings = re.findall(r"^#+ (.*)", without_code(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def links(page: Path) -> list[str]:
    """The relative links of a page."""
    return [
        link for link in re.findall(r"\]\(([^)\s]+)\)", without_code(page)) if "://" not in link
    ]


LINKED = {(page.parent / link).resolve() for page in PAGES for link in links(page)}
"""What the pages show or link to."""


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_link_leads_to_a_file_and_a_heading(page):
    for link in links(page):
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


@pytest.mark.parametrize(
    "page", [page for page in PAGES if page.name != "CHANGELOG.md"], ids=name_of
)
def test_every_path_that_a_page_names_is_there(page):
    folders = "agents|assets|docs|examples|experiments|firmware|hpac_gym|tests|tools"
    for path in re.findall(rf"`((?:{folders})/[\w./-]+)`", without_code(page)):
        assert (ROOT / path).exists() or "/build/" in path, path


@pytest.mark.parametrize("image", IMAGES, ids=lambda image: image.name)
def test_every_picture_is_shown(image):
    assert image in LINKED


# Programs ------------------------------------------------------------------------------------

# tests/test_own_task.py runs those of own_task.md, which are files of their own.
PROGRAMS = [
    page
    for page in PAGES
    if blocks(page, "python") and page.name not in ("CHANGELOG.md", "own_task.md")
]


RUN_ALL = """
import runpy, sys
for file in sys.argv[1:]:
    runpy.run_path(file, run_name="__main__")
"""


def run_programs(pages: list[Path], folder: Path) -> None:
    """A page's programs in one file, one after the other, since they may use what stands above
    them; all files in one process, which loads the packages once.
    """
    (folder / "hand.toml").write_text(hand_to_toml(HPAC))  # as `hpac calibrate` writes one
    files = []
    for page in pages:
        lines = textwrap.indent("\n".join(blocks(page, "python")), "    ")
        files.append(folder / f"{name_of(page).replace('/', '_')}.py")
        files[-1].write_text(f"def main():\n{lines}\n\n\nif __name__ == '__main__':\n    main()\n")
    done = python("-c", RUN_ALL, *map(str, files), folder=folder)
    assert done.returncode == 0, done.stderr


def test_every_program_of_a_page_runs(tmp_path):
    """Those of the README alone, below."""
    run_programs([page for page in PROGRAMS if page != ROOT / "README.md"], tmp_path)


LEARNER = "stable_baselines3"
"""Loading one alone takes seconds."""
README = text_of(ROOT / "README.md")


@pytest.mark.parametrize(
    "program",
    [
        pytest.param(program, marks=[pytest.mark.slow] if LEARNER in program else [])
        for program in blocks(ROOT / "README.md", "python")
    ],
    ids=lambda program: program.split()[1],
)
def test_a_program_of_the_readme_prints_and_complains_of_nothing(program):
    done = python("-c", program)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    assert done.stderr == ""


def shell_lines(page: Path) -> list[str]:
    """The lines of the shell blocks of a page, less their comments."""
    found = re.findall(r"^```(.*?)\n(.*?)^```", text_of(page), re.S | re.M)
    text = "\n".join(block for language, block in found if language in ("", "console", "sh"))
    return [line.partition(" #")[0].strip() for line in text.replace("\\\n", " ").splitlines()]


def commands_of(page: Path) -> list[str]:
    """The lines of `hpac` in the blocks of a page, less what leaves something out."""
    return [line for line in shell_lines(page) if line.startswith("hpac ") and "…" not in line]


def named_in_text(page: Path) -> set[tuple[str, str]]:
    """Commands of `hpac` with one of their options, as the text of a page names them."""
    inline = re.findall(r"(?<!`)`hpac ([a-z]+)\b([^`]*)`(?!`)", without_code(page))
    return {(name, word) for name, rest in inline for word in re.findall(r"--[a-z-]+", rest)}


NAMES = {command.name for command in COMMANDS}


def parse(line: str) -> None:
    """Parse a line of `hpac` as the command does; run nothing.

    Raises:
        SystemExit: It is refused.
    """
    words = shlex.split(line.partition(" && ")[0])[1:]
    if words[0] in NAMES:  # `hpac COMMAND --help` and the like
        parser_of(words).parse_args(words)


@pytest.mark.parametrize("page", [page for page in PAGES if commands_of(page)], ids=name_of)
def test_every_command_of_a_page_parses(page, capsys):
    for line in commands_of(page):
        try:
            parse(line)
        except SystemExit as left:
            if left.code:
                pytest.fail(f"{line}: {capsys.readouterr().err}")


class Parsed(Exception):
    """A command has been parsed; it does not run."""


def parse_module(line: str, monkeypatch) -> None:
    """Parse a line of `python -m` as its module does; run nothing.

    Raises:
        SystemExit: It is refused.
    """
    plain = argparse.ArgumentParser.parse_args

    def parsed(self, *given):
        plain(self, *given)
        raise Parsed

    words = shlex.split(line)[2:]
    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parsed)
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(Parsed):
        runpy.run_module(words[0], run_name="__main__", alter_sys=True)


def modules_of(page: Path) -> list[str]:
    """The lines of `python -m` with a module of ours and options, in the blocks and text of a page."""
    own = r"python -m (?:agents|experiments|tools)\.[\w.]+[^\n`|)]*"
    found = re.findall(own, text_of(page).replace("\\\n", " "))
    lines = {line.partition(" #")[0].strip() for line in found if "…" not in line}
    return sorted(line for line in lines if " --" in line)


@pytest.mark.parametrize("page", [page for page in PAGES if modules_of(page)], ids=name_of)
def test_every_module_of_a_page_takes_its_arguments(page, monkeypatch, capsys):
    for line in modules_of(page):
        try:
            parse_module(line, monkeypatch)
        except SystemExit as left:
            pytest.fail(f"{line}: {left.code}: {capsys.readouterr().err}")


def test_arguments_that_a_command_or_a_module_does_not_take_are_found(monkeypatch):
    with pytest.raises(SystemExit):
        parse("hpac evaluate --nonsense")
    with pytest.raises(SystemExit):
        parse_module("python -m tools.film_strip HPAC-Grasp-v0 --nonsense", monkeypatch)


def options_of(name: str) -> set[str]:
    """The options of a command, from its help."""
    return set(re.findall(r"--[a-z-]+", help_of(name)))


@pytest.mark.parametrize("page", [page for page in PAGES if named_in_text(page)], ids=name_of)
def test_the_text_of_a_page_names_options_that_exist(page):
    named = named_in_text(page)
    assert {name for name, _ in named} <= NAMES
    assert not {(name, option) for name, option in named if option not in options_of(name)}


# Size ----------------------------------------------------------------------------------------


def test_every_command_names_a_module_that_is_there():
    pages = [ROOT / "README.md", *DOCS.rglob("*.md")]
    texts = [text_of(page) for page in pages]
    own = r"python -m ((?:agents|experiments|tools|hpac_gym)\.[\w.]*\w)"
    modules = {name for text in texts for name in re.findall(own, text)}
    assert len(modules) > 10
    for name in modules:
        assert (ROOT / (name.replace(".", "/") + ".py")).exists(), name
    named = {name for text in texts for name in re.findall(r"^hpac ([a-z]+)", text, flags=re.M)}
    assert {"show", "deploy", "doctor"} <= named <= NAMES


def test_the_readme_is_short():
    assert len(README.splitlines()) <= 120
    assert len(README.split()) <= 900


def test_a_count_in_the_readme_is_that_of_its_page():
    told = re.findall(r"\[([\d,]+) of ([\d,]+)\]\(([\w/]+\.md)", README)
    assert told
    for *counts, page in told:
        assert set(counts) <= set(re.findall(r"[\d,]+", text_of(ROOT / page)))


IN_DOCS = [page for page in PAGES if page.parent != ROOT]


@pytest.mark.parametrize("page", IN_DOCS, ids=name_of)
def test_a_page_is_short(page):
    words = words_of(text_of(page))
    assert words <= WORDS.get(name_of(page), MOST_WORDS), f"{words} words"


def test_all_pages_together_are_short(capsys):
    hand = sum(words_of(by_hand(text_of(page))) for page in IN_DOCS)
    tables = sum(words_of(text_of(page)) for page in IN_DOCS) - hand
    with capsys.disabled():
        print(f"\n{len(IN_DOCS)} pages: {hand:,} words, and {tables:,} in generated tables")
    assert hand <= ALL_WORDS


# Data and site -------------------------------------------------------------------------------


@pytest.mark.parametrize("path", TABLES, ids=lambda path: path.stem)
def test_a_table_has_its_command_and_is_linked(path):
    table = json.loads(text_of(path))
    assert table.keys() == {"title", "command", "note", "head", "rows"}
    assert {len(row) for row in table["rows"]} == {len(table["head"])}
    for module in re.findall(r"python -m ((?:agents|experiments|tools)\.\w+)", table["command"]):
        assert (ROOT / (module.replace(".", "/") + ".py")).exists()
    for line in table["command"].split("; "):
        if line.startswith("hpac "):
            parse(line)
    assert path in LINKED


def test_the_glossary_has_the_ten_words():
    section = text_of(DOCS / "concepts.md").split("## Ten words")[1].split("\n## ")[0]
    words = re.findall(r"^\| \*\*([\w-]+)\*\* \|", section, re.M)
    assert sorted(words) == [
        *("body", "closure", "deploy", "light", "privileged"),
        *("set-up", "split", "synergy", "trial", "twin"),
    ]


def test_the_table_of_contents_has_every_page_once():
    trees = "\n".join(blocks(DOCS / "index.md", r"\{toctree\}"))
    listed = [line for line in trees.splitlines() if line and not line.startswith(":")]
    pages = {name_of(page)[len("docs/") : -len(".md")] for page in PAGES if page.parent != ROOT}
    outer = {f"_reference/{name}" for name in ("boards", "esp32", "contributing", "changelog")}
    assert sorted(listed) == sorted((pages - {"index"}) | {"measured"} | outer)


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path):
    words = ["-m", "sphinx", "-q", "--fail-on-warning", "--keep-going", str(DOCS), str(tmp_path)]
    done = python(*words)
    assert (done.returncode, done.stderr) == (0, "")
    assert "Every table" in (tmp_path / "measured.html").read_text(encoding="utf-8")
    real = (tmp_path / "real_hand.html").read_text(encoding="utf-8")
    for link in ("boards.html", "esp32.html#wiring", "esp32.html#build-and-flash"):
        assert f'href="_reference/{link}"' in real
    assert "HandLink" in (tmp_path / "_reference" / "hpac_gym.bridge.html").read_text()
