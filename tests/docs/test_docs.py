"""Every command and code block of the documentation, and the site that is made of it."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from html.parser import HTMLParser
from pathlib import Path

import pytest
import typer
import yaml
from commands import idtool, strict_json
from doc_pages import DOCS, PAGES, README, Reader, blocks, pages
from paths import CHECKOUT, REAL

from idtool.cli import app
from idtool.robot.config import parse_config

ALL = [README, *pages()]
NAMES = [str(page.relative_to(CHECKOUT if page == README else PAGES)) for page in ALL]
LANGUAGES = {"", "sh", "python", "yaml", "json", "text"}
EXAMPLES = {name: command.epilog for name, command in typer.main.get_command(app).commands.items()}  # type: ignore[attr-defined]
# test_cli runs those of fit and validate, too
QUICK = ["inspect", "simulate", "export", "compare", "adapt", "ellipsoids", "init"]
ASSETS = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src"}


RUN = [page for page in ALL if any(block.language in ("sh", "python") for block in blocks(page))]
RUN_NAMES = [NAMES[ALL.index(page)] for page in RUN]
IN_CI = ("README.md", "tutorial.md")  # of the quick commands
SOME_SLOW = []
for page, name in zip(RUN, RUN_NAMES, strict=True):
    SOME_SLOW.append(pytest.param(page, marks=() if name in IN_CI else pytest.mark.slow))


def commands(page: Path) -> set[str]:
    """The command lines of a page, without remarks."""
    return {line.partition("  #")[0].rstrip() for block in blocks(page) for line in block.commands}


@pytest.mark.parametrize("page", SOME_SLOW, ids=RUN_NAMES)
def test_the_quick_commands_of_a_page_run(page: Path, tmp_path: Path, pytestconfig: pytest.Config) -> None:
    if page != README and commands(page) and commands(page) <= commands(README):
        return  # they are run there
    Reader(tmp_path, slow=False, update=pytestconfig.getoption("--update-docs")).read(page)


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN, ids=RUN_NAMES)
def test_all_commands_of_a_page_run(page: Path, tmp_path: Path, pytestconfig: pytest.Config) -> None:
    real = [block.line for block in blocks(page) if block.real]
    Reader(tmp_path, slow=True, update=pytestconfig.getoption("--update-docs")).read(page)
    if real and not REAL.is_dir():
        pytest.skip(f"all but the blocks at lines {real}, whose logs are not in {REAL}")


def run_examples(folder: Path, names: list[str]) -> None:
    """Run the examples of the help texts, in this order, where `idtool fit` has been run."""
    reader = Reader(folder, slow=True)
    done = idtool("fit", "leg.urdf", "run1.mcap", "--quick", folder=reader.folder)
    assert done.code == 0, done.err
    shutil.copytree(reader.folder / "leg_idtool", reader.folder / "other_leg_idtool")
    for name in names:
        line = EXAMPLES[name].removeprefix("Example: ")
        if name == "init":
            (folder / "leg.yaml").unlink()  # as for a user who has none
        done = idtool(*shlex.split(line)[1:], folder=reader.folder)
        assert done.code == 0, f"{line}: {done.err}"


def test_the_examples_of_the_help_run(tmp_path: Path) -> None:
    run_examples(tmp_path, QUICK)


@pytest.mark.slow
def test_the_long_examples_of_the_help_run(tmp_path: Path) -> None:
    run_examples(tmp_path, [name for name in EXAMPLES if name not in QUICK])


@pytest.mark.parametrize("page", ALL, ids=NAMES)
def test_blocks_are_what_they_say(page: Path) -> None:
    for block in blocks(page):
        where = f"{page.name}, line {block.line}"
        assert block.language in LANGUAGES, where
        if block.language == "yaml":
            data = yaml.safe_load(block.text)
            assert parse_config(data, where).model_fields_set == set(data)
        elif block.language == "json":
            strict_json(block.text)
        elif block.language == "text":
            assert block.text.strip(), where


def test_every_page_has_something_to_run_or_is_a_reference() -> None:
    ran = {page.name for page in ALL if any(block.commands for block in blocks(page))}
    assert {page.name for page in ALL} - ran <= {
        "method.md",
        "config.md",
        "json.md",
        "effects.md",
        "notices.md",
        "python.md",
        "benchmarks.md",
        "comparison.md",
        "contributing.md",
    }


class _Assets(HTMLParser):
    """What a page loads."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in ASSETS and (address := dict(attrs).get(ASSETS[tag])):
            self.found.append(address)


def build(folder: Path, config: Path = DOCS / "mkdocs.yml") -> subprocess.CompletedProcess[str]:
    """Build the site into a folder; not quietly, or mkdocs does not count its warnings."""
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", str(config), "-d", str(folder)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_site_is_built_and_loads_nothing_from_elsewhere(tmp_path: Path) -> None:
    done = build(tmp_path / "site")
    assert done.returncode == 0, done.stderr
    built = {
        str(page.relative_to(tmp_path / "site").with_suffix(".md")) for page in (tmp_path / "site").rglob("*.html")
    }
    assert {str(page.relative_to(PAGES)) for page in pages()} <= built
    for page in (tmp_path / "site").rglob("*.html"):
        reader = _Assets()
        reader.feed(page.read_text())
        assert reader.found
        assert not [address for address in reader.found if re.match(r"(\w+:)?//", address)], page.name
    for style in (tmp_path / "site").rglob("*.css"):
        assert not re.search(r"(@import|url\()\W*(\w+:)?//", style.read_text()), style.name


def test_links_that_lead_nowhere_stop_the_build(tmp_path: Path) -> None:
    shutil.copytree(DOCS, tmp_path / "docs")
    page = tmp_path / "docs" / "pages" / "index.md"
    links = ("nowhere.md", "config.md#nowhere", "/config.md")
    page.write_text(page.read_text() + "".join(f"\n[somewhere]({link})\n" for link in links))
    done = build(tmp_path / "site", tmp_path / "docs" / "mkdocs.yml")
    assert done.returncode != 0
    for link in links:
        assert f"'{link}'" in done.stderr


@pytest.mark.parametrize("page", ALL, ids=NAMES)
def test_extras_that_are_to_be_installed_exist(page: Path) -> None:
    extras = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    packages = {re.split(r"\W", line)[0] for line in extras["dev"]}
    for line in re.findall(r"`pip install ([^`]*)`", " ".join(page.read_text().split())):
        named = re.fullmatch(r"(?:-e )?'\.\[(\w+)\]'", line)
        assert named[1] in extras if named else line == "." or line in packages, line


def test_links_of_the_readme_lead_somewhere() -> None:
    text = README.read_text()
    links = [link for link in re.findall(r"\]\(([^)\s]+)\)", text) if not re.match(r"\w+:", link)]
    headings = {re.sub(r"[^\w\- ]", "", line.lstrip("# ").lower()).replace(" ", "-") for line in text.splitlines()}
    assert "docs/pages/index.md" in links
    for link in links:
        path, _, anchor = link.partition("#")
        assert (CHECKOUT / path).exists(), link
        assert path or anchor in headings, link
