"""Plugin `simulated`: a machine in this process, for trials and preflights.

The settings are either the path of a scenario file or the keys of a scenario. `ideal = true` removes all errors of the
simulated machine.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, PrivateAttr, ValidationError, model_validator

from drivers.registry import DeviceContext, DriverPlugin
from simulators.backend import SimulatedMachineDevice
from simulators.scenario import ScenarioDocument, build_scenario, read_scenario
from simulators.world.world import World


class SimulatedSettings(BaseModel):
    """Settings of the plugin `simulated`: either `scenario`, the path of a scenario file, or the keys of
    `ScenarioDocument`.
    """

    model_config = ConfigDict(extra="allow", frozen=True)

    scenario: Path | None = None
    ideal: bool = False
    _document: ScenarioDocument | None = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _inline_is_a_scenario(self) -> Self:
        inline = dict(self.model_extra or {})
        if self.scenario is not None:
            if inline:
                raise ValueError(f"key {sorted(inline)[0]!r} belongs in the scenario file {self.scenario}")
            return self
        self._document = _validate_document({**inline, "ideal": self.ideal})
        return self

    def world(self, base: Path) -> World:
        """Return the world that the settings describe. Relative paths in the settings are relative to the directory
        `base`.
        """
        if self._document is not None:
            return World(build_scenario(self._document, base))
        scenario = read_scenario(base / (self.scenario or Path()))
        if self.ideal and not scenario.settings.ideal:
            scenario = scenario.without_errors()
        return World(scenario)


def _validate_document(inline: dict[str, Any]) -> ScenarioDocument:
    """Validate the inline scenario; ValueError gives the key path and message of its first error."""
    try:
        return ScenarioDocument.model_validate(inline)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ValueError(f"{key}: {first['msg']}") from None


def create(settings: SimulatedSettings, context: DeviceContext) -> SimulatedMachineDevice:
    return SimulatedMachineDevice(settings.world(context.base_path), context.clock)


PLUGIN = DriverPlugin("simulated", SimulatedSettings, create, several_mounts=True)
