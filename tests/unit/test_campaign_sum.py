"""The sum of parts of a campaign: the results that the campaigns themselves make, and numbers added by hand."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from campaigns import sum as campaign_sum
from campaigns.crash_points import __main__ as crash_points
from campaigns.crash_points.process_kills import ProcessKill, ProcessKills
from campaigns.endurance import __main__ as endurance
from campaigns.faults import __main__ as faults
from campaigns.faults.night_record import NightRecord
from campaigns.fuzz import __main__ as fuzz
from campaigns.fuzz.trial import TrialResult
from campaigns.plans import __main__ as plans
from campaigns.plans.collision_check import JudgeResult
from campaigns.plans.collision_check_trial import JudgeComparison
from campaigns.plans.trial import PlanTrial
from campaigns.requests import __main__ as requests
from campaigns.requests.trial import REQUESTS, Count
from campaigns.sum_rules import NotSummableError

Result = dict[str, Any]

NIGHT = NightRecord(
    seed=1,
    night=0,
    group="wire",
    kind="lost link",
    at_s=100.0,
    former=1,
    active=1,
    morning=1,
    state="faulted",
    journal_state="faulted",
    reason="connection reset (link 127.0.0.1:502, step measure/1)",
    reasons=("connection reset",),
    step="measure/1",
    place="127.0.0.1:502",
)
NIGHTS = [
    NIGHT,
    replace(NIGHT, kind="door", group="controller"),
    replace(NIGHT, kind="door", later=replace(NIGHT, state="complete", journal_state="complete", resumed=2)),
    replace(NIGHT, reason=""),
]
PLANS = [
    PlanTrial(1, "-Z", branch="restored", commands=10, machine_minutes=60.0, seen=JudgeResult(5, 3.25)),
    PlanTrial(2, refused="PlanRefused: no path to ball #"),
    PlanTrial(3, "-Y", branch="accepted", commands=7, machine_minutes=30.0, seen=JudgeResult(5, 1.5, ["ram"])),
    PlanTrial(4, "-Z", stopped="LinkError: lost", failures=["run: left moving"], interruption="abort"),
]
COMPARED = [JudgeComparison(20, 3), JudgeComparison(), JudgeComparison(20, 1, ("seed 3 move 2",)), JudgeComparison(9)]
FOUND = [
    TrialResult("token", 3, 4, ["input 2: KeyError"], 0.1, 0.02, "input 3", 40 * 1024),
    TrialResult("bank", 1, 14, [], 0.2, 0.01, "input 1", -4 * 1024),
]
KILLS = [ProcessKill("service", "commit: before", "calibrate"), ProcessKill("machine", "arm: after", "restore")]


def of_fuzz(part: slice) -> Result:
    """Each decoder in each part: together, it had the inputs of all parts."""
    inputs = [5, 7, 11, 2][part]
    found = [
        TrialResult(one.name, one.read * sum(inputs), one.refused * sum(inputs), slowest_s=0.01 * max(inputs))
        for one in FOUND
    ]
    return fuzz.summarise([(one, []) for one in found]) | {"seed": part.start or 0}


def of_requests(part: slice) -> Result:
    actions = ["start", "hold", "kill", "start"][part]
    count = Counter(actions)
    total = Count(count, Counter(name for name in actions if name in REQUESTS), count, count, count, ["moved"])
    total.violations = [f"violation of {name}" for name in actions]
    return requests.summarise(total) | {"trials": len(actions), "seed": 1, "first": part.start or 0, "cpu_s": 0.0}


def of_faults(part: slice) -> Result:
    nights = NIGHTS[part]
    identity = {"seed": 1, "first": part.start or 0, "machines_refused": 2 * len(nights), "cpu_s": 0.5 * len(nights)}
    return faults.summarise(nights) | identity


def of_plans(part: slice) -> Result:
    judged = plans.judged(PLANS[part], JudgeComparison.sum(COMPARED[part]))
    return judged | {"seed": 1, "first": part.start or 0, "plans_per_second": 1.5}


def of_crash_points(part: slice) -> Result:
    records = [("commit", night) for night in NIGHTS[part]]
    return crash_points.summarise(Counter({"in a motion": 60}), records) | {"seed": part.start or 0, "cpu_s": 0.5}


def of_killed_processes(part: slice) -> Result:
    kills = [KILLS[0], replace(KILLS[1], wrong={"no collision": "ram"}), KILLS[1], KILLS[0]][part]
    found = ProcessKills(kills, len(kills), 2 * len(kills), 0, 3 * len(kills))
    return crash_points.summarise_processes(found) | {"seed": part.start or 0}


WHOLE = slice(None)
CAMPAIGNS: dict[str, Callable[[slice], Result]] = {
    "fuzz": of_fuzz,
    "requests": of_requests,
    "faults": of_faults,
    "plans": of_plans,
    "crash_points": of_crash_points,
    "crash_points --kind processes": of_killed_processes,
}
OF_THE_PART = {"seed", "first", "parts", "cpu_s", "plans_per_second"}
"""Keys of what distinguishes a part from the whole."""


@pytest.mark.parametrize("name", CAMPAIGNS)
@pytest.mark.parametrize("at", [1, 2, 3])
def test_the_sum_of_two_parts_is_the_result_of_the_whole(name: str, at: int) -> None:
    parts, whole = [slice(0, at), slice(at, 4)], CAMPAIGNS[name](WHOLE)
    results = [{**CAMPAIGNS[name](part), "wall_seconds": 1.25} for part in parts]
    total = campaign_sum.summed(results)
    assert campaign_sum.form_of(results[0]).name == name
    assert (total["parts"], total["wall_seconds"], total["seed"]) == (2, 2.5, [one["seed"] for one in results])
    assert "plans_per_second" not in total
    assert {key: value for key, value in total.items() if key not in {*OF_THE_PART, "wall_seconds"}} == {
        key: value for key, value in whole.items() if key not in OF_THE_PART
    }


ROWS = [
    {
        "run": number + 1,
        "kind": "verify" if number % 3 else "calibrate",
        "state": "complete",
        "memory_mb": 200.0 + 0.01 * number,
        "handles": 14 - number % 2,
        "threads": 9,
        "cpu_s": 2.0 * number,
        "disk_mb": 0.5 * number,
    }
    for number in range(24)
]


def test_the_figures_of_an_endurance_trial_are_those_of_its_worst_part() -> None:
    worse = [{**row, "memory_mb": row["memory_mb"] * 3, "cpu_s": row["cpu_s"] * 2} for row in ROWS[:12]]
    parts = [endurance.verdict(ROWS, 18, [], 0, 0), endurance.verdict(worse, 8, ["r"], -9, 2)]
    total = campaign_sum.summed([{**part, "wall_seconds": 1.5} for part in parts])
    assert [part["passed"] for part in (*parts, total)] == [True, False, False]
    assert (total["runs"], total["compacted"], total["lost"], total["collisions"]) == (36, 26, ["r"], 2)
    assert (total["exit_code"], total["ended_well"], total["handles"]) == (-9, True, [14, 14])
    assert total["memory_mb"] == [600.0, 600.2, 600.3]
    assert total["memory_growth_mb_per_run"] == 0.03
    assert total["cpu_s_per_run"] == {"calibrate": [2.0, 4.0], "verify": [4.0, 4.0]}
    assert total["disk_mb_per_run"] == {"calibrate": [0.5, 0.5], "verify": [0.5, 0.5]}


def test_a_clearance_is_the_smallest_and_counts_only_where_one_was_measured() -> None:
    parts = [of_plans(slice(at, at + 1)) | {"wall_seconds": 1.0} for at in range(4)]
    assert [part["smallest_clearance_mm"] for part in parts] == [3.25, None, 1.5, None]
    assert campaign_sum.summed(parts)["smallest_clearance_mm"] == 1.5
    assert campaign_sum.summed([parts[1], parts[3]])["smallest_clearance_mm"] is None
    assert campaign_sum.summed([parts[0], parts[1]])["smallest_clearance_mm"] == 3.25


def night_part(seed: int, first: int, nights: int) -> Result:
    return {**faults.summarise([NIGHT] * nights), "seed": seed, "first": first, **CPU, "machines_refused": 0}


CPU = {"cpu_s": 1.0, "wall_seconds": 1.0}


@pytest.mark.parametrize(
    ("extents", "common"),
    [
        ([(1, 0, 100), (1, 50, 100)], "seed 1 in common, from number 50"),
        ([(1, 150, 50), (1, 0, 200)], "seed 1 in common, from number 150"),
        ([(1, 0, 50), (2, 0, 50), (1, 49, 1)], "seed 1 in common, from number 49"),
        ([(1, 0, 50), (1, 50, 39), (1, 100, 50), (2, 0, 150)], ""),
    ],
)
def test_parts_that_overlap_are_refused(extents: Sequence[tuple[int, int, int]], common: str) -> None:
    parts = [night_part(*extent) for extent in extents]
    if common:
        with pytest.raises(NotSummableError, match=common):
            campaign_sum.summed(parts)
    else:
        assert campaign_sum.summed(parts)["nights"] == sum(count for _, _, count in extents)


FUZZ: Result = {
    "passed": True,
    "inputs": 30,
    "decoders": {
        "token": {"read": 10, "refused": 5, "cpu_s": 0.1, "slowest_cpu_s": 0.02, "grown_kib": 12, "failures": []},
        "bank": {"read": 1, "refused": 14, "cpu_s": 0.2, "slowest_cpu_s": 0.01, "grown_kib": -4, "failures": []},
    },
    "seed": 1,
    "wall_seconds": 2.5,
}
OTHER_FUZZ = {
    "passed": False,
    "inputs": 7,
    "decoders": {
        "token": {"read": 3, "refused": 4, "cpu_s": 0.2, "slowest_cpu_s": 0.01, "grown_kib": 40, "failures": ["x"]}
    },
    "seed": 2,
    "wall_seconds": 0.5,
}
POWER_CUTS = {"passed": True, "calls": 9, "synced": 3, "acknowledged": 2, "cuts": {"all": 1}, "lost": 0, "listed": []}
HTTP = {"passed": True, "operations": 4, "requests": 9, "answers": {"200": 9}, "failures": 0, "listed": []}
WARMING = {"passed": True, "rise_within": True, "seeds": 4, "rise": 1.1, "rms_warm_um": 2.0, "worst_seed": 3}
GUIDED = {"passed": True, "inputs": 9, "decoders": {"token": {"inputs": 9, "branches": 7, "failure": ""}}}


def write(folder: Path, *results: Result) -> list[str]:
    paths = [folder / f"part-{number}" for number in range(len(results))]
    for path, result in zip(paths, results, strict=True):
        path.write_text(f"token  10 read\n{json.dumps(result)}\n", encoding="utf-8")
    return list(map(str, paths))


def test_numbers_are_added_and_maxima_stay_maxima(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert campaign_sum.main(write(tmp_path, FUZZ, OTHER_FUZZ)) == 1
    assert json.loads(capsys.readouterr().out) == {
        "passed": False,
        "inputs": 37,
        "decoders": {
            "token": {
                "read": 13,
                "refused": 9,
                "cpu_s": 0.3,
                "slowest_cpu_s": 0.02,
                "grown_kib": 40,
                "failures": ["x"],
            },
            "bank": FUZZ["decoders"]["bank"],
        },
        "seed": [1, 2],
        "wall_seconds": 3.0,
        "parts": 2,
    }


def test_a_sum_of_parts_that_passed_has_passed(tmp_path: Path) -> None:
    assert campaign_sum.main(write(tmp_path, FUZZ, {**FUZZ, "seed": 3}, {**FUZZ, "seed": 2})) == 0


@pytest.mark.parametrize(("missed", "common", "passed"), [(["reset"], [], True), (["hold", "reset"], ["hold"], False)])
def test_what_one_part_has_accepted_was_accepted(missed: list[str], common: list[str], passed: bool) -> None:
    count = Count(Counter({"start": 9}), Counter(REQUESTS))
    part = requests.summarise(count) | {"trials": 1, "seed": 1, "first": 0, **CPU}
    parts = [{**part, "never_accepted": ["hold"]}, {**part, "first": 1, "never_accepted": missed}]
    total = campaign_sum.summed(parts)
    assert (total["never_accepted"], total["passed"]) == (common, passed)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "the last line is not the result"),
        ("token  10 read\n", "the last line is not the result"),
        (json.dumps({"inputs": 3}), "the last line is not the result"),
        (json.dumps({"passed": "yes"}), "the last line is not the result"),
        (json.dumps(night_part(1, 0, 1)), "different campaigns"),
        (json.dumps(FUZZ), "the same part"),
        (json.dumps({**FUZZ, "inputs": 31}), "both have the seed 1"),
        (json.dumps({**FUZZ, "seed": 2, "per_second": 1.5}), "per_second is more or less"),
        (json.dumps({**FUZZ, "seed": [2, 3], "parts": 2}), "a sum already"),
        (json.dumps({**FUZZ, "seed": 2, "inputs": "many"}), "'inputs' is 'many'"),
        (json.dumps({**FUZZ, "seed": 2, "decoders": {"token": {"read": 1}}}), "'decoders.token' has other keys"),
        (json.dumps({**FUZZ, "seed": 2, "decoders": [1]}), "'decoders' is [1], which has no sum"),
        *((json.dumps(one), "can be summed (fuzz, requests,") for one in (POWER_CUTS, HTTP, WARMING, GUIDED)),
    ],
)
def test_a_file_that_cannot_be_summed_is_refused_in_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, told: str
) -> None:
    other = tmp_path / "other"
    other.write_text(text, encoding="utf-8")
    with pytest.raises(SystemExit):
        campaign_sum.main([*write(tmp_path, FUZZ), str(other)])
    assert told in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("wrong", [("--count", "120"), ("--count", "0"), ("--first", "20"), ("--first", "-50")])
def test_nights_are_played_in_parts_of_whole_machines(
    wrong: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        faults.main(wrong)
    assert "must be a multiple of 50" in capsys.readouterr().err
