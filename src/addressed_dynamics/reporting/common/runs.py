"""How a reader of a report finds the runs in MLflow that made what it shows.

A report is an output of DVC and so a function of its inputs: it names no run, but the digests with which runs are
tagged.
"""

from collections.abc import Mapping

from addressed_dynamics.reporting.common.blocks import Facts, Text


def run_blocks(experiment: str, outputs: Mapping[str, str]) -> tuple[Text | Facts, ...]:
    """Return how to find the runs; nothing if no output is known.

    Args:
        experiment: name of the experiment; empty if it is not known.
        outputs: digests of what the runs made, by the outputs' names, see `base.versions.output_digests`.
    """
    if not outputs:
        return ()
    named = f"the experiment '{experiment}'" if experiment else "the experiment"
    text = (
        f"'addressed-dynamics ui' shows the runs of {named} in MLflow. Each is tagged with a digest of "
        "what it made: in the search box above the runs, the filter beside an output finds those that made it."
    )
    return Text((text,)), Facts({name: f"tags.output LIKE '%{digest}%'" for name, digest in outputs.items()})
