import importlib.metadata
import json
import subprocess
import sys

import pytest
from builders import car_transitions, write_log
from mcap.reader import make_reader

from addressed_dynamics.cli import main as cli
from addressed_dynamics.logs import read_log


@pytest.fixture
def run(monkeypatch, capsys):
    """Run the command line in this process: its exit status and what it wrote."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["addressed-dynamics", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        out, err = capsys.readouterr()
        return int(caught.value.code or 0), out, err

    return run


@pytest.fixture
def unfinished(tmp_path):
    """A log of three episodes of twenty steps that was killed before its index."""
    data = write_log(tmp_path / "whole.mcap", car_transitions([20, 20, 20])).read_bytes()
    (tmp_path / "whole.mcap").unlink()
    (tmp_path / "car.mcap.partial").write_bytes(data[: len(data) * 2 // 3])
    return tmp_path / "car.mcap.partial"


def test_the_version_is_the_packages(run):
    assert run("--version") == (0, f"addressed-dynamics {importlib.metadata.version('addressed-dynamics')}\n", "")


def test_recover_writes_a_new_log_and_says_what_was_lost(run, unfinished):
    status, out, err = run("recover", unfinished)
    assert (status, err) == (0, "")
    target = unfinished.with_name("car.recovered.mcap")
    saved = len(read_log(target).transitions)
    lines = out.splitlines()
    assert lines[0] == f"{target}: {saved} transitions of {saved // 20} episodes"
    assert lines[1] == f"saved: episodes 0 to {saved // 20 - 1}, 0.000 s to {(saved - 1) / 30:.3f} s"
    assert lines[2:4] == [
        f"saved: {saved} messages of /env_00/transition",
        f"saved: {saved // 20} messages of /episode",
    ]
    assert len(lines) > 4
    assert all(line.startswith("lost: byte ") for line in lines[4:])


def test_recover_says_between_which_episodes_and_times_something_is_missing(run, tmp_path):
    path = write_log(tmp_path / "car.mcap", car_transitions([20, 20, 20]))
    data = bytearray(path.read_bytes())
    with path.open("rb") as stream:
        damaged = make_reader(stream).get_summary().chunk_indexes[1]
    data[damaged.chunk_start_offset + damaged.chunk_length // 2] ^= 255
    path.write_bytes(data)
    _, out, _ = run("recover", path)
    assert "lost: 20 transitions between episode 0 (0.633 s) and episode 2 (1.333 s)" in out.splitlines()


def test_recover_can_give_an_unfinished_log_its_own_name(run, unfinished):
    target = unfinished.with_name("car.mcap")
    assert run("recover", unfinished, "-o", target)[0] == 0
    assert len(read_log(target).transitions) >= 20
    assert sorted(path.name for path in target.parent.iterdir()) == ["car.mcap", "car.mcap.partial"]


def test_inspect_shows_a_log_and_a_folder_of_logs(run, tmp_path):
    path = write_log(tmp_path / "car.mcap", car_transitions([20, 30]))
    status, out, err = run("inspect", path)
    assert (status, err) == (0, "")
    assert {"50, one every 0.03333 s", "20 to 30, median 25", "/env_00/transition", "observation.position"} <= {
        part.strip() for line in out.splitlines() for part in line.split("  ")
    }
    status, out, err = run("inspect", tmp_path)
    assert (status, err) == (0, "")
    assert "1, 0 of them with a problem" in out


def test_inspect_prints_one_json_document(run, tmp_path):
    path = write_log(tmp_path / "car.mcap", car_transitions([20, 30]))
    status, out, _ = run("inspect", path, "--json")
    document = json.loads(out)
    assert (status, document["path"], document["problem"]) == (0, str(path), None)
    assert document["experience"]["length"] == {"min": 20.0, "median": 25.0, "max": 30.0}
    folder = json.loads(run("inspect", tmp_path, "--json")[1])
    assert folder["files"] == [document]
    assert folder["totals"]["experience"] == document["experience"]


def test_inspect_fails_after_it_has_shown_what_is_intact(run, unfinished):
    status, out, err = run("inspect", unfinished)
    assert (status, err) == (1, "")
    assert "/env_00/transition" in out
    assert f"addressed-dynamics recover {unfinished}" in out
    status, out, err = run("inspect", unfinished.parent, "--json")
    document = json.loads(out)
    assert (status, err, document["totals"]["damaged"]) == (1, "", 1)
    assert document["files"][0]["problem"]["offset"] > 0


def test_inspect_needs_a_file_or_a_folder_with_logs(run, tmp_path):
    for path in (tmp_path, tmp_path / "nothing"):
        status, out, err = run("inspect", path)
        assert (status, out) == (1, "")
        assert err.startswith(f"error: {path}: ")
        assert err.count("\n") == 1


def test_an_error_is_one_line_and_a_failing_status(run, tmp_path):
    (tmp_path / "empty.mcap").touch()
    status, out, err = run("recover", tmp_path / "empty.mcap")
    assert (status, out) == (1, "")
    assert err.startswith("error: ")
    assert err.count("\n") == 1


def test_ctrl_c_is_the_shells_status_without_a_traceback(run, monkeypatch, tmp_path):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "recover_log", interrupted)
    assert run("recover", tmp_path) == (130, "", "")


@pytest.mark.parametrize("arguments", [["recover"], ["nothing"], ["ui", "--port", "0"]])
def test_a_mistyped_command_is_a_usage_error_without_a_traceback(run, arguments):
    status, _, err = run(*arguments)
    assert status == 2
    assert "Traceback" not in err


def test_ui_serves_on_the_port_it_is_given(run, monkeypatch):
    from addressed_dynamics import tracking

    ports = []
    monkeypatch.setattr(tracking, "serve_ui", ports.append)
    assert run("ui", "--port", "5123")[0] == 0
    assert run("ui")[0] == 0
    assert ports == [5123, 5000]


@pytest.mark.slow
def test_the_command_starts_without_mlflow_and_torch():
    program = "import sys, addressed_dynamics.cli.main; print('torch' in sys.modules or 'mlflow' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
