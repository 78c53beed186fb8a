"""Files are replaced whole, whoever else writes them."""

from __future__ import annotations

from pathlib import Path

import pytest

from freetalk._files import beside, replacing


def test_one_process_gets_other_names_each_time(tmp_path: Path) -> None:
    # containers that share a folder repeat the numbers of processes and threads: neither may tell apart
    names = {beside(tmp_path / "index.json") for _ in range(100)}
    assert len(names) == 100
    assert {(name.parent, name.suffix, name.name[0]) for name in names} == {
        (tmp_path, ".json", ".")
    }


def test_a_writer_that_fails_leaves_the_old_file_alone(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "index.json"
    with replacing(path) as temporary:
        temporary.write_text("old")
    with pytest.raises(RuntimeError, match="stop"), replacing(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError("stop")
    assert path.read_text() == "old"
    assert list(path.parent.iterdir()) == [path]
