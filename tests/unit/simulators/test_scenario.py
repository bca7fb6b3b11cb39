import pytest
from worlds import SHIPPED

from drivers.clock import VirtualClock
from drivers.errors import ConfigurationError
from drivers.registry import DeviceContext, create_device
from simulators.backend import SimulatedMachineDevice
from simulators.scenario import read_scenario

STATIONS = [[1000.0, 1000.0, 750.0]]
INLINE = {
    "machine": "../machines/case-study.toml",
    "artefact": "../artefacts/ball-bar-1500.toml",
    "stations_mm": STATIONS,
}


def create(options: dict[str, object]) -> SimulatedMachineDevice:
    made = create_device("simulated", options, DeviceContext("dry", VirtualClock(), SHIPPED.parent))
    assert isinstance(made, SimulatedMachineDevice)
    return made


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("shaft_mm", "shaft_length_mm", "shaft_length_mm"),
        ("seed = 21", "sead = 21", "sead"),
        ("reach_mm = 250.0 ", "reach_mm = 400.0 ", "probe"),
        ("standing_at = 1", "standing_at = 9", "standing_at"),
        ('tool = "probe"', 'tool = "disc"', "disc"),
        ("case-study.toml", "no-such.toml", "no-such.toml"),
    ],
)
def test_a_wrong_scenario_is_refused_with_its_key(tmp_path, old: str, new: str, told: str) -> None:
    text = SHIPPED.read_text(encoding="utf-8").replace('"../', f'"{SHIPPED.parent.parent}/')
    assert old in text
    path = tmp_path / "scenario.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ConfigurationError) as caught:
        read_scenario(path)
    assert told in str(caught.value)


def test_the_plugin_takes_a_file_or_the_keys_themselves() -> None:
    assert not create({"scenario": "case-study.toml"}).world.scenario.settings.ideal
    assert create({"scenario": "case-study.toml", "ideal": True}).world.truth.true_volumetric_error() == (0, 0)
    inline = create({**INLINE, "ideal": True, "start_mm": [2000.0, 0.0, 100.0]})
    assert inline.position().tolist() == [2000.0, 0.0, 100.0]


@pytest.mark.parametrize(
    "options",
    [
        {},
        {**INLINE, "stations": STATIONS},
        {"scenario": "case-study.toml", "stations_mm": STATIONS},
        {**INLINE, "start_mm": [9000.0, 0.0, 0.0]},
    ],
)
def test_plugin_settings_that_make_no_sense_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(ConfigurationError):
        create(options)
