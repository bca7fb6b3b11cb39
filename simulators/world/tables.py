"""Compensation tables in the controller: the banks with their tables, the limits of a table, and the active bank."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.errors import CommandRejected
from drivers.roles import Activation, StoreLimits, TableImage
from simulators.scenario import StoreSettings
from simulators.world.field import TableField


class TableBanks:
    """Numbered memory banks of the controller, each for one compensation table. Bank 0 means no compensation. The
    active bank cannot be written.
    """

    def __init__(self, settings: StoreSettings) -> None:
        self.limits = StoreLimits(
            banks=tuple(settings.banks),
            max_nodes=settings.max_nodes,
            max_total_nodes=settings.max_total_nodes,
            resolution_mm=settings.resolution_um * 1e-3,
            max_correction_mm=settings.max_correction_um * 1e-3,
            activation=Activation(settings.activation),
        )
        self._is_reversed = settings.signs == "reversed"
        self.images: dict[int, TableImage] = {}
        self.applied: dict[int, TableImage] = {}
        """Tables as the controller applies them, by bank."""
        self.active = 0
        self.field: TableField | None = None

    def write(self, bank: int, image: TableImage) -> None:
        """Store the compensation table `image` in the controller's bank number `bank`.

        Raises CommandRejected if the bank does not exist or is active, or if the table exceeds the limits of the
        controller.
        """
        if bank not in self.limits.banks:
            raise CommandRejected(f"there is no writable bank {bank}", hint=f"writable banks: {self.limits.banks}")
        if bank == self.active:
            raise CommandRejected(f"bank {bank} is active and cannot be written")
        self._refuse_misfit(image)
        self.images[bank] = image
        self.applied[bank] = replace(image, counts=-image.counts) if self._is_reversed else image

    def activate(self, bank: int) -> None:
        """Make `bank` the active bank, whose compensation table corrects the motion. Raises CommandRejected if the bank
        is empty.
        """
        if bank and bank not in self.images:
            raise CommandRejected(f"bank {bank} holds no table")
        self.active = bank
        self.field = TableField(self.applied[bank]) if bank else None

    def _refuse_misfit(self, image: TableImage) -> None:
        nodes = image.shape
        if any(count > most for count, most in zip(nodes, self.limits.max_nodes, strict=True)):
            raise CommandRejected(f"the table has {nodes} nodes, at most {self.limits.max_nodes} fit")
        # Three corrections at each node.
        if image.counts.size // 3 > self.limits.max_total_nodes:
            raise CommandRejected(f"the table has more than {self.limits.max_total_nodes} nodes")
        # Written as a negation, so that NaN is refused too.
        if not all(step > 0.0 for step in image.step_mm):
            raise CommandRejected(f"table steps must be positive, got {image.step_mm}")
        largest = float(np.abs(image.counts).max(initial=0)) * image.resolution_mm
        if largest > self.limits.max_correction_mm:
            raise CommandRejected(
                f"a correction of {largest:.4f} mm exceeds the limit of {self.limits.max_correction_mm} mm"
            )
