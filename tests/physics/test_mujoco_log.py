"""MuJoCo's warnings, which go to a logger and leave no file behind."""

from __future__ import annotations

import mujoco
import numpy as np

from maax_mjx.physics.host_stepper import _log_warnings

FALLING = "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"


def warn():
    model = mujoco.MjModel.from_xml_string(FALLING)
    data = mujoco.MjData(model)
    data.qvel[:] = np.nan
    mujoco.mj_step(model, data)
    assert data.warning[mujoco.mjtWarning.mjWARN_BADQVEL].number


def test_a_world_that_diverges_leaves_no_log_file(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    before = mujoco.get_mju_user_warning()
    try:
        mujoco.set_mju_user_warning(None)
        warn()
        log = tmp_path / "MUJOCO_LOG.TXT"
        assert log.exists(), "MuJoCo writes one where nobody listens"
        log.unlink()
        _log_warnings()
        with caplog.at_level("DEBUG", logger="mujoco"):
            warn()
        assert not log.exists()
        assert "QVEL" in caplog.text
    finally:
        mujoco.set_mju_user_warning(before)
