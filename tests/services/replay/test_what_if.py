"""What-if replay: other settings change the outputs, the run's own settings do not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ltv_mpc.control.scaling import default_weights
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Estimate, Plan
from ltv_mpc.vehicle.parameters import Vehicle
from services.recording.reader import Recording
from services.replay import replay as engine
from services.replay.verdict import Change
from services.run.folder import RunFolder


def test_with_the_run_s_own_settings_nothing_changes(locked_run: RunFolder) -> None:
    run = engine.Run(locked_run.recording)
    for node, kind in (("controller", Plan), ("estimator", Estimate)):
        verdict = engine.what_if(run, locked_run.config(node))
        assert (verdict.node, verdict.changes) == (node, ())
        # A plan that was on its way when the run ended is made, not recorded.
        recorded = sum(message.kind is kind for message in Recording(locked_run.recording))
        assert verdict.pairs == verdict.recorded == recorded >= 8
        assert recorded <= verdict.replayed <= recorded + 1
        assert all(deviation.rms == deviation.max_abs == deviation.final == 0.0 for deviation in verdict.deviations)


def test_another_weight_gives_other_plans_and_the_figures_are_those_of_the_thrusts(locked_run, tmp_path) -> None:
    settings = tmp_path / "mine.toml"
    settings.write_text("horizon_s = 5.0\n[weights]\nthrust = 0.3\n")
    verdict = engine.what_if(engine.Run(locked_run.recording), settings)
    assert verdict.node == "controller"
    assert [change for change in verdict.changes if change.key == "weights.thrust"] == [
        Change(key="weights.thrust", run=default_weights(Vehicle.load("paper")).thrust, here=0.3)
    ]
    port, starboard, vertical = verdict.deviations
    assert (port.of, port.unit) == ("port thrust", "N")
    for lateral in (port, starboard):
        assert 1.0 < lateral.rms < lateral.max_abs < 130.0
    assert vertical.max_abs < 1e-9  # its weights are no part of the QP
    # Thrust that costs a hundred times more is hardly used: what is missing is what was recorded.
    recorded = [message.typed()[0] for message in Recording(locked_run.recording) if message.kind is Plan]
    used = np.concatenate([plan.thrust_N[:, 0] for plan in recorded if isinstance(plan, Plan)])
    assert port.rms == pytest.approx(np.sqrt((used**2).mean()), rel=0.5)
    shares = {share.origin: (share.recorded, share.replayed) for share in verdict.shares}
    assert sum(recorded for recorded, _ in shares.values()) == pytest.approx(1.0)
    assert shares["solved"][1] > 0.5


def test_another_filter_setting_gives_other_estimates(locked_run: RunFolder, tmp_path: Path) -> None:
    settings = tmp_path / "mine.toml"
    settings.write_text("current_sd_mps = 0.4\n")
    verdict = engine.what_if(engine.Run(locked_run.recording), settings)
    assert verdict.node == "estimator"
    assert verdict.changes == (Change(key="current_sd_mps", run=0.04, here=0.4),)
    assert verdict.shares == ()
    of = {deviation.of: deviation for deviation in verdict.deviations}
    assert 1e-7 < of["velocity north"].rms < 0.1
    assert abs(of["velocity north"].final) <= of["velocity north"].max_abs


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("horizon_s = 5.0\ncell_m = 1.0\n", "its keys fit none of them"),
        ("horizon_s = 5.0\nperiods_s = 0.3\n", 'unknown key "periods_s"; did you mean "period_s"?'),
    ],
)
def test_a_settings_file_of_no_node_is_rejected(locked_run: RunFolder, tmp_path: Path, text: str, wrong: str) -> None:
    settings = tmp_path / "mine.toml"
    settings.write_text(text)
    with pytest.raises(ConfigError) as refused:
        engine.what_if(engine.Run(locked_run.recording), settings)
    assert "mine.toml" in str(refused.value)
    assert wrong in str(refused.value)
