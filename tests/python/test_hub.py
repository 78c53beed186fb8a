"""Weights go to the hub and come back whole; a folder stands in for huggingface.co."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from freetalk import Talker, hub
from freetalk._pretrained import PRETRAINED, find_weights
from freetalk.cli import main

huggingface_hub = pytest.importorskip("huggingface_hub")
OPEN_SMALL = PRETRAINED / "open-small"


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of all repositories, in which commits land and from which snapshots come."""
    root = tmp_path / "huggingface.co"

    class Api:
        def create_repo(self, repository: str, *, private: bool, exist_ok: bool) -> str:
            (root / repository).mkdir(parents=True, exist_ok=exist_ok)
            return f"https://huggingface.co/{repository}"

        def create_commit(
            self, repository: str, operations: list[Any], commit_message: str
        ) -> None:
            for one in operations:
                path = root / repository / one.path_in_repo
                path.parent.mkdir(parents=True, exist_ok=True)
                data = one.path_or_fileobj
                path.write_bytes(data if isinstance(data, bytes) else Path(data).read_bytes())

    def snapshot(repository: str, *, revision: str | None, allow_patterns: list[str]) -> str:
        if not (root / repository).is_dir():
            response = SimpleNamespace(headers={}, request=None)
            raise huggingface_hub.errors.RepositoryNotFoundError("404", response=response)
        copy = tmp_path / "cache" / repository
        for name in allow_patterns:
            if (root / repository / name).is_file():
                (copy / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(root / repository / name, copy / name)
        copy.mkdir(parents=True, exist_ok=True)
        return str(copy)

    monkeypatch.setattr(huggingface_hub, "HfApi", Api)
    monkeypatch.setattr(huggingface_hub, "snapshot_download", snapshot)
    return root


def test_what_is_pushed_is_loaded_by_name(
    server: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "mine"
    shutil.copytree(OPEN_SMALL, folder)
    (folder / "checkpoints").mkdir()
    (folder / "checkpoints" / "large.pt").write_text("stays here")
    assert main(["models", "push", str(folder), "somebody/mine"]) == 0
    assert "--pretrained somebody/mine" in capsys.readouterr().out
    there = {str(p.relative_to(server / "somebody/mine")) for p in server.rglob("*") if p.is_file()}
    assert there == {"README.md", *(name for name in hub.FILES if (folder / name).is_file())}
    talker = Talker.from_pretrained("somebody/mine", device="cpu")
    assert talker.emotions == Talker.from_pretrained("open-small", device="cpu").emotions
    found = find_weights("somebody/mine")
    for name in ("talker.json", "stm/model.safetensors"):
        assert (found / name).read_bytes() == (OPEN_SMALL / name).read_bytes()


def test_the_card_says_what_the_weights_are() -> None:
    card = hub.model_card(OPEN_SMALL, "somebody/mine", "cc-by-4.0")
    header, body = card.split("---\n")[1:]
    assert "license: cc-by-4.0" in header and "library_name: freetalk" in header
    assert 'from_pretrained("somebody/mine")' in body and "contempt" in body
    assert [line.split(" | ")[0] for line in body.splitlines() if line.startswith("| s")] == [
        "| stage", "| speech", "| stm"
    ]  # fmt: skip
    assert "relative_error" in body  # a validation's score


def test_what_the_hub_lacks_is_named(server: Path, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"no public repository nobody/nothing"):
        find_weights("nobody/nothing")
    (server / "somebody" / "else").mkdir(parents=True)
    with pytest.raises(RuntimeError, match=r"somebody/else holds no weights of freetalk"):
        find_weights("somebody/else")
    shutil.copytree(OPEN_SMALL / "stm", tmp_path / "half" / "stm")
    with pytest.raises(ValueError, match="lacks speech, ats"):
        hub.push(tmp_path / "half", "somebody/half")
    with pytest.raises(ValueError, match="give OWNER/NAME"):
        hub.push(OPEN_SMALL, "half")
