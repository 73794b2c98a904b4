"""Configuration files that are broken or hostile."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import pytest

from idtool.common.exceptions import ConfigError
from idtool.robot.config import Config, read_config

Read = Callable[[str | bytes], Config]
Refusal = Callable[[str | bytes], str]


@pytest.mark.parametrize(
    ("text", "line"),
    [("seed: 1\nvelocity: auto\nseed: 2", 3), ("log:\n  topic: /a\n  topic: /b", 3), ("log: {topic: a, topic: b}", 1)],
)
def test_a_repeated_key_is_refused(refusal: Refusal, text: str, line: int) -> None:
    assert "duplicate key" in refusal(text)


@pytest.mark.parametrize("link", ["[{}]", "{{<<: [{}]}}"], ids=["lists", "merged mappings"])
def test_nested_aliases_are_refused(refusal: Refusal, link: str) -> None:
    names = "abcdefghijkl"
    levels = [
        f"{name}: &{name} {link.format(', '.join([f'*{previous}'] * 9))}"
        for previous, name in itertools.pairwise(names)
    ]
    assert "aliases are expanded" in refusal("\n".join(["a: &a {x: 1}", *levels]))


@pytest.mark.parametrize("text", ["&a [*a]", "joints: &a [*a]", "&a {log: *a}"])
def test_an_alias_to_what_holds_it_is_refused(refusal: Refusal, text: str) -> None:
    assert "aliases are expanded" in refusal(text)


def test_an_alias_that_only_saves_typing_is_fine(read: Read) -> None:
    text = "bounding_ellipsoids: {left: &e [{semi_axes: [1, 2, 3]}], right: *e}"
    assert read(text).bounding_ellipsoids["right"][0].semi_axes == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("tag", ["!!python/object/apply:os.system", "!!python/name:os.system", "!!python/tuple", "!x"])
def test_tags_that_make_objects_are_refused(refusal: Refusal, tag: str) -> None:
    assert "is not YAML in line 1" in refusal(f"joints: {tag} ['touch /tmp/owned']")


@pytest.mark.parametrize(
    "value",
    [
        *("!!bool perhaps", "!!int ''", "!!int three", "!!float ''", "!!timestamp soon", "!!binary x", "2001-99-99"),
        *("0x_", "1:" * 300 + "1.5", "1" * 6000),
    ],
)
def test_values_that_belie_their_tag_are_refused(refusal: Refusal, value: str) -> None:
    assert refusal(f"seed: {value}").startswith("is not YAML")


@pytest.mark.parametrize("value", ["1:" * 100_000 + "1", "9" * 100_000, '"' + "\\x41" * 20_000 + '"'])
def test_values_without_end_are_refused(refusal: Refusal, value: str) -> None:
    assert "characters in line 2" in refusal(f"joints: []\nseed: {value}")


@pytest.mark.parametrize(
    "text",
    [
        *("joints: [hip", "a: b: c", "\tjoints: []", "seed: *nowhere", "{}\n---\n{}", "? [1, 2]\n: 3", "<<: 3"),
        *("[" * 3000, b"\xff\xfe\x00", b"\x00\x01\x02", b"\x89PNG\r\n\x1a\n", b"seed: \xff"),
    ],
    ids=lambda text: repr(text)[:20],
)
def test_what_is_not_yaml_is_refused(refusal: Refusal, text: str | bytes) -> None:
    assert refusal(text).startswith("is not YAML")


def test_a_huge_file_is_refused_unread(refusal: Refusal) -> None:
    assert refusal("#" * (2 << 20)) == "is larger than 1 MiB"


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    for path in (tmp_path / "none.yaml", tmp_path):
        with pytest.raises(ConfigError, match="cannot be read"):
            read_config(path)
