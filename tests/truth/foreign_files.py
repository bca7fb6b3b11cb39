"""Files of a measurement on a foreign machine, as `volcal identify` reads them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from click.testing import CliRunner, Result

from agent.cli.offline_commands.identify import identify
from campaigns.foreign.artefact import ForeignBar
from campaigns.foreign.files import Row, artefact_text, ball_text, machine_text


@dataclass(frozen=True)
class Folder:
    """Folder with the files of a measurement; `run` writes the ball file and identifies.

    `low_mm` contains the lower ends of the axis ranges.
    """

    path: Path
    low_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def out(self) -> Path:
        return self.path / "out"

    def run(self, bar: ForeignBar, rows: list[Row], *options: str, report: bool = False) -> Result:
        (self.path / "machine.toml").write_text(machine_text(self.low_mm))
        (self.path / "bar.toml").write_text(artefact_text(bar))
        balls = self.path / "balls.csv"
        balls.write_text(ball_text(rows))
        files = ("--machine", self.path / "machine.toml", "--artefact", self.path / "bar.toml", "--out", self.out)
        drawn = () if report else ("--no-report",)
        arguments = [str(balls), *map(str, files), "--even-so", *drawn, *options]
        return CliRunner().invoke(identify, arguments, prog_name="volcal identify")
