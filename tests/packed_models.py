"""Folders of models as the stages write them, of networks that nobody trained."""

from pathlib import Path

from trusted_models import trusted_model, write_pair

from addressed_dynamics.base.files import write_json
from addressed_dynamics.networks.files import SavedNetwork, save_network
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.delivery import ENSEMBLE, Delivered, write_delivered
from addressed_dynamics.simulators.motion import MotionModel


def write_addressed(folder: Path, *models: AddressedDynamics | MotionModel) -> Path:
    """Write an ensemble of each seed, with two variants of its addressing network; the first is delivered."""
    for seed, model in enumerate(models):
        networks = model.networks if isinstance(model, MotionModel) else model.ensemble
        save_network(folder / "ensemble" / f"seed-{seed}", SavedNetwork(networks, model.features, {}))
        assert model.addressing is not None
        for variant in ("plain", "cost_sensitive"):
            place = folder / "addressing" / f"seed-{seed}" / variant
            save_network(place, SavedNetwork(model.addressing, model.features, {}))
    chosen = {str(seed): "plain" for seed in range(len(models))}
    index = {"format": 1, "delivered": chosen, "variants": ["plain", "cost_sensitive"]}
    write_json(folder / "addressing" / "addressing.json", index)
    write_delivered(folder, Delivered(0, None, models[0].mode, candidate=ENSEMBLE))
    return folder


def write_trusted(folder: Path, history: int = 1) -> Path:
    """Write two baselines and the trust in the first, which is delivered."""
    write_pair(folder, *trusted_model(history))
    write_delivered(folder, Delivered(0, None, None, candidate="total_parameters"))
    return folder
