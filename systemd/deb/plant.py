"""Machine for the package test: a simulator as a separate unit, and settings with which a run takes seconds."""

from __future__ import annotations

from container import Container, wait_for

STATE = "/var/lib/volcal"
SETTINGS = "/etc/volcal/volcal.toml"
SHIPPED = "/usr/share/volcal/config"
UNIT = "simulator.service"
SCENARIO = "/etc/simulated.toml"
UNIT_FILE = f"/etc/systemd/system/{UNIT}"
READY_WITHIN_S = 120.0
SIMULATOR = f"""[Unit]
Description=A simulated machine
[Service]
ExecStart=/usr/bin/volcal simulate --config {SCENARIO} --modbus 127.0.0.1:5020 \
    --can socketcand:127.0.0.1:29536 --control 127.0.0.1:5022 --clock lockstep --time 127.0.0.1:5021
DynamicUser=yes
"""
SHORT = {
    '"machines/': f'"{SHIPPED}/machines/',
    '"artefacts/': f'"{SHIPPED}/artefacts/',
    '"../runs"': f'"{STATE}"',
    'position_set = "S3"': 'position_set = "two.csv"\nstations = [1]',
    "[stations]": "[stations]\nstanding_at = 1",
    "[verification]\nstations = [1, 4]": (
        "[verification]\nstations = [1]\npositions_deg = [[20.0, 25.0]]\nlargest_share = 1.0\nlargest_chi2 = 1e3"
    ),
    "[gates]": "[gates]\nsmallest_freedom = 1\nlargest_remaining_share = 1.0\nlargest_chi2 = 1e3",
}
AT_ONCE = (
    "\n[identification]\norder = 4\n"
    "[nightly]\nslot_minutes = 30.0\ncheck_positions = 1\nmax_chi2 = 4.0\nmax_ve_growth = 20.0\nstep_evidence = 30.0\n"
    "[service]\nwarm_up_minutes = 0\n"
)


def start_simulator(machine: Container) -> None:
    """Start a machine with errors large enough that a small run is worth a table."""
    scenario = machine.read(f"{SHIPPED}/simulators/case-study.toml")
    scenario = scenario.replace("[truth]", "[truth]\nscale = 4.0").replace('"../', f'"{SHIPPED}/')
    machine.write(SCENARIO, scenario)
    machine.write(UNIT_FILE, SIMULATOR)
    machine.run("systemctl", "daemon-reload")
    machine.run("systemctl", "start", UNIT)
    wait_for(lambda: '"modbus"' in machine.journal(UNIT), "the simulator", READY_WITHIN_S)


def end_simulator(machine: Container) -> None:
    machine.run("systemctl", "stop", UNIT)
    machine.run("rm", UNIT_FILE, SCENARIO)


def write_settings(machine: Container, service: str) -> None:
    """Write the settings of the case study with two positions at one station and wide gates; append `service` to its
    section.
    """
    text = machine.read(f"{SHIPPED}/case-study.toml")
    for former, now in SHORT.items():
        assert former in text, former
        text = text.replace(former, now)
    machine.write("/etc/volcal/two.csv", "station,azimuth_deg,elevation_deg\n1,45,0\n1,0,45\n")
    machine.write(SETTINGS, text + AT_ONCE + service)
