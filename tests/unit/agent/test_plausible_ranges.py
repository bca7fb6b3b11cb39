"""Lengths, masses and times that are possible but not plausible cause a warning of `volcal config check`."""

from __future__ import annotations

import dataclasses
import re
import shutil
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel
from volcal_command import volcal

from agent.settings.load import load_settings
from agent.settings.plausible_ranges import (
    ARTEFACT_RANGES,
    MACHINE_RANGES,
    SETTINGS_RANGES,
    UNITS,
    implausible_values,
)
from agent.settings.schema import Settings
from twin.formats.artefact_file import ArtefactDocument
from twin.formats.machine_file import MachineSection

CONFIG = Path(__file__).resolve().parents[3] / "config"
OTHERS = {"gates.max_slope_um_per_mm", "timing.speed_deg_per_s"}
"""Keys that end like a length or a time but are neither."""


def keys(model: Any, prefix: str = "") -> Iterator[str]:
    """Yield the dotted keys of a file, from the classes that read it. A table with names of one's own has the key *."""
    named = model.model_fields if hasattr(model, "model_fields") else model.__dataclass_fields__
    hints = typing.get_type_hints(model)
    for name in named:
        sections = [one for one in parts(hints[name]) if isinstance(one, type) and is_section(one)]
        own_names = any(typing.get_origin(one) is dict for one in parts(hints[name]))
        for section in sections:
            yield from keys(section, f"{prefix}{name}." + ("*." if own_names else ""))
        if not sections:
            yield prefix + name


def parts(annotation: Any) -> Iterator[Any]:
    yield annotation
    for part in typing.get_args(annotation):
        yield from parts(part)


def is_section(one: type) -> bool:
    return issubclass(one, BaseModel) or dataclasses.is_dataclass(one)


@pytest.mark.parametrize(
    ("model", "ranges"),
    [(Settings, SETTINGS_RANGES), (MachineSection, MACHINE_RANGES), (ArtefactDocument, ARTEFACT_RANGES)],
)
def test_every_length_mass_and_time_has_a_plausible_range(model: type, ranges: dict[str, Any]) -> None:
    sizes = {re.sub(r"^axes\.[XYZ]", "axes.*", key) for key in keys(model) if key.endswith(tuple(UNITS))} - OTHERS
    assert len(sizes) > 8
    described = {key for pattern in ranges for key in sizes if re.fullmatch(pattern.replace("*", r".*"), key)}
    assert described == sizes
    assert all(one.lowest < one.highest for one in ranges.values())
    stale = {key for key in ranges if "*" not in key} - sizes
    assert stale == set()


@pytest.mark.parametrize(
    "path", [*sorted(CONFIG.glob("*.toml")), CONFIG / "linuxcnc" / "volcal.toml"], ids=lambda path: path.stem
)
def test_the_shipped_files_are_plausible(path: Path) -> None:
    assert list(implausible_values(load_settings(path), path)) == []


@pytest.mark.parametrize(
    ("file", "old", "new", "key"),
    [
        ("volcal.toml", "[probe]", "[probe]\ntip_radius_mm = 0.002", "probe.tip_radius_mm: the value 0.002 mm"),
        ("volcal.toml", "[procedure]", "[procedure]\nclearance_mm = 0.003", "procedure.clearance_mm"),
        (
            "volcal.toml",
            "[procedure]",
            "[procedure]\ntouch_sigma_um = 0.001",
            "procedure.touch_sigma_um: the value 0.001 µm",
        ),
        (
            "machine.toml",
            "rapid_mm_per_min",
            "rapid_mm_per_min = 20.0 #",
            "axes.X.rapid_mm_per_min: the value 20 mm/min",
        ),
        ("artefact.toml", "ball_diameter_mm", "ball_diameter_mm = 0.5 #", "ball_diameter_mm: the value 0.5 mm"),
    ],
)
def test_a_value_with_a_wrong_unit_is_warned_of(tmp_path: Path, file: str, old: str, new: str, key: str) -> None:
    settings = (CONFIG / "mill.toml").read_text()
    settings = re.sub(r"(?m)^machine = .*", 'machine = "machine.toml"', settings, count=1)
    settings = re.sub(r"(?m)^artefact = .*", 'artefact = "artefact.toml"', settings, count=1)
    for drop in ("tip_radius_mm", "clearance_mm", "touch_sigma_um"):
        settings = re.sub(rf"(?m)^{drop} = .*$", "", settings)
    (tmp_path / "volcal.toml").write_text(settings)
    named = load_settings(CONFIG / "mill.toml")
    shutil.copy(named.machine, tmp_path / "machine.toml")
    shutil.copy(named.artefact, tmp_path / "artefact.toml")
    for positions in CONFIG.glob("*.csv"):
        shutil.copy(positions, tmp_path)
    text = (tmp_path / file).read_text()
    assert old in text
    (tmp_path / file).write_text(text.replace(old, new, 1))
    path = tmp_path / "volcal.toml"
    warnings = list(implausible_values(load_settings(path), path))
    assert len(warnings) == 1
    assert f"key {key}" in warnings[0]
    assert str(tmp_path / file) in warnings[0]


def test_config_check_prints_the_warnings_and_goes_on(tmp_path: Path) -> None:
    text = (CONFIG / "mill.toml").read_text()
    text = re.sub(r"(?m)^tip_radius_mm = .*$", "tip_radius_mm = 0.02", text)
    text = re.sub(r'(?m)^(machine|artefact) = "(.*)"', rf'\1 = "{CONFIG}/\2"', text, count=2)
    for positions in CONFIG.glob("*.csv"):
        shutil.copy(positions, tmp_path)
    (tmp_path / "volcal.toml").write_text(text)
    ended = volcal("config", "check", tmp_path / "volcal.toml")
    assert "warning: " in ended.stderr
    assert "probe.tip_radius_mm: the value 0.02 mm is not plausible" in ended.stderr
    assert "good" in ended.stdout
