"""Tests of the simulated plant for LinuxCNC: memory shared with the servo thread, and detection of collisions."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from requirements import requires_linuxcnc

from simulators.linuxcnc.memory import TRACE, DeviationGrid, PlantMemory, ProbeBehaviour
from simulators.linuxcnc.plant import LinuxCncPlant
from simulators.scenario import read_scenario
from twin.collision.bodies import TIP

ROOT = Path(__file__).resolve().parents[2]
SCENARIO = ROOT / "config" / "simulators" / "case-study.toml"
COMPONENTS = ROOT / "simulators" / "linuxcnc" / "components"
NATURE = ProbeBehaviour(7, 15.5, 6.0, 0.008, 0.0005, 0.0012, 0.0002, (0.1, 0.2, 0.3), (0.0, 250.0, 0.0))
READER = r"""
#include <fcntl.h>
#include <stdio.h>
#include <sys/mman.h>
#include "volcal_plant.h"
int main(int count, char **words) {
    plant_memory *memory = mmap(NULL, 1 << 24, PROT_READ | PROT_WRITE, MAP_SHARED, open(words[1], O_RDWR), 0);
    plant_scene scene = {0};
    double at[3], deviation[3];
    if (count != 2 || memory->magic != PLANT_MAGIC || !plant_read_scene(memory, &scene)) return 1;
    printf("%.17g %.17g %.17g %.17g\n", scene.balls, scene.seed, scene.backlash_mm[2], scene.temperature_c[1]);
    printf("%.17g %.17g %.17g\n", scene.ball_mm[1][0], scene.ball_mm[1][1], scene.ball_mm[1][2]);
    while (scanf("%lf %lf %lf", at, at + 1, at + 2) == 3) {
        plant_deviation(memory, at, deviation);
        plant_trace(memory, at);
        printf("%.17g %.17g %.17g\n", deviation[0], deviation[1], deviation[2]);
    }
    return 0;
}
"""


@requires_linuxcnc
def test_servo_thread_reads_the_data_written_by_python(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    linear = rng.normal(size=(3, 3)) * 1e-5
    origin, step, nodes = np.array([-10.0, 0.0, 5.0]), np.array([20.0, 30.0, 40.0]), (4, 3, 5)
    grid = np.stack(
        np.meshgrid(*(o + s * np.arange(n) for o, s, n in zip(origin, step, nodes, strict=True)), indexing="ij")
    )
    deviation = np.einsum("ij,jxyz->xyzi", linear, grid)
    memory = PlantMemory(tmp_path / "plant.bin", DeviationGrid(origin, step, deviation), NATURE)
    memory.show(
        np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), drift_mm=(0.0, 0.0, 0.0), temperatures_c=[20.0, 21.0, 22.0]
    )
    (tmp_path / "reader.c").write_text(READER, encoding="utf-8")
    flags = ["-I/usr/include/linuxcnc", f"-I{COMPONENTS}", "-DULAPI", "-DUSPACE", "-D_GNU_SOURCE", "-w"]
    subprocess.run(["gcc", *flags, "-o", "reader", "reader.c", "-lm"], cwd=tmp_path, check=True, timeout=600.0)
    places = rng.uniform(origin, origin + step * (np.array(nodes) - 1), (50, 3))
    places[-1] = [-100.0, 30.0, 1000.0]
    output = subprocess.run(
        [tmp_path / "reader", tmp_path / "plant.bin"],
        input="\n".join(" ".join(map(repr, place)) for place in places.tolist()),
        capture_output=True,
        text=True,
        check=True,
        timeout=600.0,
    ).stdout.splitlines()
    assert [float(word) for word in output[0].split()] == [2.0, 7.0, 0.3, 21.0]
    assert [float(word) for word in output[1].split()] == [4.0, 5.0, 6.0]
    inside = np.clip(places, origin, origin + step * (np.array(nodes) - 1))
    assert np.loadtxt(output[2:]) == pytest.approx(inside @ linear.T, abs=1e-15)
    assert memory.read_trace() == pytest.approx(places)


class TestCollisions:
    @pytest.fixture
    def plant(self, tmp_path: Path) -> LinuxCncPlant:
        return LinuxCncPlant(read_scenario(SCENARIO).without_errors(), tmp_path / "plant.bin")

    @staticmethod
    def go(plant: LinuxCncPlant, *places: np.ndarray) -> list[tuple[str, str]]:
        """Move the tip as the servo thread would report it; return all collisions since the beginning."""
        head = plant.memory._head
        for place in places:
            head["trace_mm"][0][int(head["traced"][0]) % TRACE] = place
            head["traced"] += 1
        plant.on_advance(0.0)
        return [(bump.body_a, bump.body_b) for bump in plant.world.collisions]

    def test_touching_a_ball_is_no_collision(self, plant: LinuxCncPlant) -> None:
        ball = np.array(plant.world.table.snapshot(0.0).balls[5])
        assert self.go(plant, *(ball - [0.0, distance, 0.0] for distance in (200.0, 20.0, 15.0, 20.0, 200.0))) == []

    def test_pressing_beyond_the_overtravel_is_exactly_one_collision(self, plant: LinuxCncPlant) -> None:
        standing = plant.world.table.snapshot(0.0)
        ball = np.array(standing.balls[5])
        path = [ball - [0.0, distance, 0.0] for distance in (20.0, 9.0, 8.5, 20.0)]
        assert self.go(plant, *path) == [(TIP, standing.ball_names[5])]

    def test_ram_through_the_bar_is_a_collision(self, plant: LinuxCncPlant) -> None:
        ball = np.array(plant.world.table.snapshot(0.0).balls[5])
        bumps = self.go(plant, *(ball + np.array([0.0, 60.0, z]) for z in (-300.0, 300.0)))
        assert bumps != []
        assert all("ball" not in moving for moving, _ in bumps)
