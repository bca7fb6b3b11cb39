"""Figures in the documents that come from runs: written anew from these runs, and compared with them by a test.

Each block stands between two comments in a page, which name it. `python -m campaigns.page_figures` runs the commands
and replaces the blocks.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from drivers.errors import VolcalError

ROOT = Path(__file__).resolve().parents[1]
TUTORIAL = ROOT / "docs" / "tutorials" / "first-calibration.md"
YOUR_MACHINE = ROOT / "docs" / "how-to" / "your-machine.md"
BLOCK = "<!-- made by `make figures`: {name} -->\n```\n{text}\n```\n<!-- end of {name} -->"
WALL_TIME = re.compile(r",\s+[\d.]+\s+s(?=[,)])")
RELATIVE, ABSOLUTE = 0.05, 0.021
"""Largest difference between a figure in a page and that of a run on any computer and with any version of numpy."""


def volcal(directory: Path, *arguments: str) -> str:
    """Return what `volcal ARGUMENTS` prints in `directory`, its progress first. Raises VolcalError if the command
    fails."""
    done = subprocess.run(  # noqa: S603  our own command
        [sys.executable, "-m", "agent.cli.main", *arguments],
        cwd=directory, capture_output=True, text=True, timeout=900.0, check=False, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    if done.returncode != 0:
        raise VolcalError(f"`volcal {' '.join(arguments)}` ended with {done.returncode}: {done.stderr.strip()[-500:]}")
    return f"{done.stderr}\n{done.stdout}"


def demo(directory: Path) -> str:
    """Return the preflight line and both tables of the demonstration."""
    text = volcal(directory, "demo", "--out", str(directory / "out"))
    preflight = WALL_TIME.sub("", " ".join(_after(text, "preflight passed").split("\nmeasuring")[0].split()))
    truth, run = _rows(_after(text, "true volumetric error").split("report:")[0], "position set")
    return "\n".join((preflight, "", *truth, "", *run))


def plan(directory: Path) -> str:
    """Return the rows of `volcal plan` for the case study that the tutorial explains."""
    text = volcal(directory, "plan", "--config", str(ROOT / "config" / "case-study.toml"))
    wanted = tuple(f"│ {name} " for name in ("positions", "touches", "machine time", "rank", "expected VCE"))
    rows = [[cell.strip() for cell in line.split("│")[1:3]] for line in text.splitlines() if line.startswith(wanted)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(f"│ {name.ljust(widths[0])} │ {value.ljust(widths[1])} │" for name, value in rows)


def init(directory: Path) -> str:
    """Return the facts that `volcal init` prints for the mill of the guide."""
    text = volcal(directory, "init", "mill-1", "--class", "mill", "--travel", "800", "500", "400", "--yes")
    return "\n".join(line for line in text.split("forecast of the gates")[0].splitlines() if line.startswith("│"))


FIGURES: Mapping[str, tuple[Path, Callable[[Path], str]]] = {
    "demo": (TUTORIAL, demo),
    "plan": (TUTORIAL, plan),
    "init": (YOUR_MACHINE, init),
}
"""Page and source of each block, by its name."""


def block_of(page: str, name: str) -> str:
    """Return the text of a block of a page. Raises VolcalError if the page has no such block."""
    begin, end = BLOCK.format(name=name, text="\0").split("\0")
    if begin not in page or end not in page.partition(begin)[2]:
        raise VolcalError(f"the page has no block {name!r}", hint=f"put it between {begin!r} and {end!r}")
    return page.partition(begin)[2].partition(end)[0]


def differences(stated: str, measured: str) -> list[str]:
    """Return the differences between two blocks: other words, and figures that differ by more than chance."""
    first, second = _words(stated), _words(measured)
    if len(first) != len(second):
        return [f"{len(first)} words instead of {len(second)}"]
    return [f"{a} instead of {b}" for a, b in zip(first, second, strict=True) if a != b and not _alike(a, b)]


def _alike(one: str, other: str) -> bool:
    try:
        first, second = float(one), float(other)
    except ValueError:
        return False
    return abs(first - second) <= max(ABSOLUTE, RELATIVE * abs(second))


def _words(text: str) -> Sequence[str]:
    return re.findall(r"-?\d+(?:\.\d+)?|[^\W\d]+|[^\w\s│]", text)


def _after(text: str, mark: str) -> str:
    return mark + text.partition(mark)[2]


def _rows(text: str, second: str) -> tuple[list[str], list[str]]:
    """Return the rows of two tables, of which the second begins with the row `second`."""
    rows = [line for line in text.splitlines() if line.startswith(("│", "┃"))]
    start = next(index for index, line in enumerate(rows) if line.startswith(f"│ {second} "))
    return rows[:start], rows[start:]


def main() -> None:
    """Write all blocks anew."""
    for name, (path, source) in FIGURES.items():
        with TemporaryDirectory() as directory:
            made = source(Path(directory))
        page = path.read_text(encoding="utf-8")
        former = BLOCK.format(name=name, text=block_of(page, name))
        path.write_text(page.replace(former, BLOCK.format(name=name, text=made)), encoding="utf-8")
        print(f"{path.relative_to(ROOT)}: {name}")


if __name__ == "__main__":
    main()
