"""The notebooks of the documentation run, and their stored outputs are those of today."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from commands import SAMPLES
from doc_outputs import check_output
from doc_pages import DOCS, PAGES
from notebooks import output_texts, read_notebook, run_notebook, write_notebook

NOTEBOOKS = sorted((PAGES / "notebooks").glob("*.ipynb"))
MAX_SIZE = 200_000  # bytes


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_has_todays_outputs(path: Path, tmp_path: Path, pytestconfig: pytest.Config) -> None:
    folder = tmp_path / path.parent.relative_to(DOCS.parent)
    folder.mkdir(parents=True)
    (tmp_path / "sample_logs").symlink_to(SAMPLES)
    stored = read_notebook(path)
    run = run_notebook(stored, folder)
    if pytestconfig.getoption("--update-docs"):
        write_notebook(path, run)
        return
    for index, (old, new) in enumerate(zip(stored["cells"], run["cells"], strict=True)):
        old_texts, new_texts = output_texts(old), output_texts(new)
        assert list(old_texts) == list(new_texts), f"{path.name}, cell {index}"
        for kind, text in old_texts.items():
            check_output(text, new_texts[kind], f"{path.name}, cell {index}, {kind}")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_small_and_its_links_lead_somewhere(path: Path) -> None:
    assert path.stat().st_size < MAX_SIZE
    for cell in read_notebook(path)["cells"]:
        if cell["cell_type"] == "code":
            assert cell["execution_count"], "a cell without outputs"
            continue
        for link in re.findall(r"\]\(([^)#]+)", "".join(cell["source"])):
            assert (path.parent / link).is_file(), link


def test_there_are_notebooks() -> None:
    assert NOTEBOOKS
