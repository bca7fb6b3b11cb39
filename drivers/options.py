"""Base class for the options of a driver plugin, and replacement of option keys that have been renamed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, get_args

from pydantic import BaseModel, ConfigDict


class DriverOptions(BaseModel):
    """Base class for the options of a driver and for the sections of these options.

    Instances are immutable. An unknown key is an error.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    former_keys: ClassVar[Mapping[str, str]] = {}
    """Current names of renamed keys, by former name.

    A settings file with a former key is refused, and the message gives the current one.
    """


def rename_former_keys(options: Mapping[str, Any], kind: type[BaseModel]) -> dict[str, Any]:
    """Return `options` with every former name of a renamed key replaced by the current name, also in nested sections.

    The options class `kind` and the classes of its sections state the former keys.
    """
    former = _former_keys(kind)
    current = {former.get(name, name): value for name, value in options.items()}
    for name, value in current.items():
        section = _section(kind, name)
        if section is not None and isinstance(value, Mapping):
            current[name] = rename_former_keys(value, section)
    return current


def find_former_key(options: Mapping[str, Any], kind: type[BaseModel]) -> tuple[tuple[str, ...], str] | None:
    """Return the path of the first key in `options` that has been renamed, and the current name of this key.

    Returns None if `options` contains no renamed key.
    """
    former = _former_keys(kind)
    for name, value in options.items():
        if name in former:
            return (name,), former[name]
        section = _section(kind, name)
        if section is not None and isinstance(value, Mapping):
            inner = find_former_key(value, section)
            if inner is not None:
                return (name, *inner[0]), inner[1]
    return None


def _former_keys(kind: type[BaseModel]) -> Mapping[str, str]:
    return kind.former_keys if issubclass(kind, DriverOptions) else {}


def _section(kind: type[BaseModel], name: str) -> type[BaseModel] | None:
    """Return the model of the key `name` if it is a section, optional or not; otherwise None."""
    field = kind.model_fields.get(name)
    if field is None:
        return None
    annotations = (field.annotation, *get_args(field.annotation))
    return next((one for one in annotations if isinstance(one, type) and issubclass(one, BaseModel)), None)
