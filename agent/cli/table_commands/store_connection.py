"""Connection to the devices named in the settings, for the duration of one command."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from agent.execution.device_assembly import assemble, closing_clock, make_clock
from agent.execution.rig import Rig
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.settings.load import load_settings, naming


@contextmanager
def connected(config: Path) -> Iterator[tuple[Job, Rig]]:
    """Open the devices named in the settings file `config` for the duration of the `with` block.

    Yield the job, and the rig, which holds the open devices.
    """
    settings = load_settings(config)
    base = config.resolve().parent
    with naming(config):
        job = prepare_job(settings, base)
    with closing_clock(make_clock(settings.clock)) as clock:
        rig = assemble(settings, clock, base)
        rig.open()
        try:
            yield job, rig
        finally:
            rig.close()
