"""`volcal linuxcnc install` and `remove`: exactly its own lines, and every other byte as it was."""

from __future__ import annotations

import tomllib
from importlib import import_module
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import InputError
from drivers.linuxcnc.installation.command import linuxcnc_group
from drivers.linuxcnc.installation.ini_file import BEGIN, END, IniFile

INI = """[EMC]
MACHINE = küche
[DISPLAY]
MAX_FEED_OVERRIDE = 1.2
[HAL]
# HALFILE = unused.hal
HALFILE = core.hal
HALFILE=motor.hal
HALUI = halui
[KINS]
KINEMATICS = trivkins
[AXIS_X]
MIN_LIMIT = 0
[AXIS_Y]
MIN_LIMIT = 0
[AXIS_Z]
MIN_LIMIT = 0
[JOINT_0]
TYPE = LINEAR
"""
SEVEN = {
    "HALFILE = volcal-eoffset.hal",
    "HALFILE = volcal-probe.hal",
    "[VOLCAL]",
    "DIRECTORY = tables",
    "OFFSET_AV_RATIO = 0.1",
}
PROBE = ("--probe-pin", "hm2_5i25.0.gpio.001.in")


class Machine:
    """Configuration of a machine in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.ini = folder / "machine.ini"
        self.ini.write_text(INI, encoding="utf-8")
        self.hal("core.hal", "loadrt motmod\n")
        self.hal("motor.hal", "net x-motor joint.0.motor-pos-cmd => joint.0.motor-pos-fb\n")

    def hal(self, name: str, text: str) -> None:
        (self.folder / name).write_text(text, encoding="utf-8")

    def run(self, *words: str) -> Result:
        return CliRunner().invoke(linuxcnc_group, [words[0], str(self.ini), *words[1:]])

    def install(self, *words: str) -> str:
        done = self.run("install", "--directory", "tables", *words)
        assert done.exit_code == 0, done.exception
        return done.output

    def refused(self, *words: str) -> InputError:
        """Return the error of a command that changes nothing."""
        before = self.files()
        done = self.run(*words)
        assert isinstance(done.exception, InputError), done.output
        assert self.files() == before
        return done.exception

    def files(self) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in self.folder.iterdir() if path.is_file()}


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_exactly_the_lines_that_volcal_needs_are_added(machine: Machine) -> None:
    machine.install(*PROBE)
    before, after = INI.splitlines(), machine.ini.read_text(encoding="utf-8").splitlines()
    added = [line for line in after if line not in before]
    marks = {BEGIN.decode(), END.decode()}
    assert set(added) - marks == SEVEN
    assert len(added) - sum(line in marks for line in added) == 7
    assert [line for line in after if line in before] == before
    assert after.index("HALFILE=motor.hal") < after.index("HALFILE = volcal-eoffset.hal") < after.index("HALUI = halui")
    probe = (machine.folder / "volcal-probe.hal").read_text(encoding="utf-8")
    assert "net volcal-probe hm2_5i25.0.gpio.001.in => motion.probe-input" in probe
    assert (machine.folder / "tables").is_dir()
    assert (machine.folder / "machine.ini.volcal-backup").read_text(encoding="utf-8") == INI


def test_a_second_installation_changes_nothing(machine: Machine) -> None:
    machine.install(*PROBE)
    before = machine.files()
    assert "installed already" in machine.install(*PROBE)
    assert machine.files() == before


def test_only_what_is_missing_is_added(machine: Machine) -> None:
    machine.install()
    machine.install(*PROBE)
    text = machine.ini.read_text(encoding="utf-8")
    assert text.count("volcal-eoffset.hal") == text.count("volcal-probe.hal") == text.count("[VOLCAL]") == 1
    assert machine.run("remove").exit_code == 0
    assert machine.ini.read_text(encoding="utf-8") == INI


def test_a_dry_run_shows_the_changes_and_writes_nothing(machine: Machine) -> None:
    before = machine.files()
    output = machine.install("--dry-run", *PROBE)
    assert "+HALFILE = volcal-eoffset.hal" in output
    assert "nothing was written" in output
    assert machine.files() == before
    assert not (machine.folder / "tables").exists()


def test_removal_restores_every_file(machine: Machine) -> None:
    before = machine.files()
    machine.install(*PROBE)
    assert machine.run("remove").exit_code == 0
    assert machine.files() == before
    assert "nothing to remove" in machine.run("remove").output


def test_changes_of_the_owner_outlive_the_removal(machine: Machine) -> None:
    machine.install()
    text = machine.ini.read_text(encoding="utf-8")
    text = text.replace("MIN_LIMIT = 0", "MIN_LIMIT = -5").replace("HALUI = halui", "HALFILE = new.hal\nHALUI = halui")
    machine.ini.write_text(f"{text}[JOINT_1]\n", encoding="utf-8")
    assert "is kept: the configuration was changed since" in machine.run("remove").output
    wanted = INI.replace("MIN_LIMIT = 0", "MIN_LIMIT = -5").replace("HALUI = halui", "HALFILE = new.hal\nHALUI = halui")
    assert machine.ini.read_text(encoding="utf-8") == f"{wanted}[JOINT_1]\n"


@pytest.mark.parametrize("content", [INI, INI.rstrip("\n"), f"{INI}\n\n# end"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "utf-8-sig"])
def test_line_ends_and_encodings_are_kept(machine: Machine, content: str, line_end: str, encoding: str) -> None:
    before = content.replace("\n", line_end).encode(encoding)
    machine.ini.write_bytes(before)
    machine.install()
    installed = machine.ini.read_bytes()
    if line_end == "\r\n":
        assert b"\n" not in installed.replace(b"\r\n", b"")
    assert machine.run("remove").exit_code == 0
    assert machine.ini.read_bytes() == before


LINE = st.sampled_from(["[A]", "[HAL]", "HALFILE = a", "# text", "", "[VOLCAL]", "K = v", "  [HAL]", "\tx = ü"])


@given(
    st.lists(LINE, min_size=1), st.booleans(), st.lists(st.integers(0, 50), max_size=4), st.sampled_from(["\n", "\r\n"])
)
def test_inserted_lines_can_be_taken_out_again(lines: list[str], open_end: bool, places: list[int], end: str) -> None:
    before = (end.join(lines) + ("" if open_end else end)).encode()
    content = before
    for place in places:
        ini = IniFile(Path("machine.ini"), content)
        ini.insert_after(place % max(1, len(content.splitlines())), "[NEW]", "KEY = 1")
        content = ini.content()
    assert IniFile(Path("machine.ini"), content).without_marked_lines() == before


def test_what_a_person_has_installed_is_kept(machine: Machine) -> None:
    text = INI.replace("[AXIS_X]", "[AXIS_X]\nOFFSET_AV_RATIO = 0.3")
    machine.ini.write_text(f"{text}[VOLCAL]\nDIRECTORY = tables\n", encoding="utf-8")
    machine.install()
    after = machine.ini.read_text(encoding="utf-8")
    assert after.count("OFFSET_AV_RATIO = 0.1") == 2
    assert after.count("[VOLCAL]") == after.count("DIRECTORY") == 1


def test_a_signal_of_the_machine_is_shared(machine: Machine) -> None:
    """HAL links a pin to one signal only; without this LinuxCNC would not start."""
    machine.hal("motor.hal", "net enable <= motion.motion-enabled\nnet enable => drive.on # motion.is-all-homed\n")
    assert "motion.motion-enabled is read from the signal enable" in machine.install()
    text = (machine.folder / "volcal-eoffset.hal").read_text(encoding="utf-8")
    assert "net enable => volcal-eoffset.machine-on\n" in text
    assert "net volcal-homed motion.is-all-homed => volcal-eoffset.homed" in text
    assert text.count("motion.motion-enabled") == 0


class TestRefusals:
    def test_no_such_file(self, machine: Machine) -> None:
        machine.ini.unlink()
        assert "no such file" in str(machine.refused("install"))

    def test_no_hal_section(self, machine: Machine) -> None:
        machine.ini.write_text(INI.replace("[HAL]", "[HALL]"), encoding="utf-8")
        assert "no section [HAL]" in str(machine.refused("install"))

    def test_sections_in_an_included_file(self, machine: Machine) -> None:
        machine.ini.write_text("#INCLUDE hal.inc\n" + INI.replace("[HAL]", "[HALL]"), encoding="utf-8")
        assert "#INCLUDE" in machine.refused("install").hint

    def test_a_missing_axis(self, machine: Machine) -> None:
        machine.ini.write_text(INI.replace("[AXIS_Y]", "[AXIS_W]"), encoding="utf-8")
        assert "needs the axes" in machine.refused("install").hint

    def test_no_halfile(self, machine: Machine) -> None:
        machine.ini.write_text(INI.replace("HALFILE", "HALCMD"), encoding="utf-8")
        assert "names no HALFILE" in str(machine.refused("install", "--directory", "tables"))

    def test_a_missing_halfile(self, machine: Machine) -> None:
        (machine.folder / "core.hal").unlink()
        assert "core.hal does not exist" in str(machine.refused("install"))

    def test_write_protection(self, machine: Machine) -> None:
        machine.ini.chmod(0o444)
        assert "write-protected" in str(machine.refused("install"))

    def test_utf_16(self, machine: Machine) -> None:
        machine.ini.write_bytes(INI.encode("utf-16"))
        assert "UTF-16" in str(machine.refused("install"))

    def test_another_probe(self, machine: Machine) -> None:
        machine.hal("motor.hal", "\nnet touch-plate parport.0.pin-10-in => motion.probe-input\n")
        error = machine.refused("install", *PROBE)
        assert "already connected to the signal touch-plate" in str(error)
        assert error.where["file"].endswith("motor.hal")
        assert error.where["line"] == "2"
        assert "the probe is the signal touch-plate" in machine.install()

    @pytest.mark.parametrize("pin", ["axis.z.eoffset-counts", "motion.feed-inhibit"])
    def test_an_input_in_use(self, machine: Machine, pin: str) -> None:
        machine.hal("motor.hal", f"linkps {pin} torch-height\n")
        assert "already linked to the signal torch-height" in str(machine.refused("install"))

    def test_the_other_method(self, machine: Machine) -> None:
        machine.ini.write_text(INI.replace("trivkins", "volcal_kins"), encoding="utf-8")
        assert "already compensates in its kinematics" in str(machine.refused("install"))

    def test_another_directory(self, machine: Machine) -> None:
        machine.install()
        assert "[VOLCAL]DIRECTORY is tables" in str(machine.refused("install", "--directory", "/elsewhere"))

    def test_a_hal_file_of_the_same_name(self, machine: Machine) -> None:
        machine.hal("volcal-eoffset.hal", "# mine\n")
        assert "exists with other content" in str(machine.refused("install", "--directory", "tables"))

    def test_no_share_of_the_speed(self, machine: Machine) -> None:
        machine.ini.write_text(INI.replace("[AXIS_X]", "[AXIS_X]\nOFFSET_AV_RATIO = 0"), encoding="utf-8")
        assert "OFFSET_AV_RATIO = 0" in str(machine.refused("install"))

    @pytest.mark.parametrize("mark", [BEGIN, END])
    def test_a_damaged_mark(self, machine: Machine, mark: bytes) -> None:
        machine.install()
        machine.ini.write_bytes(machine.ini.read_bytes().replace(mark + b"\n", b"", 1))
        for command in ("remove", "install"):
            assert "lost its partner" in str(machine.refused(command))


def test_the_command_is_declared_as_an_entry_point() -> None:
    project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
    for group, wanted in (("volcal.commands", linuxcnc_group), ("volcal.command_help", linuxcnc_group.help)):
        module, _, name = project[group]["linuxcnc"].partition(":")
        assert getattr(import_module(module), name) == wanted


@pytest.mark.parametrize("kinematics", ["scarakins coordinates=xyzcab", "5axiskins", "genhexkins", "userkins"])
def test_other_kinematics_than_three_slides_are_refused(kinematics: str, tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    machine.ini.write_text(INI.replace("KINEMATICS = trivkins", f"KINEMATICS = {kinematics}"), encoding="utf-8")
    error = machine.refused("install", "--directory", "tables")
    assert f"the kinematics {kinematics.split(maxsplit=1)[0]}" in str(error)
    assert "trivkins" in error.hint


def test_kinematics_that_a_hal_file_loads_are_refused_too(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    machine.hal("core.hal", "loadrt pumakins  # robot\nloadrt motmod\n")
    error = machine.refused("install", "--directory", "tables")
    assert "the kinematics pumakins" in str(error)
    assert error.where["file"].endswith("core.hal")
    assert error.where["line"] == "1"


@pytest.mark.parametrize(
    ("kinematics", "note"),
    [
        ("trivkins coordinates=XYZAB", "the axes A and B are not compensated"),
        ("trivkins coordinates=xyzc kinstype=BOTH", "the axis C is not compensated"),
        ("corexykins", "two motors move X and Y together"),
    ],
)
def test_what_is_compensated_on_a_machine_with_more_than_three_slides(
    kinematics: str, note: str, tmp_path: Path
) -> None:
    machine = Machine(tmp_path)
    machine.ini.write_text(INI.replace("KINEMATICS = trivkins", f"KINEMATICS = {kinematics}"), encoding="utf-8")
    assert note in machine.install()


def test_kinematics_that_are_not_named_are_noted(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    machine.ini.write_text(INI.replace("KINEMATICS = trivkins", ""), encoding="utf-8")
    assert "the kinematics are not named" in machine.install()


def test_three_slides_need_no_note_about_kinematics(tmp_path: Path) -> None:
    assert "compensated" not in Machine(tmp_path).install()
