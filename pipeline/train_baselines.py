"""Train what the ensemble is compared with, with the same number of updates."""

from pipeline.stage import Call, run_stage


def main(call: Call) -> None:
    """Train the baselines of an experiment."""
    if call.kind == "motion":
        from pipeline.motion_baselines import train
    else:
        from pipeline.transition_baselines import train
    train(call)


if __name__ == "__main__":
    run_stage(main)
