"""Command `volcal study`, which carries out one simulation study of the calibration procedure, without a machine.

The result of the study is written to files as a figure and as numbers.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import PATH, case_options
from agent.studies import STUDIES

if will_run():
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

    from agent.cli.printing import facts_table, results_console
    from agent.files import check_folder, translated
    from agent.model_files import load_machine
    from agent.planning.case_file import load_case
    from agent.runs.kinds.calibrate import preflight_of
    from agent.settings.load import naming
    from agent.settings.schema import IdentificationSettings
    from agent.studies.identification_variants import PUBLISHED, PUBLISHED_STUDIES
    from agent.studies.study import Progress as StudyProgress
    from agent.studies.study import StudyCase, StudyResult, run_study
    from agent.studies.study_files import as_plain, document, write_result
    from agent.studies.true_effects import check_study, parse_effects
    from agent.studies.workers import LocalWorkers, Workers
    from drivers.clock import wall_seconds
    from drivers.errors import ConfigurationError
    from twin.identification import Options

if TYPE_CHECKING:
    from agent.studies.cluster import DaskWorkers


@dataclass(frozen=True)
class Chosen:
    """Options of the identification (the estimation of the machine's errors) that were given on the command line. An
    option that is None is taken from the settings.
    """

    formulation: Literal["centres", "distances", "published"] | None
    prior: Literal["on", "off"] | None
    weights: Literal["full", "unit"] | None

    def options(self, study: str, settings: IdentificationSettings) -> Options:
        """Return the identification options for the study called `study`, with the defaults of the settings.

        Raises ConfigurationError if the published method is chosen for a study that the publication does not contain,
        or with a different prior or different weights.
        """
        if self.formulation == "published":
            return self._published(study)
        return Options(
            formulation=self.formulation or settings.formulation,
            use_prior=settings.prior if self.prior is None else self.prior == "on",
            weights=self.weights or settings.weights,
        )

    def _published(self, study: str) -> Options:
        if study not in PUBLISHED_STUDIES:
            raise ConfigurationError(
                f"the publication has no study '{study}', so its method is not offered for it",
                hint=f"choose one of {', '.join(PUBLISHED_STUDIES)}, or --formulation distances",
                key="--formulation",
            )
        if self.prior == "on" or self.weights == "full":
            raise ConfigurationError(
                "the published method has unit weights and no prior",
                hint="omit --prior and --weights, or choose --formulation distances",
                key="--formulation",
            )
        return PUBLISHED


@click.command("study")
@click.argument("name", type=click.Choice(sorted(STUDIES)), metavar="NAME")
@case_options
@click.option("--machine", type=PATH, metavar="FILE", help="Machine file instead of the one in the settings.")
@click.option("--true-machine", type=PATH, metavar="FILE", help="Machine file from which the true machines are drawn.")
@click.option(
    "--with",
    "effects",
    multiple=True,
    metavar="EFFECT=SIZE",
    help="Effect that no identification knows, such as backlash=5um or heat=2K; can be repeated.",
)
@click.option("--artefact", type=PATH, metavar="FILE", help="Artefact file instead of the one in the settings.")
@click.option("--stations", type=click.IntRange(min=1), metavar="N", help="N stations, evenly spaced along their axis.")
@click.option("--set", "position_set", metavar="SET", help="S1, S2, S3, joined by +, or a position file.")
@click.option(
    "--formulation",
    type=click.Choice(["centres", "distances", "published"]),
    help="How the errors are estimated; `published`: the published studies' method, as read by volcal (studies only).",
)
@click.option("--prior", type=click.Choice(["on", "off"]))
@click.option("--weights", type=click.Choice(["full", "unit"]))
@click.option(
    "--machines", type=click.IntRange(min=1), default=500, show_default=True, help="Number of machines to draw."
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="The same seed gives the same numbers."
)
@click.option("--workers", type=click.IntRange(min=1), metavar="N", help="Number of processes [default: one per core].")
@click.option("--cluster", metavar="ADDRESS", help="Address (tcp://HOST:PORT) of a Dask scheduler with workers.")
@click.option("--out", type=PATH, default=Path("studies"), show_default=True, metavar="DIR")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout at the end.")
@reported
def study_command(
    *,
    name: str,
    config: Path,
    machine: Path | None,
    true_machine: Path | None,
    effects: tuple[str, ...],
    artefact: Path | None,
    stations: int | None,
    position_set: str | None,
    formulation: Literal["centres", "distances", "published"] | None,
    prior: Literal["on", "off"] | None,
    weights: Literal["full", "unit"] | None,
    machines: int,
    seed: int,
    workers: int | None,
    cluster: str | None,
    out: Path,
    as_json: bool,
) -> None:
    """Study the procedure without a machine and write NAME.png, NAME.svg, NAME.csv and NAME.json into DIR."""
    started = wall_seconds()
    check_folder(out)
    check_study(name, effects=bool(effects), true_machine=true_machine is not None)
    stated, truth = parse_effects(effects), None if true_machine is None else load_machine(true_machine)
    job = load_case(config, machine=machine, artefact=artefact, stations=stations)
    options = Chosen(formulation, prior, weights).options(name, job.settings.identification)
    with naming(config), hired(workers, cluster) as team, progress_bars() as progress, translated(ConfigurationError):
        case = StudyCase(
            job=job,
            options=options,
            seed=seed,
            machines=machines,
            workers=team,
            progress=progress,
            prove=preflight_of,
            position_set=position_set,
            effects=stated,
            true_machine=truth,
        )
        result = run_study(name, case)
    files = write_result(result, out)
    said = {**document(result), "wall_seconds": round(wall_seconds() - started, 3)}
    if as_json:
        click.echo(
            json.dumps({**said, "files": {suffix: str(path) for suffix, path in files.items()}}, allow_nan=False)
        )
    else:
        _show(result, files, case.heading)


@contextmanager
def hired(workers: int | None, cluster: str | None) -> Iterator[Workers]:
    """Yield the workers, the processes that compute a study, and stop them at the end of the `with` block.

    There are `workers` processes on this computer or, if `cluster` is given, processes on the Dask cluster with this
    address. Raises ConfigurationError if both `workers` and `cluster` are given.
    """
    if cluster is not None and workers is not None:
        raise ConfigurationError(
            "--workers counts processes on this computer, and --cluster has workers of its own",
            hint="give one of the two",
        )
    with LocalWorkers(workers) if cluster is None else _cluster(cluster) as team:
        yield team


def _cluster(address: str) -> DaskWorkers:
    try:
        module = import_module("agent.studies.cluster")
    except ModuleNotFoundError as missing:
        hint = "install it: pip install volcal[cluster]"
        raise ConfigurationError(f"a cluster needs the package '{missing.name}'", hint=hint, key="--cluster") from None
    workers: DaskWorkers = module.DaskWorkers(address)
    return workers


@contextmanager
def progress_bars() -> Iterator[StudyProgress]:
    """Yield a function that shows the progress of the tasks of a study.

    The function draws one progress bar per task on stderr. Its arguments are the name of the task, the number of parts
    done and the total number of parts.
    """
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=20),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    tasks: dict[str, TaskID] = {}
    with Progress(*columns, console=Console(stderr=True)) as bars:

        def show(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what)
            bars.update(tasks[what], completed=done, total=total)

        yield show


def _show(result: StudyResult, files: dict[str, Path], heading: str) -> None:
    console = results_console()
    console.print(heading, markup=False)
    console.print(facts_table(_lines(result.summary), title=result.title))
    for path in files.values():
        console.print(str(path), markup=False)


def _lines(summary: Mapping[str, object], under: str = "") -> Iterator[tuple[str, str]]:
    """Yield the name and the text of every single value, including the values in nested mappings. Lists are omitted,
    since the files contain them.
    """
    for key, value in summary.items():
        name = f"{under}{key}".replace("_", " ")
        plain = as_plain(value)
        if isinstance(plain, dict):
            yield from _lines(plain, f"{name}, ")
        elif isinstance(plain, float):
            yield name, f"{plain:.4g}"
        elif isinstance(plain, (str, int)):
            yield name, str(plain)
