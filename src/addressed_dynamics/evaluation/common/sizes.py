"""What the one network is called that is to be as large as the whole model."""

ALIKE = 0.05
"""Share by which the parameters of two models of the same size may differ: widths are whole numbers."""


def total_size(parameters: int, own: int) -> str:
    """Return what a reader should see for the size of the network `total_parameters`, after `one network of`.

    Args:
        parameters: what it has.
        own: what the members and the network that addresses them have together.
    """
    if abs(parameters - own) <= ALIKE * own:
        return "as many parameters as members and addressing together"
    return f"{parameters:,} parameters, where members and addressing have {own:,}"
