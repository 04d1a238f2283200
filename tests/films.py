"""Films as their frames."""

import io

from PIL import Image

from addressed_dynamics.reporting.common.blocks import Panel


def frames(panel: Panel) -> list[Image.Image]:
    """Every picture of a film."""
    with Image.open(io.BytesIO(panel.content)) as file:
        shown = []
        for index in range(file.n_frames):
            file.seek(index)
            shown.append(file.convert("RGB"))
        return shown
