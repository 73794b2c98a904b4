"""Files kept for the next process, as Python keeps compiled modules."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from idtool.common.kept_files import keep, read_kept


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.setattr(sys, "pycache_prefix", None)
    return str(tmp_path / "module.py")


def test_a_file_is_kept_beside_the_compiled_module(module: str, tmp_path: Path) -> None:
    assert read_kept(module, "a-1.0.bin") is None
    keep(module, "a-1.0.bin", b"one")
    keep(module, "a-1.0.bin", b"two")
    assert read_kept(module, "a-1.0.bin") == b"two"
    assert [path.name for path in (tmp_path / "__pycache__").iterdir()] == ["a-1.0.bin"]


def test_it_is_kept_where_python_was_told_to(module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "pycache_prefix", str(tmp_path / "prefix"))
    keep(module, "a", b"one")
    assert read_kept(module, "a") == b"one"
    assert not (tmp_path / "__pycache__").exists()


def test_nothing_is_kept_where_python_keeps_nothing(
    module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    keep(module, "a", b"one")
    assert read_kept(module, "a") is None
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_to_is_no_error(module: str, tmp_path: Path) -> None:
    (tmp_path / "__pycache__").write_text("a file in its place")
    keep(module, "a", b"one")
    assert read_kept(module, "a") is None
