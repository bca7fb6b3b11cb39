"""Tests of the options of driver plugins: a key that a driver does not know is refused."""

from __future__ import annotations

import pytest

from drivers.errors import ConfigurationError
from drivers.registry import check_options


@pytest.mark.parametrize(
    ("driver", "options", "key"),
    [
        ("modbus-cnc", {"host": "plc", "held_at_most_s": 1.0}, "held_at_most_s"),
        ("serial-cnc", {"port": "/dev/ttyUSB0", "repeats": 1}, "repeats"),
        ("linuxcnc", {"compensation": {"way": "comp-files"}}, "compensation.way"),
        ("canopen-mount", {"nodes": 1}, "nodes"),
        ("console-operator", {"watch_s": 1.0}, "watch_s"),
        ("simulated-operator", {"port": 1, "answer_within_s": 1.0}, "answer_within_s"),
    ],
)
def test_an_option_that_the_driver_does_not_know_is_refused(driver: str, options: dict[str, object], key: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        check_options(driver, options, "cnc")
    assert caught.value.where["key"] == f"devices.cnc.options.{key}"
    assert f"options of driver {driver}: " in caught.value.hint
