"""Our logs as other programs see them: two checkers, and the columns that Rerun makes of them."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from builders import CAR, RUN, car_transitions
from builders import write_log as write_one_by_one
from google.protobuf import descriptor_pb2
from mcap.reader import make_reader

from addressed_dynamics.logs import write_log

EXPECTED = car_transitions([200, 30, 200])
RERUN = pytest.importorskip("rerun", reason="rerun-sdk has no wheel for this machine")


@pytest.fixture(params=["live", "bulk"])
def log(request, tmp_path):
    path = tmp_path / f"{request.param}.mcap"
    if request.param == "live":
        write_one_by_one(path, EXPECTED)
    else:
        write_log(path, EXPECTED, run=RUN)
    return path


@pytest.fixture
def rerun(tmp_path):
    """Run the command line of Rerun in a home of its own, in which its analytics are switched off."""
    home = {"HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path / "config"), "XDG_DATA_HOME": str(tmp_path / "data")}

    def run(*arguments):
        command = [Path(sys.executable).with_name("rerun"), *arguments]
        return subprocess.run(command, env={**os.environ, **home}, capture_output=True, text=True, check=True)

    run("analytics", "disable")
    return run


@pytest.mark.slow
def test_pymcap_finds_nothing_wrong(log):
    command = [Path(sys.executable).with_name("pymcap-cli"), "doctor", log]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert "passed MCAP doctor checks" in done.stdout.replace("\n", " ")
    assert "warning" not in done.stdout.lower()


def test_rerun_finds_nothing_wrong(log, rerun):
    said = rerun("mcap", "check", "--full", str(log)).stdout
    assert [line.split()[0] for line in said.splitlines() if "/env_00/transition" in line or "/episode" in line] == [
        "ok",
        "ok",
    ]


def test_rerun_makes_typed_columns_of_a_log(log, rerun, tmp_path):
    from rerun.chunk import RrdReader

    rerun("mcap", "convert", str(log), "-o", str(tmp_path / "car.rrd"))
    chunks = [each.to_record_batch() for each in RrdReader(tmp_path / "car.rrd").store().stream() if not each.is_static]
    name = "addressed_dynamics.Transition:message"
    batches = [batch for batch in chunks if name in batch.schema.names]
    steps = pa.chunked_array([batch.column(name).flatten() for batch in batches]).combine_chunks()
    position = steps.field("observation").field("position")
    assert position.type == pa.float32()
    np.testing.assert_array_equal(position.to_numpy(), EXPECTED.observation[:, 0])
    assert steps.type.field("terminated").type == pa.bool_()
    times = np.concatenate([batch.column("message_log_time").to_numpy() for batch in batches])
    np.testing.assert_array_equal(times.astype(np.int64), EXPECTED.time_ns)


def test_units_and_bounds_are_in_the_comments_of_the_schema(log):
    with log.open("rb") as stream:
        schemas = make_reader(stream).get_summary().schemas
    (file,) = descriptor_pb2.FileDescriptorSet.FromString(schemas[1].data).file
    comments = [location.leading_comments.strip() for location in file.source_code_info.location]
    assert comments == [f"{each.unit}, {each.low:g} to {each.high:g}" for each in CAR.observation]
