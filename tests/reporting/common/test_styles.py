from addressed_dynamics.reporting.common.figures.style import MODELS, model_style

SINGLES = ["relu_128/seed-0", "relu_128/seed-1", "relu_256/seed-0", "relu_512/seed-0"]


def test_models_without_a_colour_of_their_own_are_told_apart_and_keep_their_colour_over_seeds() -> None:
    shown = ["ensemble/argmax", "total_parameters/seed-0", *SINGLES, "unequal_bins/seed-0"]
    styles = {name: model_style(name, shown) for name in shown}
    assert styles["relu_128/seed-0"] == styles["relu_128/seed-1"]
    assert styles["relu_256/seed-0"][0] == "relu 256"
    colours = {colour for _, colour in styles.values()}
    assert len(colours) == len(shown) - 1


def test_a_model_with_a_colour_of_its_own_has_it_beside_any_other() -> None:
    assert model_style("wide/seed-3", SINGLES) == model_style("wide/seed-3") == MODELS["wide"]
