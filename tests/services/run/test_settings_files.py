"""Settings that the processes aboard publish: complete, resolved, and not larger than a frame may be."""

from __future__ import annotations

from pathlib import Path

from ltv_mpc import references
from ltv_mpc.config import loads
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.localisation.config import EstimatorConfig
from services.run.settings_files import MAX_CHARACTERS, PRIOR, controller_files, estimator_files, node_settings


def test_a_reference_that_is_kept_is_the_one_that_was_loaded_with_a_track_of_another_file(tmp_path: Path) -> None:
    (tmp_path / "track.csv").write_text("t_s,north_m,east_m\n0,0,0\n100,10,0\n200,10,10\n")
    (tmp_path / "track.toml").write_text('kind = "timed"\nfile = "track.csv"\n')
    (tmp_path / "elsewhere").mkdir()
    alone = tmp_path / "elsewhere" / "reference.toml"
    shipped = (Path(references.__file__).parent / "files").glob("*.toml")
    for name in (str(tmp_path / "track.toml"), *(path.stem for path in shipped)):
        alone.write_text(controller_files("paper", name, "", "", ControllerConfig())["config/reference.toml"])
        assert references.load(str(alone)) == references.load(name)


def test_a_path_and_a_fence_of_another_program_are_kept_as_toml(tmp_path: Path) -> None:
    rows = ["0 1 0 16 0 0 0 0 50.2 -5.1 0 1", *(f"{k} 0 3 16 0 0 0 0 50.20{k} -5.1 0 1" for k in (1, 2))]
    ring = [f"{k} 0 3 5001 3 0 0 0 50.{k} -5.{k % 2} 0 1" for k in range(3)]
    for name, lines in (("path.WAYPOINTS", rows), ("fence.waypoints", ring)):
        (tmp_path / name).write_text("\n".join(["QGC WPL 110", *lines]))
    path, fence = str(tmp_path / "path.WAYPOINTS"), str(tmp_path / "fence.waypoints")
    files = controller_files("paper", path, fence, "", ControllerConfig())
    (tmp_path / "kept.toml").write_text(files["config/reference.toml"])
    assert references.load(str(tmp_path / "kept.toml")) == references.load(path)
    assert loads(files["config/fence.toml"])["origin"] == {"latitude_deg": 50.2, "longitude_deg": -5.1}


def test_a_water_prior_is_kept_beside_the_settings_that_name_it(tmp_path: Path) -> None:
    text = "depth_m,v_north_mps,u_east_mps,sd_mps\n0,0,0,0.1\n1,0,0,0.1\n"
    (tmp_path / "mine.csv").write_text(text)
    files = estimator_files("paper", EstimatorConfig(water_prior=str(tmp_path / "mine.csv")))
    assert files[f"config/{PRIOR}"] == text
    assert loads(files["config/estimator.toml"])["water_prior"] == PRIOR


def test_settings_too_large_for_the_bus_are_not_published() -> None:
    files = {"config/reference.toml": "x" * MAX_CHARACTERS}
    assert node_settings("controller", files) is not None
    assert node_settings("controller", files | {"config/vehicle.toml": "x"}) is None
