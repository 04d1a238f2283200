"""Values and intervals as people read them."""

from __future__ import annotations

import json
from typing import Any

from addressed_dynamics.evaluation.common.bootstrap import Ratio
from addressed_dynamics.reporting.common.numbers import MISSING, significant


def shown(value: Any) -> str:
    """Return a value on one line; a dash for none."""
    if value is None:
        return MISSING
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return f"{value:.6g}"
    return json.dumps(value, ensure_ascii=False)


def times(ratio: Ratio | None) -> str:
    """Return a ratio."""
    return MISSING if ratio is None else significant(ratio.value)


def interval_words(ratio: Ratio | None) -> str:
    """Return the interval of a ratio."""
    return MISSING if ratio is None else f"{significant(ratio.low)} – {significant(ratio.high)}"
