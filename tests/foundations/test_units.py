"""Units: factors, the strict grammar of numbers, and one exact sentence for every refusal."""

import re
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.units import NUMBER, UNITS, Dimension, parse_quantity, symbols, unit_of


def test_every_unit_is_filed_under_its_symbol_and_every_dimension_has_an_si_unit() -> None:
    assert all(unit.symbol == symbol and unit.factor > 0 for symbol, unit in UNITS.items())
    for dimension in {unit.dimension for unit in UNITS.values()}:
        assert UNITS[symbols(dimension)[0]].factor == 1.0
    assert symbols("angle") == ("rad", "mrad", "urad", "deg")


@pytest.mark.parametrize(
    ("text", "dimension", "si"),
    [
        ("0.02 mm", "length", 2e-5),
        ("1 inch", "length", 0.0254),
        (" 5um ", "length", 5e-6),
        ("-.5 m", "length", -0.5),
        ("+1.e-3 m", "length", 1e-3),
        ("2E3 mm", "length", 2.0),
        ("180 deg", "angle", np.pi),
        ("0.3 mrad", "angle", 3e-4),
        ("21 degC", "temperature", 21.0),
        ("250 ms", "time", 0.25),
        ("3 1", "number", 3.0),
    ],
)
def test_quantities(text: str, dimension: Dimension, si: float) -> None:
    assert parse_quantity(text, dimension, "job") == pytest.approx(si, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "dimension", "sentence"),
    [
        ("mm", "length", "'mm' is not a number with a unit, like '0.02 mm'."),
        ("", "angle", "'' is not a number with a unit, like '0.01 deg'."),
        ("1_0 mm", "length", "'1_0 mm' is not a number with a unit, like '0.02 mm'."),
        ("１ mm", "length", "'１ mm' is not a number with a unit, like '0.02 mm'."),
        ("nan mm", "length", "'nan mm' is not a number with a unit, like '0.02 mm'."),
        ("1,5 mm", "length", "'1,5 mm' is not a number with a unit, like '0.02 mm'."),
        ("1 mm 2", "length", "'1 mm 2' is not a number with a unit, like '0.02 mm'."),
        ("x", "torque", "'x' is not a number with a unit, like '1.5 Nm'."),
        ("12", "length", "'12' has no unit; allowed are m, cm, mm, um, inch."),
        ("12 deg", "length", "unit 'deg' is not a unit of length; allowed are m, cm, mm, um, inch."),
        ("12 foot", "length", "unit 'foot' is not a unit of length; allowed are m, cm, mm, um, inch."),
        ("1e999 m", "length", "'1e999 m' is not a finite number."),
    ],
)
def test_other_quantities_are_refused(text: str, dimension: Dimension, sentence: str) -> None:
    with pytest.raises(JobError) as caught:
        parse_quantity(text, dimension, "job")
    assert str(caught.value) == f"job: {sentence}"


def test_the_caller_chooses_the_error() -> None:
    with pytest.raises(MeasurementError):
        unit_of("deg", "length", "t", MeasurementError)
    assert unit_of("mm", "length", "t").factor == 1e-3


def test_no_other_module_converts() -> None:
    root = Path(calib.__file__).parent
    converts = re.compile(r"np\.(degrees|radians|deg2rad|rad2deg)\(|180\.0|\* 1e3\b|\b1e3 \*|25\.4|/ 1e-3\b")
    there = [path for path in sorted(root.rglob("*.py")) if converts.search(path.read_text(encoding="utf-8"))]
    assert [str(path.relative_to(root)) for path in there] == [str(Path("foundations", "units.py"))]


@pytest.mark.parametrize("text", ["0", "-1", "+1.", ".5", "1.5e-3", "1E+10", "007"])
def test_numbers(text: str) -> None:
    assert NUMBER.fullmatch(text)
    float(text)


@pytest.mark.parametrize("text", ["", ".", "e5", "1e", "1_0", "nan", "inf", "１", "0x1", "1 ", "--1", "1e5.0", "1\n"])
def test_not_numbers(text: str) -> None:
    assert not NUMBER.fullmatch(text)
