"""Display of the progress of a run on stderr.

The display prints one line for each state of the run and shows a bar with the remaining minutes.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn
from rich.text import Text

from agent.execution.run_state import Announcement, Listener
from agent.figures.numbers import significant
from agent.printable import printable


class _Watcher:
    def __init__(self, console: Console, bar: Progress) -> None:
        self._console = console
        self._bar = bar
        self._task: TaskID | None = None

    def __call__(self, announcement: Announcement) -> None:
        match announcement.kind:
            case "state":
                state = announcement.data["state"]
                text = announcement.text if announcement.text != state else ""
                self._console.print(Text.assemble((state, "bold"), f" {printable(text)}".rstrip()))
            case "note":
                self._console.print(Text(f"  {printable(announcement.text)}{_figures(announcement)}"))
            case "progress":
                self._advance(announcement)

    def _advance(self, announcement: Announcement) -> None:
        data = announcement.data
        if self._task is None:
            self._task = self._bar.add_task("measuring", total=1.0, left="", where="")
        minutes = data["minutes_left"]
        left = f"{data.get('simulated_steps', 0)} steps simulated" if minutes is None else f"{minutes:.0f} min left"
        where = announcement.text.removesuffix("/centre") or data.get("phase", "")
        self._bar.update(self._task, completed=data["fraction"], left=left, where=where)


@contextmanager
def watching(console: Console) -> Iterator[Listener]:
    """Yield a function that prints the states and the progress of a run on `console`. The run calls this function with
    each of its announcements.

    The progress bar is closed at the end of the `with` block.
    """
    columns = (
        BarColumn(bar_width=20),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[left]}"),
        TextColumn("{task.fields[where]}", style="dim", markup=False),
    )
    with Progress(*columns, console=console, transient=False) as bar:
        yield _Watcher(console, bar)


def _figures(announcement: Announcement) -> str:
    units = {"machine_minutes": "min of machine time", "commands": "steps", "wall_seconds": "s"}
    parts = [f"{significant(announcement.data[k], 4)} {unit}" for k, unit in units.items() if k in announcement.data]
    latencies = announcement.data.get("latencies")
    parts += [f"with the latencies {latencies}"] if latencies else []
    return f" ({', '.join(parts)})" if parts else ""
