"""Any set of datasets trains each stage, with its own meshes and frame rates."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from dataset_layouts import packed, write_folder
from mini_corpus import write_mini_corpus

from freetalk import _native
from freetalk.ats import Ats
from freetalk.cli.app import main
from freetalk.data import open_datasets
from freetalk.train.config import load_config
from freetalk.train.run import make_task, run
from freetalk.train.stm_cuts import FaceCuts
from freetalk.train.stm_meshes import PreparedFaces, PreparedMesh, prepare_mesh
from freetalk.train.stm_windows import FaceWindows

pytestmark = pytest.mark.usefixtures("own_cache")
CONFIGS = Path(__file__).resolve().parents[2] / "configs"
QUICK = ["loop.threads=1", "loop.max_steps=2", "loop.validate_every=0", "loop.ema_decay=0"]
STM = [*QUICK, "task.source_weights=null", "task.num_meshes=0"]


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mini_corpus(tmp_path_factory.mktemp("mixed") / "corpus")


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of one's own at 25 fps, where the corpus has 30."""
    return packed(write_folder(tmp_path_factory.mktemp("own") / "own", frames=50, fps=25))


@pytest.fixture(scope="module")
def sparse(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return packed(write_folder(tmp_path_factory.mktemp("sparse") / "sparse", sparse=True))


def finite(directory: Path) -> bool:
    tensors = _native.core.load_safetensors(str(directory / "model.safetensors"))
    return all(bool(torch.isfinite(t).all()) for t in tensors.values())


def test_the_audio_stage_trains_on_a_mixture(
    corpus: Path, own: Path, sparse: Path, tmp_path: Path
) -> None:
    data = [f"OPEN={corpus}", f"OWN={own}", f"MARKS={sparse}"]
    shares = "task.source_weights={OPEN/synthetic: 0.4, OWN: 0.3, MARKS: 0.3}"
    plain = "task.feature_augmentations=0"
    options = [*QUICK, plain, shares]
    with pytest.raises(ValueError, match=r"MARKS, OPEN/synthetic: 30; OWN: 25.*model\.fps=RATE"):
        run("ats", CONFIGS / "ats_smoke.yaml", options, data, tmp_path)
    result = run("ats", CONFIGS / "ats_smoke.yaml", [*options, "model.fps=30"], data, tmp_path)
    assert result.step == 2
    assert finite(tmp_path / "ats")
    config = json.loads((tmp_path / "ats" / "config.json").read_text())
    parts = config["training"]["data"]["datasets"]
    assert {name: part["fps"] for name, part in parts.items()} == {
        "OPEN": 30.0, "OWN": 25.0, "MARKS": 30.0,
    }  # fmt: skip
    assert (config["fps"], config["options"]["fps"]) == (30.0, 30.0)
    assert parts["OWN"]["landmarks"]["count"] == 68
    record = json.loads((tmp_path / "run_ats.json").read_text())
    assert record["data"] == data


def test_a_model_of_25_fps_data_says_so(own: Path, tmp_path: Path) -> None:
    options = [*QUICK, "task.feature_augmentations=0"]
    run("ats", CONFIGS / "ats_smoke.yaml", options, own, tmp_path)
    assert Ats.from_pretrained(tmp_path / "ats").options.fps == 25.0


@pytest.mark.parametrize("rate", [25.0, 30.0])
def test_motion_and_features_come_at_the_models_frame_rate(
    corpus: Path, own: Path, tmp_path: Path, rate: float
) -> None:
    overrides = [
        *QUICK,
        f"model.fps={rate}",
        "task.feature_augmentations=0",
        "task.source_weights={OPEN/synthetic: 1, OWN: 1}",
    ]
    config = load_config("ats", CONFIGS / "ats_smoke.yaml", overrides)
    mixed = open_datasets([f"OPEN={corpus}", f"OWN={own}"])
    task = make_task(config, mixed, tmp_path, torch.device("cpu"))
    for sequence in task.sampler.sequences:
        (copy,) = task.features.copies(sequence)
        seconds = len(task.corpus.audio(sequence)) / 16000
        assert abs(copy.num_frames - seconds * rate) <= 1
        assert copy.num_frames <= sequence.num_frames == len(task.corpus.landmarks(sequence))
        assert sequence.fps == rate
    rng = np.random.default_rng(0)
    drawn = [task.item(rng, number) for number in range(8)]
    assert all(np.isfinite(item["motion"]).all() for item in drawn)
    assert {len(item["audio"]) - len(item["motion"]) for item in drawn} == {0}


@pytest.mark.parametrize("names", [("OWN",), ("OPEN", "OWN")])
def test_the_mesh_stage_trains_on_registered_and_open_faces(
    corpus: Path, own: Path, tmp_path: Path, names: tuple[str, ...]
) -> None:
    folders = {"OPEN": corpus, "OWN": own}
    data = [f"{name}={folders[name]}" for name in names]
    overrides = [*STM, "loop.batch_size=3", f"task.operator_cache={tmp_path / 'operators'}"]
    if len(names) == 2:
        overrides[4] = "task.source_weights={OPEN/facegood: 0.3, OWN: 0.4, random: 0.3}"
    result = run("stm", CONFIGS / "stm_smoke.yaml", overrides, data, tmp_path / "out")
    assert result.step == 2
    assert finite(tmp_path / "out" / "stm")
    assert np.isfinite(result.scores["relative_error"])


def test_a_sequence_moves_the_face_it_was_recorded_on(
    corpus: Path, own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mixed = open_datasets([f"OPEN={corpus}", f"OWN={own}"])
    prepare = partial(prepare_mesh, mixed, length_scale=0.1, k_eig=8)
    meshes = PreparedFaces(mixed, "train", 0, 0, prepare)
    assert {face.dataset for face in meshes.faces} == {"OPEN", "OWN"}
    windows = FaceWindows(
        mixed, meshes.faces, "train", {"OPEN/facegood": 1, "OWN": 1, "random": 1}, 4
    )
    rng = np.random.default_rng(0)
    datasets = []
    for _ in range(40):
        window = windows.draw(rng)
        mesh = meshes[window.mesh]
        assert window.target.shape == (4, len(mesh.positions), 3)
        assert window.landmarks.shape == (4, 68, 3)
        datasets.append(mesh.face.dataset)
        if mesh.face.dataset == "OWN":  # its landmarks are vertices of the very face
            marks = mixed.mesh(mesh.face.identity, mesh.face.topology).landmarks
            # Vertices are float16: half a unit of the last of 11 digits of 6 mm.
            np.testing.assert_allclose(window.target[:, marks], window.landmarks, atol=2e-6)
    assert 5 < datasets.count("OWN") < 25
    for index, mesh in enumerate(meshes):
        assert windows.first_on(index).dataset == mesh.face.dataset
        assert len(windows.draw_on(index, rng).target[0]) == len(mesh.positions)
    own_alone = [face for face in meshes.faces if face.dataset == "OWN"]
    capsys.readouterr()
    alone = FaceWindows(mixed, own_alone, "train", {"random": 1.0}, 4)
    assert "no source random here" in capsys.readouterr().err
    assert {own_alone[alone.draw(rng).mesh].dataset for _ in range(8)} == {"OWN"}


def test_faces_beyond_the_memory_come_again_from_the_folder(
    corpus: Path, own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mixed = open_datasets([f"OPEN={corpus}", f"OWN={own}"])
    made: list[int] = []

    def prepare(identity: int, topology: str, index: int) -> PreparedMesh:
        made.append(index)
        cuts = FaceCuts(0.5, 0.1, 8)
        return prepare_mesh(mixed, identity, topology, 0.1, 8, tmp_path, cuts=cuts, index=index)

    whole = PreparedFaces(mixed, "train", 0, 0, prepare)
    assert all(whole[at].face is whole.faces[at] for at in range(5))
    assert made == list(range(5)) == list(range(len(whole)))
    assert whole[0].num_bytes > whole[0].operators.evecs.nbytes + whole[0].operators.frames.nbytes
    monkeypatch.setattr(PreparedMesh, "num_bytes", 10)
    two = PreparedFaces(mixed, "train", 0, 0, prepare, most_bytes=20)
    made.clear()
    drawn = [4, 3, 0, 3, 4, 2, 1]
    for at in drawn:
        again, first = two[at], whole[at]
        assert torch.equal(again.positions, first.positions)
        assert torch.equal(again.operators.evecs, first.operators.evecs)
        assert np.array_equal(again.face.kept, first.face.kept)
    assert made == [0, 4, 2, 1]  # 4 was asked for longest ago when 0 came, then 3 stayed
    with pytest.raises(IndexError):
        two[5]


def test_the_mesh_stage_learns_the_same_in_little_memory(corpus: Path, tmp_path: Path) -> None:
    learnt = []
    for room in ("0", "1e-6"):
        options = [*STM, "loop.batch_size=3", f"task.operator_memory_gb={room}"]
        out = tmp_path / room
        run("stm", CONFIGS / "stm_smoke.yaml", options, corpus, out)
        learnt.append(_native.core.load_safetensors(str(out / "stm" / "model.safetensors")))
    assert all(torch.equal(learnt[1][name], value) for name, value in learnt[0].items())


def test_what_cannot_train_is_said_before_it_starts(
    own: Path, sparse: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(kind: str, *arguments: str) -> str:
        config = str(CONFIGS / f"{kind}_smoke.yaml")
        command = ["train", kind, "--config", config, "--out", str(tmp_path / "out")]
        assert main([*command, *arguments]) == 2
        return capsys.readouterr().err

    assert "no faces or no meshings" in fails("stm", "--data", str(sparse), "task.num_meshes=0")
    assert "no folder" in fails("ats", "--data", str(own), "--data", "MEAD=/nowhere/mead")
    (tmp_path / "empty").mkdir()
    assert "no known dataset" in fails("ats", "--data", str(tmp_path / "empty"))
