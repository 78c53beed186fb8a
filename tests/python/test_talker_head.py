"""A parametric head that speaks: by itself, and fitted to a mesh."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.io import wavfile
from test_head import tiny
from test_head_fit import ball

import freetalk
from freetalk._pretrained import find_weights
from freetalk.cli import main
from freetalk.corpus.assets import load_face_model, mean_face
from freetalk.head import Codes, ParametricHead, PreparedHead, extract, save_codes
from freetalk.mesh import Mesh

#: Some of ICT-FaceKit's, one of which ARKit does not split.
NAMES = ["browInnerUp_L", "browInnerUp_R", "jawOpen", "mouthSmile_L", "mouthSmile_R"]


@pytest.fixture(scope="module")
def head() -> ParametricHead:
    trained = ball(coefficients=4)
    options = trained.options
    options.box_min, options.box_max = [-0.4] * 3, [0.4] * 3  # where it was trained to be a ball
    options.num_weights, options.expressions = len(NAMES), NAMES
    torch.manual_seed(4)
    model = ParametricHead(options).eval()
    state = {k: v for k, v in trained.state_dict().items() if k != "canonical_weights"}
    missing, unexpected = model.load_state_dict(state, strict=False)
    assert not unexpected and all(
        name.startswith(("expression_map", "canonical")) for name in missing
    )
    return model


@pytest.fixture(scope="module")
def weights(head: ParametricHead, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("weights") / "with_head"
    shutil.copytree(find_weights("open-small"), folder)
    head.save_pretrained(folder / "head")
    return folder


@pytest.fixture(scope="module")
def talker(weights: Path) -> freetalk.Talker:
    return freetalk.Talker.from_pretrained(weights, device="cpu")


@pytest.fixture(scope="module")
def voice(tmp_path_factory: pytest.TempPathFactory) -> Path:
    time = np.arange(16000) / 16000
    samples = 0.3 * np.sin(2 * np.pi * 150 * time) * (0.6 + 0.4 * np.sin(20 * time))
    path = tmp_path_factory.mktemp("voice") / "hum.wav"
    wavfile.write(path, 16000, samples.astype(np.float32))
    return path


@pytest.mark.slow
def test_an_identity_speaks_on_its_own_surface(
    talker: freetalk.Talker, head: ParametricHead, voice: Path
) -> None:
    z_id = talker.sample_identity(3)
    assert torch.equal(z_id, head.sample_identity(1, seed=3)[0])
    face = talker.prepare_head(z_id, progress=False)
    prepared = PreparedHead(head, z_id)
    own = extract(prepared, torch.zeros(5), options=_coarse())
    assert np.array_equal(face.mesh.faces, own.faces)
    rest = head.state_dict()["rest_expression"]
    posed = prepared.to_posed(torch.from_numpy(4 * own.vertices).float(), rest) / 4
    assert np.allclose(face.mesh.vertices, posed.numpy(), atol=1e-6)
    assert face.report.alignment.unit == "m"
    animation = face.animate(voice, progress=False)
    moved = np.asarray(animation.displacements)
    assert moved.shape == (30, len(own.vertices), 3) and np.isfinite(moved).all()
    assert np.abs(moved).max() > 1e-5
    other = talker.prepare_head(talker.sample_identity(4), progress=False)
    assert len(other.mesh.vertices) != len(face.mesh.vertices)


@pytest.mark.slow
def test_the_motion_is_the_deformation_of_solved_weights(
    talker: freetalk.Talker, head: ParametricHead, voice: Path
) -> None:
    """The rig of such a face: its target of a shape is the head's deformation by that weight alone."""
    z_id = talker.sample_identity(3)
    face = talker.prepare_head(z_id, progress=False, cache_dir=None)
    rig = face.rig(progress=False)
    own = extract(PreparedHead(head, z_id), torch.zeros(5), options=_coarse())
    points = torch.from_numpy(4 * own.vertices).float()
    weights = torch.zeros((1, 5))
    weights[0, NAMES.index("mouthSmile_L")] = 1.0
    rest = head.state_dict()["rest_expression"]
    prepared = PreparedHead(head, z_id)
    wanted = prepared.to_posed(points, head.expression_code(weights)[0]) - prepared.to_posed(
        points, rest
    )
    still = prepared.to_posed(points, head.expression_code(torch.zeros((1, 5)))[0])
    still = still - prepared.to_posed(points, rest)
    target = torch.as_tensor(rig.targets)[rig.names.index("mouthSmileLeft")]
    # The solver finds nearly, not exactly, weight one; the shapes that it lets take part move the head too.
    found = target.flatten() @ (wanted - still).flatten()
    found = found / (target.norm() * (wanted - still).norm())
    assert found > 0.8


