"""Choice of a night's positions. They are chosen to reduce the predicted uncertainty, or to detect sudden changes of
machine errors (jumps) and to find the errors that changed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice

import numpy as np

from agent.files import translated
from agent.planning.design.feasibility import FeasibilityCheck
from agent.planning.held_out_positions import held_out_grid
from agent.planning.job import Job
from drivers.errors import ConfigurationError
from twin.arrays import Array
from twin.artefact.position_set import MIN_BALLS, Position
from twin.design.candidates import build_candidates, orientation_grid
from twin.design.search import ExchangeSearch, Selection
from twin.identification import CarriedOverPrior, Options
from twin.identification.jump import SuspectedJump
from twin.machine.volumetric import evaluation_grid
from twin.monitoring.discriminating_positions import JumpQuestions, rank_discriminating_positions
from twin.monitoring.step_power import StepPower, rank_by_power


@dataclass(frozen=True, eq=False)
class PositionChooser:
    """Choice of the positions of a night at one `station`, where the artefact stands during the whole night."""

    job: Job
    station: int
    _searches: dict[tuple[CarriedOverPrior, tuple[Position, ...]], tuple[ExchangeSearch, list[int]]] = field(
        default_factory=dict, init=False, repr=False
    )

    @cached_property
    def feasibility(self) -> FeasibilityCheck:
        return FeasibilityCheck(self.job)

    def minutes(self, positions: Sequence[Position]) -> float:
        return sum(self.feasibility.minutes(position) for position in positions)

    def held_out(self, prior: CarriedOverPrior, change: Array, count: int) -> tuple[Position, ...]:
        """Return the `count` held-out positions at this station whose balls show best what a new table would change.
        The result is shorter than `count` if there are not enough.

        `change` (p, p) contains the expected squares and products of the change of the p model parameters since the
        active table was computed, in the units of `prior`. The orientations are those that the setting
        `verification.positions_deg` lists, or else those on the grid `verification.grid_deg` that are not in the
        position set.
        """
        offered = self._held_out_offered()
        search, _ = self._search(prior, offered)
        candidates = search.candidates
        seen = candidates.factors[:, :, prior.unknowns.blocks.parameters]
        # tr(W M Wᵀ): expected square of the change of the balls, less the poses, in units of the touch noise
        shown = np.einsum("nrp,nrp->n", seen @ change, seen)
        best = (int(index) for index in np.argsort(-shown, kind="stable"))
        return tuple(islice((candidates.positions[index] for index in best if search.is_measurable(index)), count))

    def _held_out_offered(self) -> list[Position]:
        settings = self.job.settings
        listed = settings.verification.positions_deg
        if listed is not None:
            candidates = [Position(self.station, azimuth, elevation) for azimuth, elevation in listed]
            return [position for position in candidates if self._usable(position)]
        grid = [Position(self.station, azimuth, elevation) for azimuth, elevation in held_out_grid(settings)]
        used = set(self.job.positions)
        return [position for position in grid if position not in used]

    def by_gain(
        self,
        prior: CarriedOverPrior,
        *,
        most: int,
        minutes: float = np.inf,
        measured: Sequence[Position] = (),
        left_out: Sequence[Position] = (),
    ) -> Iterator[Position]:
        """Yield at most `most` positions in descending order of gain per minute of machine time, as long as they fit
        into `minutes`.

        The gain is the reduction of the predicted uncertainty that remains after `prior` and the positions `measured`.
        Positions in `left_out` are never chosen.
        """
        offered = [position for position in self._offered() if position not in left_out]
        search, places = self._search(prior, [*measured, *offered])
        first = Selection.of(search.candidates, places[: len(measured)])
        paid = search.costs.total(first.chosen)

        def room(chosen: Sequence[int]) -> np.ndarray:
            fits = search.costs.total(chosen) - paid + search.costs.marginal(chosen) <= minutes
            return np.asarray(fits & (len(chosen) - len(first.chosen) < most))

        for selection in search.grow(first, room, per_minute=True):
            yield search.candidates.positions[selection.chosen[-1]]

    def detecting_jumps(
        self, prior: CarriedOverPrior, count: int, measured: Sequence[Position]
    ) -> tuple[Position, ...]:
        """Return `count` positions that, together with the positions `measured`, best detect a sudden change (jump) of
        any machine error."""
        ranked = self._ranked(prior, JumpQuestions.any_jump(prior.unknowns), measured)
        return tuple(islice(ranked, count))

    def step_power(self, prior: CarriedOverPrior, positions: Sequence[Position]) -> StepPower:
        """Return the power of a measurement of `positions` to find a sudden change (step) of a machine error, if the
        touches scatter as in the last accepted night."""
        offered = self._offered()
        # The sets of a verification are asked for one after the other, out of the same positions: one search has all.
        search, _ = self._search(prior, offered if set(positions) <= set(offered) else positions)
        index_of = {position: index for index, position in enumerate(search.candidates.positions)}
        places = [index_of[position] for position in positions if position in index_of]
        return StepPower.of(prior.unknowns, search.candidates.factors[places] / prior.scales.noise, prior.covariance)

    def finding_steps(self, prior: CarriedOverPrior, steps: Mapping[str, float]) -> tuple[Position, ...]:
        """Return the positions at this station that find the given steps fastest, in the order of their choice.

        `steps` gives the size of a step in µm or µrad by the name of its error. Positions that contribute nothing are
        left out.
        """
        search, _ = self._search(prior, self._offered())
        candidates = search.candidates
        usable = [index for index in range(candidates.count) if search.is_measurable(index)]
        minutes = search.costs.minutes[usable]
        factors = candidates.factors[usable] / prior.scales.noise
        ranked = rank_by_power(prior.unknowns, factors, prior.covariance, steps, minutes)
        return tuple(candidates.positions[usable[number]] for number in ranked)

    def discriminating(
        self,
        prior: CarriedOverPrior,
        suspects: Sequence[SuspectedJump],
        *,
        minutes: float,
        measured: Sequence[Position],
    ) -> tuple[Position, ...]:
        """Return the positions that best distinguish which of the machine errors `suspects` has jumped.

        As many positions are returned as fit into `minutes` of machine time. Positions in `measured` are not returned
        again.
        """
        names, scale = prior.unknowns.model.names, prior.unknowns.scale
        jumps = np.zeros((len(suspects), prior.unknowns.blocks.size))
        for row, suspect in zip(jumps, suspects, strict=True):
            for name, value in suspect.coefficients.items():
                row[names.index(name)] = value / scale[names.index(name)]
        chosen: list[Position] = []
        for position in self._ranked(prior, JumpQuestions.which_jump(jumps), measured):
            if self.minutes([*chosen, position]) > minutes:
                break
            chosen.append(position)
        return tuple(chosen)

    def _ranked(
        self, prior: CarriedOverPrior, questions: JumpQuestions, measured: Sequence[Position]
    ) -> Iterator[Position]:
        search, places = self._search(prior, [*measured, *self._offered()])
        candidates, done = search.candidates, places[: len(measured)]
        allowed = np.ones(candidates.count, dtype=bool)
        allowed[done] = False
        for index in rank_discriminating_positions(candidates, done, questions, allowed, search.costs.minutes):
            if search.is_measurable(index):
                yield candidates.positions[index]

    def _search(self, prior: CarriedOverPrior, positions: Sequence[Position]) -> tuple[ExchangeSearch, list[int]]:
        """Return the search over those `positions` that can be candidates, and the indices of these candidates."""
        asked = prior, tuple(positions)
        if asked not in self._searches:
            self._searches[asked] = self._new_search(prior, positions)
        return self._searches[asked]

    def _new_search(self, prior: CarriedOverPrior, positions: Sequence[Position]) -> tuple[ExchangeSearch, list[int]]:
        job = self.job
        machine = job.machine.with_model(prior.unknowns.model)
        options = Options(carried_over=prior, estimate_scales=False, outliers="none")
        grid = evaluation_grid(machine.model.ranges_mm)
        with translated(ConfigurationError, key="stations.places_mm"):
            candidates = build_candidates(job.procedure, positions, machine.family, options, grid, job.tool_offset_mm)
        index_of = {position: index for index, position in enumerate(candidates.positions)}
        search = self.feasibility.search_among(candidates, standing_at=self.station)
        return search, [index_of[position] for position in positions if position in index_of]

    def _offered(self) -> list[Position]:
        grid = orientation_grid(self.job.settings.nightly.grid_deg)
        return [Position(self.station, azimuth, elevation) for azimuth, elevation in grid]

    def _usable(self, position: Position) -> bool:
        layout = self.job.layout
        reached = int(layout.reachable(position, layout.nominal(position)).sum())
        return reached >= MIN_BALLS and not self.feasibility.hit(position)
