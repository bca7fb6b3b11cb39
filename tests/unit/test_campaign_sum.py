"""The sum of parts of a campaign, against numbers added by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from campaigns import sum as campaign_sum

FUZZ = {
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
REQUESTS = {"passed": True, "steps": 9000, "seed": 1, "accepted": {"start": 3, "hold": 0}, "violated": []}


def write(folder: Path, *results: dict[str, Any]) -> list[str]:
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
            "bank": FUZZ["decoders"]["bank"],  # type: ignore[index]
        },
        "seed": [1, 2],
        "wall_seconds": 3.0,
        "parts": 2,
    }


def test_a_sum_of_parts_that_passed_has_passed(tmp_path: Path) -> None:
    assert campaign_sum.main(write(tmp_path, FUZZ, {**FUZZ, "seed": 3}, {**FUZZ, "seed": 2})) == 0


@pytest.mark.parametrize(("missed", "common", "passed"), [(["reset"], [], True), (["hold", "reset"], ["hold"], False)])
def test_what_one_part_has_accepted_was_accepted(missed: list[str], common: list[str], passed: bool) -> None:
    parts = [{**REQUESTS, "never_accepted": ["hold"]}, {**REQUESTS, "seed": 2, "never_accepted": missed}]
    total = campaign_sum.summed(parts)
    assert (total["never_accepted"], total["passed"]) == (common, passed)


def test_growth_of_the_parts_of_an_endurance_trial_is_that_of_the_worst() -> None:
    first = {"passed": True, "runs": 100, "handles": [14, 13], "cpu_s_per_run": {"verify": [2.0, 3.0]}}
    second = {"passed": True, "runs": 50, "handles": [12, 15], "cpu_s_per_run": {"verify": [2.5, 1.0]}}
    total = campaign_sum.summed([first, second])
    assert (total["runs"], total["handles"], total["cpu_s_per_run"]) == (150, [14, 15], {"verify": [2.5, 3.0]})


def test_crash_points_are_those_of_one_part_and_kills_are_added() -> None:
    part = {"passed": True, "points": 60, "points_by_kind": {"in a motion": 60}, "kills": 3, "seed": 1}
    total = campaign_sum.summed([part, {**part, "kills": 4, "seed": 2}])
    assert (total["points"], total["points_by_kind"], total["kills"]) == (60, {"in a motion": 60}, 7)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "the last line is not the result"),
        ("token  10 read\n", "the last line is not the result"),
        (json.dumps({"inputs": 3}), "the last line is not the result"),
        (json.dumps(REQUESTS), "different campaigns"),
        (json.dumps(FUZZ), "the same part"),
    ],
)
def test_a_file_that_cannot_be_summed_is_refused_in_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, told: str
) -> None:
    other = tmp_path / "other"
    other.write_text(text, encoding="utf-8")
    with pytest.raises(SystemExit):
        campaign_sum.main([*write(tmp_path, FUZZ), str(other)])
    assert told in capsys.readouterr().err
