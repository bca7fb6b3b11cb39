"""List of the position sets beside the settings."""

from __future__ import annotations

from pathlib import Path

from agent.model_files import position_set_names


def test_only_files_with_positions_are_listed(tmp_path: Path) -> None:
    (tmp_path / "b.csv").write_text("station,azimuth_deg,elevation_deg\n1,0.0,0.0\n")
    (tmp_path / "a.csv").write_text("station,azimuth_deg,elevation_deg\n1,45.0,0.0\n")
    (tmp_path / "balls.csv").write_text("ball,x,y,z\n1,0.0,0.0,0.0\n")
    (tmp_path / "damaged.csv").write_bytes(b"\xff\xfe\x00station")
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "positions.txt").write_text("station,azimuth_deg,elevation_deg\n1,0.0,0.0\n")
    assert position_set_names(tmp_path) == ("a.csv", "b.csv")
    assert position_set_names(tmp_path / "missing") == ()
