"""Proposed changes of a measuring set-up (tools, artefact and positions) and their benefit, in words."""

from __future__ import annotations

from twin.design.setup_trials import SetUpTrial, TrialGain
from twin.identification.observability import join_names
from twin.machine.kinematic_chain import AXES
from twin.units import UM_PER_MM

_MAX_NAMES = 6
_NEGLIGIBLE_UM = 0.005


def describe_trial(trial: SetUpTrial) -> str:
    """Return the change of the measuring set-up that a trial proposes, in words such as `the positions again with a
    stylus 100 mm aside along -Z`."""
    tool = trial.tool
    if tool is not None and tool.lateral:
        sign = "+" if tool.by_mm > 0.0 else "-"
        return f"the positions again with a stylus {abs(tool.by_mm):g} mm aside along {sign}{AXES[tool.axis]}"
    if tool is not None:
        return f"the positions again with a probe {tool.name}"
    return f"the positions of {trial.added} as well" if trial.added else "the same positions once more"


def describe_gain(gain: TrialGain) -> str:
    """Return the benefit of a trial in words such as `15 more parameters, EBY and EBZ no longer hidden; unseen 1.97 to
    1.50 µm; 24 positions more`.

    The values in µm before and after the trial are the rms, over the workspace and all evaluated tools, of the part of
    the error field that is missing from the estimate (unseen).
    """
    before, after = gain.before, gain.after
    parts = [_parameters(gain), f"unseen {_change(before.unseen_mm, after.unseen_mm)}"]
    if UM_PER_MM * before.blind_mm > _NEGLIGIBLE_UM:
        parts.append(f"blind {_change(before.blind_mm, after.blind_mm)}")
    return "; ".join((*parts, _positions(gain.positions)))


def _change(before_mm: float, after_mm: float) -> str:
    return f"{UM_PER_MM * before_mm:.2f} to {UM_PER_MM * after_mm:.2f} µm"


def _parameters(gain: TrialGain) -> str:
    if gain.rank == 0:
        return "no parameter more"
    count = "1 more parameter" if gain.rank == 1 else f"{gain.rank} more parameters"
    if not gain.revealed:
        return count
    names = join_names(gain.revealed) if len(gain.revealed) <= _MAX_NAMES else f"{len(gain.revealed)} errors"
    return f"{count}, {names} no longer hidden"


def _positions(count: int) -> str:
    return "1 position more" if count == 1 else f"{count} positions more"