@pytest.mark.slow
def test_a_mesh_is_moved_by_the_head_that_fits_it(
    talker: freetalk.Talker, head: ParametricHead, voice: Path
) -> None:
    z_id = talker.sample_identity(5)
    surface = extract(
        PreparedHead(head, z_id), head.state_dict()["rest_expression"], options=_coarse()
    )
    mesh = Mesh(surface.vertices, surface.faces.tolist())
    face = talker.prepare(
        mesh, engine="head", unit="m", up="+y", forward="+z", progress=False, cache_dir=None
    )
    assert "a head was fitted" in face.report.parts
    assert face.options.engine == "head"
    moved = np.asarray(face.animate(voice, progress=False).displacements)
    assert moved.shape[1:] == surface.vertices.shape
    assert np.isfinite(moved).all() and np.abs(moved).max() > 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False])
def test_the_lips_of_a_mesh_open_as_far_as_the_motion_says(voice: Path, known: bool) -> None:
    """Lips that touch at rest are one place to the head's field; the mesh knows which is which."""
    model = load_face_model()
    vertices, faces = mean_face("face")
    talker = freetalk.Talker.from_pretrained("open-small", device="cpu")
    face = talker.prepare(
        Mesh(vertices, faces.tolist()),
        engine="head",
        landmarks=model.landmarks68 if known else None,
        unit="m",
        up="+y",
        forward="+z",
        progress=False,
        cache_dir=None,
    )
    animation = face.animate(voice, emotion="surprised", intensity=3, progress=False)
    said = _opening_mm(np.asarray(animation.landmarks))
    made = _opening_mm(np.asarray(animation.displacements)[:, model.landmarks68])
    wide = said > 3
    assert wide.sum() >= 5
    assert np.abs(made[wide] / said[wide] - 1).max() < 0.1
    silent = freetalk.Audio(np.zeros(8000, np.float32), 16000)
    still = np.asarray(face.animate(silent, progress=False).displacements)
    gap = _opening_mm((vertices + still)[:, model.landmarks68])
    assert np.abs(gap).max() < 0.5 < _opening_mm(vertices[None, model.landmarks68])[0]


@pytest.mark.slow
def test_one_command(weights: Path, head: ParametricHead, voice: Path, tmp_path: Path) -> None:
    common = ["animate", "--pretrained", str(weights), "--engine", "head", "--audio", str(voice)]
    out = tmp_path / "talk.npz"
    assert main([*common, "--identity", "sample:7", "--out", str(out), "--quiet"]) == 0
    sampled = np.load(out)
    with torch.no_grad():
        z_id = head.sample_identity(1, seed=7)[0]
    save_codes(tmp_path / "codes.npz", head, Codes(z_id, torch.zeros((1, 5)), 24.0))
    again = tmp_path / "again.npz"
    identity = str(tmp_path / "codes.npz")
    assert main([*common, "--identity", identity, "--out", str(again), "--quiet"]) == 0
    assert np.array_equal(sampled["displacements"], np.load(again)["displacements"])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--identity", "sample:7"], "use it with --engine head"),
        (["--engine", "head", "--identity", "sample:x"], "expected sample:N"),
        (["--engine", "head", "--identity", "nobody"], "expected sample:N"),
        (["--engine", "head", "--identity", "gone.npz"], "gone.npz"),
    ],
)
def test_what_is_no_identity(
    given: list[str],
    said: str,
    voice: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "a.npz"
    assert main(["animate", "--audio", str(voice), "--out", str(out), *given]) == 2
    assert said in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.slow
def test_a_folder_without_what_a_head_needs_is_refused(
    weights: Path, tmp_path: Path, talker: freetalk.Talker
) -> None:
    bare = tmp_path / "bare"
    shutil.copytree(weights, bare)
    shutil.rmtree(bare / "head")
    with pytest.raises(ValueError, match="hold no head/"):
        freetalk.Talker.from_pretrained(bare).sample_identity(0)
    tiny(num_weights=3).save_pretrained(bare / "head")
    nameless = freetalk.Talker.from_pretrained(bare)
    with pytest.raises(RuntimeError, match="names no expressions"):
        nameless.prepare_head(nameless.sample_identity(0), progress=False)
    with pytest.raises(ValueError, match="engine must be stm or head"):
        talker.prepare(Mesh(np.eye(3), [[0, 1, 2]]), engine="other", progress=False)


def _opening_mm(moved: np.ndarray) -> np.ndarray:
    """(T,) of the inner lips, mean of three pairs. Args: moved: (T, 68, 3) m."""
    pairs = moved[:, [61, 62, 63], 1] - moved[:, [67, 66, 65], 1]
    return np.asarray(1e3 * pairs.mean(axis=1))


def _coarse() -> freetalk.head.SurfaceOptions:
    from freetalk.talker import HEAD_RESOLUTION

    return freetalk.head.SurfaceOptions(resolution=HEAD_RESOLUTION)
