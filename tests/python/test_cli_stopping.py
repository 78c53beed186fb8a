"""The command line ends in order when it is stopped."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from freetalk.cli import app, models
from freetalk.cli.app import EXIT_STOPPED, EXIT_TERMINATED, main

PYTHON = Path(__file__).resolve().parents[2] / "python"


@pytest.fixture(autouse=True)
def _handlers() -> object:
    before = {each: signal.getsignal(each) for each in (signal.SIGTERM, signal.SIGINT)}
    yield
    for each, handler in before.items():
        signal.signal(each, handler)


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGTERM, EXIT_TERMINATED), (signal.SIGINT, EXIT_STOPPED)]
)
def test_a_signal_clears_half_written_files_away(
    number: signal.Signals,
    status: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from freetalk._files import replacing

    def stopped(_: object) -> None:
        with replacing(tmp_path / "talk.glb") as temporary:
            temporary.write_text("half")
            signal.raise_signal(number)

    monkeypatch.setattr(models, "list_models", stopped)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
    assert main(["models", "list"]) == status
    assert list(tmp_path.iterdir()) == []
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.slow
def test_the_command_is_silent_while_torch_is_loaded(tmp_path: Path) -> None:
    command = tmp_path / "freetalk"
    command.write_text(
        "import signal, freetalk\n"
        "assert signal.getsignal(signal.SIGINT) == signal.SIG_DFL\n"
        "from freetalk.cli.app import main\n"
        "main(['--version'])\n"
        "assert signal.getsignal(signal.SIGINT) == signal.default_int_handler\n"
        "signal.raise_signal(signal.SIGINT)\n"
    )
    done = subprocess.run(
        [sys.executable, command],
        env={**os.environ, "PYTHONPATH": str(PYTHON)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "AssertionError" not in done.stderr and "KeyboardInterrupt" in done.stderr, done.stderr


def test_a_program_that_handles_sigterm_itself_keeps_its_handler() -> None:
    def own(number: int, frame: object) -> None:
        raise AssertionError

    signal.signal(signal.SIGTERM, own)
    app.main(["--version"])
    assert signal.getsignal(signal.SIGTERM) is own
