"""Effects written in Python: the same errors as the formula that says the same, and a nonlinear parameter that is found."""

import math

import numpy as np
import pytest

import magpie

RIPPLE = magpie.Effect("ripple", "dz_um", lambda columns: np.stack([f(columns["motor_angle_rad"]) for f in (np.sin, np.cos)], axis=1))


def error_g(found):
    return found.edit.data["after"]["held_out_rms_g"]


def test_a_function_is_fitted_and_evaluated_like_its_formula(ripple, fitted):
    found = magpie.fit_effect(fitted.model, ripple, RIPPLE)
    same = magpie.add(fitted.model, ripple, exprs=["ripple: dz_um = a*sin(motor_angle_rad) + b*cos(motor_angle_rad)"])
    assert error_g(found) == pytest.approx(same.data["after"]["held_out_rms_g"], rel=1e-4)
    assert error_g(found) < 0.17 < 1.0 < found.edit.data["before"]["held_out_rms_g"]
    assert list(found.to_pandas().effect) == ["ripple"] and "<table>" in found._repr_html_()
    diagnosis = found.diagnose()
    assert next(verdict for verdict in diagnosis.verdicts if verdict.effect == "ripple").verdict == "found"
    # No board can evaluate it.
    with pytest.raises(magpie.MagpieError):
        magpie.export(found.edit.model, found.campaign.parent / "tables.rs")


def test_a_nonlinear_parameter_is_found(ripple, fitted):
    def waves(columns, pitch_mm):
        phase = 2 * math.pi * columns["opening_mm"] / pitch_mm
        return np.stack([np.sin(phase), np.cos(phase)], axis=1)

    effect = magpie.Effect("screw", "dz_um", waves, {"pitch_mm": (3.1, 3.3)})
    found = magpie.fit_effect(fitted.model, ripple, effect, evaluations=24)
    # The screw of recording.toml.
    assert found.parameters["pitch_mm"] == pytest.approx(3.213, abs=0.004)
    assert error_g(found) < 0.18
    assert "pitch_mm = 3.2" in str(found)


def test_a_function_of_another_length_is_refused(ripple, fitted):
    with pytest.raises(ValueError, match="shape"):
        magpie.fit_effect(fitted.model, ripple, magpie.Effect("odd", "dz_um", lambda columns: np.zeros(3)))
