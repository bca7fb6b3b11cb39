"""Result of a finite element program at one node in one load step, as the program wrote it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from twin.errors import FormatError

Components = tuple[float, float, float]


@dataclass(frozen=True)
class NodalResult:
    """Displacement in the unit and in the frame of the model, and the rotation vector in rad if there is one.

    `row` is the line of the file from which it was read.
    """

    load_step: int
    node: int
    displacement: Components
    rotation: Components | None
    row: int


@dataclass(frozen=True)
class StepResults:
    """Nodal results of one file called `source`, by load step and node."""

    source: str
    by_step: dict[int, dict[int, NodalResult]]

    @classmethod
    def collected(cls, results: Iterable[NodalResult], source: str) -> StepResults:
        """Return the results by load step and node. Raises FormatError if a node has two results in one load step."""
        by_step: dict[int, dict[int, NodalResult]] = {}
        for result in results:
            nodes = by_step.setdefault(result.load_step, {})
            if result.node in nodes:
                message = f"node {result.node} has a second result in load step {result.load_step}, after row "
                raise FormatError(message + str(nodes[result.node].row), file=source, row=result.row)
            nodes[result.node] = result
        return cls(source, by_step)

    def at(self, load_step: int, node: int | None) -> NodalResult:
        """Return the result of a load step at a node. `node` may be None if the load step has one node.

        Raises FormatError if there is no such result, or if a node has to be chosen.
        """
        nodes = self.by_step.get(load_step)
        if nodes is None:
            known = ", ".join(map(str, sorted(self.by_step)[:10]))
            raise FormatError(
                f"load step {load_step} is not in the file", hint=f"It contains load steps: {known}", file=self.source
            )
        if node is None:
            if len(nodes) > 1:
                message = f"load step {load_step} lists {len(nodes)} nodes; that of the tool point is not stated"
                raise FormatError(message, hint="State it with --node, or in a column 'node'", file=self.source)
            return next(iter(nodes.values()))
        if node not in nodes:
            raise FormatError(f"node {node} is not listed in load step {load_step}", file=self.source)
        return nodes[node]
