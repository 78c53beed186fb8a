"""A rig of the shipped weights, and decoding few frames, against decoding every frame."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest
import torch
from test_stm_ablations import SHIPPED

import freetalk
from freetalk.corpus.assets import load_expression_take, load_face_model, speech_clip
from freetalk.corpus.topologies import crop, decimate
from freetalk.geometry import surface_operators
from freetalk.rig import FaceRig, RigPoses, SolveState
from freetalk.stm import FrameDecoder, Stm, decode_adaptively

POSES = Path(SHIPPED).parent / "rig_poses.safetensors"


@pytest.fixture(scope="module")
def decoder() -> FrameDecoder:
    """The shipped STM on a face of about 900 vertices."""
    model = load_face_model()
    mesh = decimate(model, crop(model, "face"), 900)
    vertices = mesh.carry @ model.neutral.astype(np.float64)
    stm = Stm.from_pretrained(SHIPPED).eval()
    operators = surface_operators(
        vertices / stm.options.length_scale, mesh.faces, k=stm.options.k_eig, cache=False
    ).to(dtype=torch.float32)
    with torch.no_grad():
        features = stm.encode(torch.from_numpy(vertices).float(), operators)
    return stm.frame_decoder(features, operators)


@pytest.fixture(scope="module")
def rig(decoder: FrameDecoder) -> FaceRig:
    return FaceRig.build(decoder.decode, POSES)


@pytest.fixture(scope="module")
def motion() -> torch.Tensor:
    """Mixtures of poses of the library that move smoothly through it, (90, 68, 3): speech it holds no frame of."""
    library = RigPoses.load(str(POSES)).library[:12].numpy()
    time = np.linspace(0, 3, 90)
    weights = np.stack(
        [np.square(np.sin(1.7 * time * (1 + k / 5) + k)) for k in range(len(library))], 1
    )
    weights /= weights.sum(1, keepdims=True)
    return torch.from_numpy(np.einsum("tp,plc->tlc", weights, library)).float()


def test_the_first_names_are_arkits(rig: FaceRig) -> None:
    _, captured, _ = load_expression_take()
    arkit = {name[0].lower() + name[1:] for name in captured} - {"tongueOut"}
    assert set(rig.names[:51]) == arkit
    assert all(name.startswith("corrective_") for name in rig.names[51:])


def test_the_rig_plays_what_stm_decodes(
    rig: FaceRig, decoder: FrameDecoder, motion: torch.Tensor
) -> None:
    """The figures that a rig is made for: 0.2 mm in the mean, 0.6 mm for all but a hundredth."""
    error = 1e3 * (rig.vertices(rig.solve(motion)) - decoder.decode(motion)).norm(dim=-1)
    assert error.mean() <= 0.2
    assert np.quantile(error.numpy(), 0.99) <= 0.6


def test_weights_and_targets_add_up_to_the_vertices(rig: FaceRig, motion: torch.Tensor) -> None:
    weights = rig.solve(motion[:7])
    assert weights.min() >= 0 and weights.max() <= 1
    summed = torch.einsum("tw,wvc->tvc", weights.double(), rig.targets.double())
    # Sums of about a hundred terms of a few centimetres in float32.
    assert (rig.vertices(weights) - summed).abs().max() <= 1e-7


def test_a_shape_alone_is_told_by_its_name(rig: FaceRig) -> None:
    poses = RigPoses.load(str(POSES))
    index = poses.names.index("jawOpen")
    curves = rig.curves(rig.solve(0.7 * poses.shapes[index : index + 1]))
    # The terms that keep weights small and even cost a tenth at most.
    assert curves["jawOpen"][0] == pytest.approx(0.7, abs=0.07)
    assert set(curves) == set(poses.names)


def test_a_stream_weighs_as_the_whole(rig: FaceRig, motion: torch.Tensor) -> None:
    state = SolveState()
    parts = [rig.solve(part, state) for part in motion[:20].split(3)]
    assert torch.equal(torch.cat(parts), rig.solve(motion[:20]))


def test_several_threads_solve_at_once(rig: FaceRig, motion: torch.Tensor) -> None:
    wanted = rig.vertices(rig.solve(motion[:20]))
    results: dict[int, torch.Tensor] = {}

    def work(index: int) -> None:
        results[index] = rig.vertices(rig.solve(motion[:20]))

    threads = [threading.Thread(target=work, args=(index,)) for index in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 4
    assert all(torch.equal(result, wanted) for result in results.values())


def test_a_rig_comes_back_from_its_file(rig: FaceRig, motion: torch.Tensor, tmp_path: Path) -> None:
    rig.save(tmp_path / "rig.safetensors")
    read = FaceRig.load(tmp_path / "rig.safetensors")
    assert torch.equal(read.solve(motion[:5]), rig.solve(motion[:5]))
    assert read.options == rig.options


def test_files_that_are_no_rig_are_named(tmp_path: Path) -> None:
    with pytest.raises(
        RuntimeError, match=r"rig_poses\.safetensors: expected freetalk-rig version"
    ):
        FaceRig.load(POSES)
    with pytest.raises(RuntimeError, match="missing"):
        FaceRig.load(tmp_path / "missing.safetensors")


def test_an_exception_in_progress_stops_the_build(decoder: FrameDecoder) -> None:
    def stop(share: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        FaceRig.build(decoder.decode, POSES, progress=stop, num_poses=0)


def test_few_frames_stay_within_the_tolerances(decoder: FrameDecoder, motion: torch.Tensor) -> None:
    exact = decoder.decode(motion)
    few, report = decode_adaptively(decoder, motion)
    error = (few - exact).norm(dim=-1)
    assert report.decoded < report.frames
    assert error.mean() <= 0.005 * exact.norm(dim=-1).mean()
    assert 1e3 * error.max() <= 0.2


def test_no_tolerance_decodes_every_frame(decoder: FrameDecoder, motion: torch.Tensor) -> None:
    few, report = decode_adaptively(decoder, motion[:40], tolerance_mm=0)
    assert torch.equal(few, decoder.decode(motion[:40]))
    assert report.decoded == 40


def test_tolerances_out_of_range_are_refused(decoder: FrameDecoder, motion: torch.Tensor) -> None:
    with pytest.raises(ValueError, match="tolerance_mm must not be negative"):
        decode_adaptively(decoder, motion, tolerance_mm=-1)
    with pytest.raises(ValueError, match="landmarks must be"):
        decode_adaptively(decoder, motion[0])


def test_live_frames_of_the_rig_are_close_to_those_that_stm_decodes() -> None:
    model = load_face_model()
    small = decimate(model, crop(model, "face"), 900)
    vertices = small.carry @ model.neutral.astype(np.float64)
    mesh = freetalk.Mesh(vertices, small.faces.tolist(), name="small")
    face = freetalk.Talker.from_pretrained("open-small").prepare(
        mesh, unit="m", up="+y", forward="+z", cache_dir=None, progress=False
    )
    wave = np.array(freetalk.load_audio(speech_clip()).samples)[:32000]
    decoded = []
    for through_rig in (True, False):
        live = face.live(emotion="happy", rig=through_rig)
        frames = live.push(wave) + live.finish()
        assert (frames[0].weights is not None) == through_rig
        decoded.append(torch.stack([live.decode(frame) for frame in frames]))
        if through_rig:
            weights = torch.stack([frame.weights for frame in frames])
            assert weights.shape == (60, len(face.rig().names))
            assert weights.min() >= 0 and weights.max() <= 1
    error_mm = 1e3 * (decoded[0] - decoded[1]).norm(dim=-1)
    assert error_mm.mean() <= 0.2 and error_mm.flatten().quantile(0.99) <= 0.6  # a rig's targets
