"""Fig. 6: the forms that are compared, what is said of them, and the angles of one-step predictions."""

import re

import numpy as np
import pytest
from builders import CAR
from report_examples import example_arrays

from addressed_dynamics.episodes.transitions import Dimension
from addressed_dynamics.features.transitions.spec import Angle
from addressed_dynamics.reporting.transitions.angle_study import FORMS, circle, errors, noises, root_mean_square
from addressed_dynamics.reporting.transitions.figures import angles, episodes
from addressed_dynamics.reporting.transitions.figures.angles import SIZES, angle_forms
from addressed_dynamics.reporting.transitions.results import Arrays

ANGLE = Angle("angle_1", "cos_angle_1", "sin_angle_1", None)


@pytest.mark.parametrize("form", list(FORMS))
def test_without_noise_every_form_is_right_on_the_whole_circle(form: str) -> None:
    angle = circle() + 1e-4  # off the axes, where the arccosine or the arcsine alone loses half of all digits
    assert np.abs(errors(form, angle, noises(angle)["independent"], 0.0)).max() < 1e-10


def test_atan2_does_not_see_radial_noise_and_the_others_do() -> None:
    angle = circle()
    found = {form: root_mean_square(errors(form, angle, noises(angle)["radial"], 0.5)) for form in FORMS}
    assert found.pop("atan2") < 1e-14
    assert min(found.values()) > 0.01


@pytest.mark.parametrize("kind", ["independent", "one"])
def test_small_noise_moves_the_weighted_angle_and_atan2_alike_and_arccos_and_arcsin_more(kind: str) -> None:
    angle = circle()
    found = {form: root_mean_square(errors(form, angle, noises(angle)[kind], 1e-3)) for form in FORMS}
    assert found["weighted"] == pytest.approx(found["atan2"], rel=1e-3)
    assert found["printed"] > 1.05 * found["atan2"]
    assert found["arccos"] > 3 * found["atan2"]


def test_the_figure_says_which_form_is_the_better_and_which_is_used() -> None:
    figure = angle_forms("atan2")
    assert [view.choice[0] for view in figure.views] == [
        "against the angle",
        "against the size: independent noise in cosine and sine",
        "against the size: radial noise: both scaled alike",
        "weighted beyond atan2",
    ]
    independent = {line.name: line.values[SIZES.index(1e-3)] for line in figure.views[1].lines}
    study = errors("atan2", circle(), noises(circle())["independent"], 1e-3)
    assert independent["atan2"] == pytest.approx(root_mean_square(study), rel=5e-4)
    assert "Noise of 1\u202f×\u202f10⁻³: atan2 errs by 1.0\u202f×\u202f10⁻³ rad" in figure.caption
    assert "atan2 is nowhere the worse of the two" in figure.caption
    assert "only with noise in the cosine alone" in figure.caption
    assert figure.caption.endswith("The models here use atan2.")


def test_what_is_said_follows_the_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(FORMS, "weighted", FORMS["atan2"])
    monkeypatch.setitem(FORMS, "atan2", FORMS["printed"])
    caption = angles.angle_forms("weighted").caption
    assert re.search("the weighted angle by 1[01]\\.\\d\u202f% less", caption)
    assert "nowhere the worse" not in caption
    assert "independent noise in cosine and sine from a size of 0.0001 on" in caption


def test_angles_are_drawn_one_step_ahead_without_jumps() -> None:
    turn = np.linspace(0, 12, 300)
    states = np.stack([np.cos(turn), np.sin(turn)], axis=1).astype(np.float32)
    later = np.stack([np.cos(turn + 0.01), np.sin(turn + 0.01)], axis=1).astype(np.float32)
    values = example_arrays(CAR, 2) | {"next_observation": states, "predicted": later, "episode": np.zeros(300, int)}
    dimensions = [Dimension(name, "", -1, 1) for name in (ANGLE.cosine, ANGLE.sine)]
    arrays, rows = Arrays(**values), np.arange(300)
    truth, predicted = episodes._turns(arrays, rows, dimensions, ANGLE)
    np.testing.assert_allclose(truth, turn, atol=1e-6)
    np.testing.assert_allclose(predicted, turn + 0.01, atol=1e-6)
    chart = episodes.one_step_prediction(arrays, dimensions, [ANGLE])
    course, error = chart.views[-2:]
    assert (course.choice, error.choice) == (("angle_1", "course"), ("angle_1", "error"))
    prediction, truth_line = course.lines
    assert truth_line.values == pytest.approx(turn[:200], rel=5e-4, abs=1e-6)
    assert prediction.values == pytest.approx(turn[:200] + 0.01, rel=5e-4, abs=1e-6)
    assert error.lines[0].values == pytest.approx(np.full(200, 0.01), rel=1e-3)
    assert "atan2" in chart.caption
    assert "atan2" not in episodes.one_step_prediction(arrays, dimensions).caption
