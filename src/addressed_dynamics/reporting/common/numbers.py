"""Numbers as a person reads them."""

import math

MISSING = "–"
"""What stands for a number that there is none of."""

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def scientific(value: float | None, digits: int = 2) -> str:
    """Return `value` with so many significant digits, as a power of ten if it is small or large: 2.2 × 10⁻⁵."""
    if value is None:
        return MISSING
    if value == 0:
        return "0"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    if -1 <= int(exponent) <= 3:
        return significant(value, digits)
    # A thin and a narrow no-break space keep the three parts together.
    return f"{mantissa}\u202f×\u202f10{str(int(exponent)).translate(_SUPERSCRIPT)}"


def power_of_ten(value: float) -> str:
    """Return a power of ten without a mantissa: 10⁻⁶."""
    return f"10{str(round(math.log10(value))).translate(_SUPERSCRIPT)}"


def significant(value: float | None, digits: int = 3) -> str:
    """Return `value` in plain decimals, rounded to so many significant digits but never to less than a unit."""
    if value is None:
        return MISSING
    if value == 0:
        return "0"
    rounded = float(f"{value:.{digits - 1}e}")
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(rounded))))
    return f"{value:,.{decimals}f}"


def millionths(value: float | None) -> str:
    """Return `value` in units of 10⁻⁶ with at least two significant digits."""
    if value is None:
        return MISSING
    scaled = value * 1e6
    return significant(scaled, 2) if scaled < 9.95 else significant(scaled, 3 if scaled < 99.5 else 4)


def percent(share: float | None, digits: int = 1) -> str:
    """Return a share in per cent; never rounded to 100% or 0% if it is not, and without decimals if it is 0."""
    if share is None:
        return MISSING
    if share == 0:
        return "0\u202f%"
    text = f"{100 * share:.{digits}f}"
    if 0 < share < 1 and float(text) in {0.0, 100.0}:
        step = 10.0**-digits
        return f"< {step:.{digits}f}\u202f%" if share < 0.5 else f"> {100 - step:.{digits}f}\u202f%"
    return f"{text}\u202f%"


def as_printed(value: float, unit: float = 1.0) -> str:
    """Return a figure of the paper in `unit` with the decimals that it is printed with, at most one."""
    return f"{round(value / unit, 1):,}".removesuffix(".0")


def count(value: float) -> str:
    """Return a whole number with separators."""
    return f"{value:,.0f}"


def times(ratio: float) -> str:
    """Return a ratio of at least 1 in words: `1.3 times`, `40 times`."""
    return f"{significant(ratio, 2)} times"


def in_words(number: int) -> str:
    """Return a small whole number in words."""
    words = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
    return words[number] if number < len(words) else f"{number:,}"


def listed(words: list[str]) -> str:
    """Join words as a sentence does: `a`, `a and b`, `a, b and c`."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
