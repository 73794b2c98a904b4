"""Comparison of the values in a simulator's file with those that are to be written, however the file writes them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from idtool.common.arrays import Array
from idtool.robot.inertia import round_to_digits, rounded_inertial, symmetric_entries
from idtool.robot.urdf.text import Element

_ORIENTATIONS = {
    "quat": "1 0 0 0",
    "axisangle": None,
    "xyaxes": "1 0 0 0 1 0",
    "zaxis": "0 0 1",
    "euler": "0 0 0",
}  # attributes that turn the axes of an element of MJCF, and their values that do not
_INERTIA = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")
_TOLERANCE = 1e-6  # relative, of an inertial


def has_value(written: str | None, value: str, digits: int) -> bool:
    """True if an attribute has a value already, to so many digits.

    Parameters
    ----------
    written
        The attribute as it is written; None: it is not, and its default is not known.
    value
        Its new numbers.
    digits
        Digits of the new numbers.
    """
    present = _numbers(written)
    new = _numbers(value)
    if present is None or new is None or present.shape != new.shape:
        return False
    return bool(np.array_equal(round_to_digits(present, digits), new))


def is_turned(element: Element) -> bool:
    """True if an element of MJCF may have other axes than its parent."""
    for name, identity in _ORIENTATIONS.items():
        if name in element.attributes and element.attributes[name].split() != (identity or "").split():
            return True
    return False


def default_attributes(root: Element, tag: str) -> dict[str, Mapping[str, str]]:
    """Attributes that an MJCF gives the elements of a tag, by default class; "": to those that name no class."""
    attributes: dict[str, Mapping[str, str]] = {}
    main: Mapping[str, str] = {}
    for section in root.with_tag("default"):
        main = {**main, **_attributes(section, tag)}
        attributes[section.attributes.get("class", "main")] = main
        _add_subclasses(section, tag, main, attributes)
    attributes[""] = main
    return attributes


def _add_subclasses(
    section: Element, tag: str, inherited: Mapping[str, str], attributes: dict[str, Mapping[str, str]]
) -> None:
    """Add the attributes of the classes in a default class, with those that they inherit."""
    for subclass in section.with_tag("default"):
        own = {**inherited, **_attributes(subclass, tag)}
        attributes[subclass.attributes.get("class", "")] = own
        _add_subclasses(subclass, tag, own, attributes)


def has_mjcf_inertia(inertial: Element, pi: Array) -> bool:
    """True if an inertial of MJCF is that of a body; one with turned axes counts as another."""
    attributes = inertial.attributes
    if is_turned(inertial):
        return False
    entries = _numbers(attributes.get("fullinertia", f"{attributes.get('diaginertia')} 0 0 0"))
    if entries is None or entries.shape != (6,):
        return False
    mass = _numbers(attributes.get("mass"))
    com = _numbers(attributes.get("pos"))
    return _is_inertia(mass, com, entries[[0, 3, 1, 4, 5, 2]], pi)


def has_urdf_inertia(link: Element, pi: Array | None) -> bool:
    """True if a link of a URDF has the inertia of a body, None: without mass; turned axes count as another inertia."""
    inertial = link.first("inertial")
    if inertial is None or pi is None:
        return inertial is None and pi is None
    origin = _attributes(inertial, "origin")
    mass = _attributes(inertial, "mass")
    inertia = _attributes(inertial, "inertia")
    turn = _numbers(origin.get("rpy", "0 0 0"))
    if turn is None or turn.any():
        return False
    entries = _numbers(" ".join(inertia.get(name, "0") for name in _INERTIA))
    return _is_inertia(_numbers(mass.get("value")), _numbers(origin.get("xyz", "0 0 0")), entries, pi)


def _attributes(parent: Element, name: str) -> Mapping[str, str]:
    """Attributes of the first child of a name; none if there is no child."""
    child = parent.first(name)
    return {} if child is None else child.attributes


def _is_inertia(mass: Array | None, com: Array | None, entries: Array | None, pi: Array) -> bool:
    """True if mass, centre of mass and [xx, xy, yy, xz, yz, zz] about it are those of a body."""
    new_mass, new_com, new_inertia = rounded_inertial(pi)
    new = (np.array([new_mass]), new_com, symmetric_entries(new_inertia))
    present = (mass, com, entries)
    return all(_is_close(before, after) for before, after in zip(present, new, strict=True))


def _is_close(present: Array | None, new: Array) -> bool:
    """True if present numbers are new ones but for rounding."""
    if present is None or present.shape != new.shape:
        return False
    return bool(np.abs(present - new).max() <= _TOLERANCE * np.abs(new).max())


def _numbers(text: str | None) -> Array | None:
    """Numbers of an attribute; None if it holds something else, or is not there."""
    try:
        return np.array([float(x) for x in text.split()]) if text is not None else None
    except ValueError:
        return None
