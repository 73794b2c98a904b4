"""The JSON schema of the configuration accepts every configuration that idtool reads, and refuses mistaken keys."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
import yaml
from doc_pages import README, blocks, pages
from paths import CHECKOUT

from idtool.robot.config.example import EXAMPLE
from idtool.robot.config.schema import config_schema

jsonschema = pytest.importorskip("jsonschema")

SHORT = [
    "controller: {kp: 25, kd: 1, delay: 0.01}",
    "armature: auto",
    "armature: 0.05",
    "armature: {hip: 0.05, knee: auto, abad: {value: 0.05, standard_error: 0.01}}",
    "log: {scale: {q: 0.0175}}",
    "limits: {velocity: 5}",
    "rotors: {motor: {joint: hip, gear_ratio: 9, inertia: 0.0006}}",
    "friction: {viscous: 0.1, coulomb: true}",
    "friction: {}",
    "known: {total_mass: 3, mass: {thigh: 1}}",
    "pool: {own: friction}",
]


def configurations() -> Iterator[Any]:
    """Those of the documentation, the samples and the example for messages, and short forms."""
    yield yaml.safe_load(EXAMPLE)
    yield from map(yaml.safe_load, SHORT)
    for path in (*(CHECKOUT / "configs").glob("*.yaml"), *(CHECKOUT / "sample_logs").glob("*.yaml")):
        if path.stem not in ("manifest", "truth"):
            yield yaml.safe_load(path.read_text())
    for page in (README, *pages()):
        for block in blocks(page):
            if block.language == "yaml":
                yield yaml.safe_load(block.text)


def test_the_schema_accepts_what_is_read() -> None:
    validator = jsonschema.Draft202012Validator(json.loads(config_schema()))
    checked = 0
    for data in configurations():
        validator.validate(data)
        checked += 1
    assert checked > 30


@pytest.mark.parametrize("text", ["kp: 25", "controller: {kp: 25, kx: 3}", "armature: some", "limits: {velocity: -5}"])
def test_the_schema_refuses_what_is_refused(text: str) -> None:
    validator = jsonschema.Draft202012Validator(json.loads(config_schema()))
    assert not validator.is_valid(yaml.safe_load(text))
