"""A Ray cluster of two nodes on this machine, for the tests of this folder alone (`make test-cluster`)."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"  # every server on the loopback alone
# Workers import what they are to do from the folders of the tests, too; set before the first of them starts.
TESTS = Path(__file__).parent.parent
os.environ["PYTHONPATH"] = os.pathsep.join(
    [str(TESTS), str(TESTS / "cluster"), *filter(None, [os.environ.get("PYTHONPATH")])]
)


@pytest.fixture(scope="session")
def running_cluster() -> Iterator[Any]:
    """A cluster of a head that works on nothing, and two nodes of one core each."""
    from ray.cluster_utils import Cluster  # not before the variables above are set

    folder = tempfile.mkdtemp(prefix="ray-")
    head = {"num_cpus": 0, "include_dashboard": False, "temp_dir": folder}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    try:
        for _ in range(2):
            cluster.add_node(num_cpus=1)
        cluster.wait_for_nodes()
        yield cluster
    finally:
        cluster.shutdown()
        shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def cluster(running_cluster: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The cluster, which the environment asks for."""
    monkeypatch.setenv("ADDRESSED_DYNAMICS_ENGINE", f"ray:{running_cluster.address}")
    return running_cluster
