import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.reporting.common.numbers import as_printed, listed, millionths, percent, scientific, significant

DIGITS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def read(text: str) -> float:
    """The number that a reader takes from a text."""
    mantissa, _, exponent = text.replace(",", "").replace("\u202f", "").partition("×10")
    return float(mantissa) * 10.0 ** float(exponent.translate(DIGITS) or 0)


@given(st.floats(1e-18, 1e12), st.integers(2, 4))
def test_a_scientific_number_reads_as_what_it_was_rounded_to_its_digits(value: float, digits: int) -> None:
    assert read(scientific(value, digits)) == pytest.approx(value, rel=0.51 * 10.0 ** (1 - digits))


@given(st.floats(1e-6, 1e6))
def test_a_significant_number_has_no_exponent_and_keeps_its_digits(value: float) -> None:
    assert re.fullmatch(r"[\d,.]+", significant(value))
    assert read(significant(value)) == pytest.approx(value, rel=0.0051)


@given(st.floats(0.0, 1.0, exclude_min=True, exclude_max=True))
def test_a_share_reads_as_none_or_all_only_if_it_is(share: float) -> None:
    assert percent(share) not in {"0.0\u202f%", "100.0\u202f%"}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (percent(0.0), "0\u202f%"),
        (percent(1.0), "100.0\u202f%"),
        (percent(0.9999), "> 99.9\u202f%"),
        (scientific(2.225e-5, 4), "2.225\u202f×\u202f10⁻⁵"),
        (scientific(0), "0"),
        (scientific(None), "–"),
        (millionths(1861.3e-6), "1,861"),
        (millionths(0.04e-6), "0.040"),
        (millionths(None), "–"),
        (as_printed(1861.3e-6, 1e-6), "1,861.3"),
        (as_printed(27.0), "27"),
        (listed(["a"]), "a"),
        (listed(["a", "b", "c"]), "a, b and c"),
    ],
)
def test_numbers_read_as_people_write_them(text: str, expected: str) -> None:
    assert text == expected
