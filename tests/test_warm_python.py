"""The interpreter that has imported the packages already runs a command as a fresh one would."""

import subprocess
import sys
from pathlib import Path

from pipeline_clones import warm_interpreter

SAY = """
import os, sys
ready = "torch" in sys.modules and "mlflow" in sys.modules
print(sys.argv[1:], os.getcwd(), os.environ.get("WORD"), sys.stdin.read(), ready if sys.argv[1] == "ready" else "")
print(__name__, [name for name in sys.modules if name.startswith("addressed_dynamics")], file=sys.stderr)
from addressed_dynamics import mark
sys.exit(mark.STATUS)
"""


def clone(folder: Path, status: int) -> Path:
    """A folder with a program `say` and with sources of its own, which say with which status it ends."""
    (folder / "src" / "addressed_dynamics").mkdir(parents=True)
    (folder / "src" / "addressed_dynamics" / "__init__.py").touch()
    (folder / "src" / "addressed_dynamics" / "mark.py").write_text(f"STATUS = {status}\n")
    (folder / "say.py").write_text(SAY)
    return folder


def say(python: Path, folder: Path, *arguments: str) -> tuple[int, str, str]:
    environment = {"PYTHONPATH": str(folder / "src"), "WORD": folder.name}
    command = [python, "-m", "say", *arguments]
    done = subprocess.run(
        command, cwd=folder, env=environment, input="typed", capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout, done.stderr


def test_a_warm_command_has_its_own_arguments_folder_environment_streams_sources_and_status(tmp_path: Path) -> None:
    warm = warm_interpreter() / "python"
    for name, status in {"first": 0, "second": 3}.items():
        folder = clone(tmp_path / name, status)
        code, stdout, stderr = say(warm, folder, "a b", "--option")
        assert (code, stdout, stderr) == say(Path(sys.executable), folder, "a b", "--option")
        assert code == status
        assert stdout.startswith(f"['a b', '--option'] {folder} {name} typed")
        assert stderr == "__main__ []\n"
    assert say(warm, tmp_path / "first", "ready")[1].endswith("True\n")


def test_a_warm_command_may_be_a_program_or_a_script_beside_its_modules(tmp_path: Path) -> None:
    (tmp_path / "scripts").mkdir()
    (tmp_path / "scripts" / "word.py").write_text("WORD = 'word'\n")
    (tmp_path / "scripts" / "say.py").write_text("import sys, word\nprint(word.WORD, __name__, sys.argv)\n")
    for arguments in (["-c", "import sys; print(__name__, sys.argv)", "a"], ["scripts/say.py", "a"]):
        outputs = [
            subprocess.run([python, *arguments], cwd=tmp_path, capture_output=True, text=True, check=True).stdout
            for python in (warm_interpreter() / "python", sys.executable)
        ]
        assert outputs[0] == outputs[1] != ""


def test_a_warm_command_may_be_told_that_warnings_are_errors(tmp_path: Path) -> None:
    program = "import sys, warnings; print(sys.warnoptions, flush=True); warnings.warn('early', stacklevel=1)"
    for python in (warm_interpreter() / "python", sys.executable):
        done = subprocess.run(
            [python, "-W", "error", "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stdout) == (1, "['error']\n")
        assert done.stderr.endswith("UserWarning: early\n")


def test_a_warm_command_that_fails_shows_its_traceback_and_one_that_is_killed_its_signal(tmp_path: Path) -> None:
    warm = warm_interpreter() / "python"
    (tmp_path / "say.py").write_text("import sys\nraise ValueError(sys.argv[1])\n")
    code, _, stderr = say(warm, tmp_path, "reason")
    assert code == 1
    assert stderr.splitlines()[-1] == "ValueError: reason"
    (tmp_path / "say.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n")
    assert say(warm, tmp_path)[0] == 128 + 9
