"""Compliance by measured torques that scatter and are off, of arms whose masses nobody knows as they are."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.assessment.choice import choose_terms
from calib.assessment.trust import remarks
from calib.foundations.errors import MeasurementError
from calib.presentation.sheets import choice_sheet
from tests.support import machines
from tests.support.gears import UR10
from tests.support.torques import OFFSETS, SIGMA, SOFT, table

Array = np.ndarray


def measured(
    seed: int, noise: float, n: int = 160, heavier: float = 0.0, stated: bool = True, built: bool = True
) -> calib.Measurements:
    """Rows with torques that scatter by ``noise`` Nm, read as the toolkit reads them."""
    columns = table(seed, noise, n, heavier, stated, built)
    return calib.read_measurements(columns, machines.load(*UR10), sigma=SIGMA)


def model(**more: object) -> calib.ErrorModel:
    return machines.model(machines.load(*UR10), **{"offsets": "all", "placements": "all", "torque": list(SOFT), **more})


def test_noise_of_torques_with_a_stated_sigma_does_not_bias_compliances() -> None:
    """Twelve Nm of noise on thirty and fifteen Nm; without its sigma, compliances come out far too small."""
    found = {said: [] for said in (True, False)}
    for seed in range(3):
        for said, values in found.items():
            fit = calib.identify(model(), measured(seed, 12.0, 240, stated=said))
            values.append([fit.value(f"{name}.torque") / value for name, value in SOFT.items()])
    np.testing.assert_allclose(np.mean(found[True], axis=0), 1.0, atol=0.06)
    assert np.mean(found[False], axis=0)[1] < 0.75


def test_what_the_urdf_does_not_know_is_in_the_torques_all_the_same() -> None:
    """Four kilograms on the hand, of which nobody tells: by torque the compliance is right, by masses it is not."""
    data = measured(5, 5.0, heavier=4.0)
    by_torque = calib.identify(model(), data)
    by_masses = calib.identify(model(torque="none", elastic=list(SOFT)), data)
    for name, value in SOFT.items():
        assert by_torque.value(f"{name}.torque") == pytest.approx(value, rel=0.06)
        assert abs(by_masses.value(f"{name}.elastic") / value - 1.0) > 0.1


def test_an_offset_of_the_sensor_is_found_where_the_joints_zero_is_known() -> None:
    """With zeros that are free it is a joint's offset, and the result says that they cannot be told apart."""
    known = model(offsets="none", placements="none", torque_offsets="free")
    for seed in range(3):
        fit = calib.identify(known, measured(seed, 0.5, built=False))
        sigmas = dict(zip((p.name for p in fit.parameters), fit.sigmas, strict=True))
        for name, offset in OFFSETS.items():
            assert sigmas[f"{name}.torque_offset"] < 0.1 * abs(offset)
            assert abs(fit.value(f"{name}.torque_offset") - offset) < 4.0 * sigmas[f"{name}.torque_offset"]
            assert abs(fit.value(f"{name}.torque") - SOFT[name]) < 4.0 * sigmas[f"{name}.torque"]
    both = calib.identify(model(torque_offsets="free"), measured(6, 0.5))
    assert any("torque_offset" in str(direction) for direction in both.null_space) or {
        f"{name}.torque_offset" for name in SOFT
    } & {*both.weak, *both.unidentifiable}


def test_the_choice_weighs_torques_against_masses_and_says_why() -> None:
    plain = calib.error_model(machines.load(*UR10), offsets="all", placements="all")
    heavy = choose_terms(plain, measured(8, 3.0, heavier=6.0))
    assert heavy.weighed is not None
    assert heavy.weighed.by_torques
    assert {term.kind for term in heavy.terms} >= {"torque"}
    assert not {term.kind for term in heavy.terms} & {"elastic", "moment"}
    assert heavy.weighed.sentence in choice_sheet(heavy).caption
    known = choose_terms(plain, measured(9, 12.0))
    assert known.weighed is not None
    assert known.weighed.record()["taken"] == "masses"
    assert "torque" not in {term.kind for term in known.terms}
    untold = replace(measured(9, 12.0), conditions=calib.measuring.Conditions())
    assert choose_terms(plain, untold).weighed is None


def test_what_is_expected_does_not_change_when_it_is_asked_again() -> None:
    data = measured(7, 20.0)
    once = calib.identify(model(), data)
    again = calib.identify(model(), once.measurements)
    assert [again.value(f"{name}.torque") for name in SOFT] == pytest.approx(
        [once.value(f"{name}.torque") for name in SOFT], rel=1e-9
    )


def test_a_sigma_below_zero_is_refused_with_its_line() -> None:
    robot = machines.load(*UR10)
    columns: dict[str, object] = {f"{reading.name} [rad]": np.zeros(2) for reading in robot.readings}
    columns |= {f"{axis} [m]": np.zeros(2) for axis in "xyz"} | {"sigma_tau [Nm]": np.array([1.0, -1.0])}
    with pytest.raises(MeasurementError, match=r"column 'sigma_tau': -1 is not a standard deviation; allowed is 0 Nm"):
        calib.read_measurements(columns, robot)


def test_torques_with_the_sign_turned_are_told() -> None:
    """They explain positions as well, with compliances below zero."""
    for sign, told in ((1.0, False), (-1.0, True)):
        columns = table(3, 0.5, stated=False)
        for name in SOFT:
            columns[f"tau_{name} [Nm]"] = sign * np.asarray(columns[f"tau_{name} [Nm]"])
        fit = calib.identify(model(), calib.read_measurements(columns, machines.load(*UR10), sigma=SIGMA))
        found = [one for one in remarks(fit) if one.code == "compliance-below-zero"]
        assert len(found) == told
    assert "of 'shoulder_lift_joint', 'elbow_joint': no joint moves" in found[0].sentence
    assert "Check the sign of the torques" in found[0].sentence
