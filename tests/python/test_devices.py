"""Every network, sampler and training task on a pretended device: nothing of the host gets in its way.

The device refuses tensors of the host among its own and notes waits (see ``device_mode``); its numbers must be those
of the host, up to the order of sums: the host takes its own faster ways.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from accelerate.utils import send_to_device
from device_mode import DEVICE, DeviceMode, DeviceTensor, MixedDevicesError, on_host
from mini_corpus import write_mini_corpus
from test_autocast import KINDS, SMALL, away_from_zero
from test_nn_diffusion_net import wavy_grid
from torch import Tensor, nn

from freetalk.ats import Ats, GenerateOptions, generate
from freetalk.data import open_dataset
from freetalk.facetalk import FaceTalk
from freetalk.facetalk import GenerateOptions as CodeOptions
from freetalk.facetalk import generate as generate_codes
from freetalk.geometry import concatenate, surface_operators
from freetalk.nn import DiffusionNet, PoissonNet
from freetalk.speech import FeatureAdapter, SpeechEncoder, encode_speech
from freetalk.stm import Stm
from freetalk.train import load_config

CONFIGS = Path(__file__).parents[2] / "configs"
ENCODER: dict[str, Any] = {
    "conv_dim": [16] * 7,
    "hidden_size": 32,
    "num_hidden_layers": 2,
    "num_attention_heads": 4,
    "intermediate_size": 64,
    "num_conv_pos_embeddings": 16,
    "num_conv_pos_embedding_groups": 4,
}
#: Solves of sparse systems run on the host, there and back; all else stays on the device.
SOLVERS = ("poissonnet", "njf")


@pytest.fixture
def mode() -> Iterator[DeviceMode]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # the mode looks at every operation, one at a time
    with DeviceMode() as mode:
        yield mode
    torch.set_num_threads(threads)


def on_device(mode: DeviceMode, network: Any) -> Any:
    """The same network, made on the device."""
    with mode.building():
        twin = type(network)(copy.deepcopy(network.options))
    copy_state(network, twin)
    mode.forget()
    return twin.train(network.training)


def copy_state(network: nn.Module, twin: nn.Module) -> None:
    with torch.no_grad():
        for (name, there), here in zip(
            twin.state_dict().items(), network.state_dict().values(), strict=True
        ):
            assert isinstance(there, DeviceTensor), name
            there.copy_(here)


def assert_same(found: Tensor, expected: Tensor, atol: float = 1e-5) -> None:
    """1e-5: float32 sums of about a thousand terms in another order."""
    assert isinstance(found, DeviceTensor)
    scale = max(1.0, float(expected.detach().abs().max()))
    torch.testing.assert_close(on_host(found), expected.detach(), atol=atol * scale, rtol=1e-4)


def assert_same_training(
    ours: nn.Module, twin: nn.Module, run: Callable[[nn.Module, torch.device], Tensor]
) -> None:
    """Outputs and the gradients of all parameters."""
    torch.manual_seed(7)
    expected = run(ours, torch.device("cpu"))
    weight = torch.randn_like(expected)
    (expected * weight).sum().backward()  # type: ignore[no-untyped-call]
    found = run(twin, DEVICE)
    assert_same(found, expected)
    (found * weight.to(DEVICE)).sum().backward()  # type: ignore[no-untyped-call]
    for (name, a), b in zip(ours.named_parameters(), twin.parameters(), strict=True):
        assert (a.grad is None) == (b.grad is None), name
        if a.grad is not None:
            assert b.grad is not None
            assert_same(b.grad, a.grad, 1e-4)  # sums over the batch, too


def test_a_tensor_of_the_host_is_found(mode: DeviceMode) -> None:
    """In Python, within a native network, and as its input."""
    x = torch.ones(3, 2).to(DEVICE)
    with pytest.raises(MixedDevicesError):
        x + torch.ones(2)
    with pytest.raises(MixedDevicesError):
        torch.zeros(3, 2).add_(x)
    assert on_host(x * torch.tensor(2.0)).sum() == 12  # scalars are fine, as on CUDA
    net = on_device(mode, DiffusionNet(in_channels=2, out_channels=1, width=4, num_blocks=1))
    operators = surface_operators(*wavy_grid(4, 3), k=6, cache=False).to(torch.float32)
    values = torch.randn(1, 12, 2)
    net(values.to(DEVICE), operators.to(torch.float32, DEVICE))
    with pytest.raises(MixedDevicesError):
        net(values.to(DEVICE), operators)
    with pytest.raises(MixedDevicesError):
        net(values, operators.to(torch.float32, DEVICE))


def test_a_wait_is_noticed(mode: DeviceMode) -> None:
    x = torch.arange(4.0).to(DEVICE)
    assert mode.uploads == 1 and not mode.waits
    for wait in (lambda: x.sum().item(), lambda: x.cpu(), lambda: x.nonzero(), lambda: x[x > 1]):
        mode.forget()
        wait()
        assert mode.waits


# ATS


def small_ats(**options: Any) -> Ats:
    torch.manual_seed(0)
    model = Ats(
        d_model=32, num_layers=2, num_heads=2, ff_dim=32, audio_dim=12, max_frames=20, **options
    )
    model.set_motion_statistics(torch.zeros(204), torch.full((204,), 2e-3))
    return model.eval()


@pytest.mark.parametrize("options", [{}, {"band_radius": 2, "norm_first": True}])
def test_ats_denoises_and_learns_on_the_device(mode: DeviceMode, options: dict[str, Any]) -> None:
    model = small_ats(**options)
    emotions = len(model.options.emotions)
    valid = torch.ones(2, 15, dtype=torch.bool)
    valid[1, 9:] = False
    inputs = {
        "audio": torch.randn(2, 15, 12),
        "emotion": torch.eye(emotions)[:2],
        "intensity": torch.tensor([1.0, 2.5]),
        "valid": valid,
        "drop_audio": torch.tensor([True, False]),
        "drop_affect": torch.tensor([False, True]),
    }
    x, step = torch.randn(2, 15, 204), torch.tensor([3, 500])

    def run(model: nn.Module, device: torch.device) -> Tensor:
        result: Tensor = model(
            x.to(device), step.to(device), **{k: v.to(device) for k, v in inputs.items()}
        )
        return result

    assert_same_training(model, on_device(mode, model), run)
    assert not mode.waits


SAMPLERS: list[dict[str, Any]] = [
    {"sampler": "ddim"},
    {"sampler": "ddim", "eta": 1.0},
    {"sampler": "ddpm"},
    {"sampler": "dpmpp"},
    {"sampler": "ddim", "audio_guidance": 1.5, "affect_guidance": 2.0},
    {"sampler": "ddim", "mouth_temperature": 0.5, "windows_per_batch": 2},
]


@pytest.mark.parametrize("options", SAMPLERS, ids=lambda o: "-".join(map(str, o.values())))
@pytest.mark.parametrize("frames", [15, 70])
def test_sampling_never_waits_for_the_device(
    mode: DeviceMode, options: dict[str, Any], frames: int
) -> None:
    """From a group of windows' first step to its last: no wait and no copy from the host."""
    model = small_ats()
    twin = on_device(mode, model)
    features = torch.randn(frames, 12)
    emotions = torch.eye(len(model.options.emotions))[:2]
    weight = torch.linspace(0, 1, frames)
    felt = {
        "emotion": emotions,
        "intensity": torch.tensor([1.0, 2.0]),
        "weight": torch.stack([1 - weight, weight], 1),
    }
    steps: list[tuple[int, int]] = []

    def run(model: Ats, features: Tensor) -> Tensor:
        steps.clear()
        return generate(
            model,
            features,
            **felt,
            options=GenerateOptions(**{"num_steps": 4, "window_overlap": 5, **options}),
            seed=[3, 4],
            on_step=lambda done, total: steps.append((len(mode.waits), mode.uploads)),
        )

    expected = run(model, features)
    found = run(twin, features.to(DEVICE))
    assert_same(found, expected)
    for first in range(0, len(steps), 4):
        assert len(set(steps[first : first + 4])) == 1, f"waits and uploads by step: {steps}"


# STM


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: "-".join(kind.values()) or "all")
def test_stm_decodes_and_learns_on_the_device(mode: DeviceMode, kind: dict[str, str]) -> None:
    torch.manual_seed(0)
    model = Stm(**SMALL, **kind)
    away_from_zero(model)
    twin = on_device(mode, model)
    vertices, faces = wavy_grid(8, 7)
    exact = surface_operators(vertices, faces, k=12, cache=False)
    operators = {place: exact.to(torch.float32, place) for place in (torch.device("cpu"), DEVICE)}
    positions = torch.from_numpy(vertices * model.options.length_scale).float()
    landmarks = 0.002 * torch.randn(5, 68, 3)

    def run(model: nn.Module, device: torch.device) -> Tensor:
        result: Tensor = 1000 * model(positions.to(device), operators[device], landmarks.to(device))
        return result

    mode.forget()
    assert_same_training(model, twin, run)
    assert not mode.waits or any(name in SOLVERS for name in kind.values())

    with torch.no_grad():
        mesh = twin.encode(positions.to(DEVICE), operators[DEVICE])
        decoder = twin.frame_decoder(mesh, operators[DEVICE], memory_bytes=1)
        found = decoder.decode(landmarks.to(DEVICE))
        assert_same(
            1000 * found, 1000 * model(positions, operators[torch.device("cpu")], landmarks)
        )
        if model.options.fusion != "concat":
            attention = twin.attention(mesh, landmarks.to(DEVICE))
            assert_same(attention.sum(-1), torch.ones(attention.shape[:-1]))


@pytest.mark.parametrize(
    "kind", [{}, {"outputs_at": "global_mean"}, {"diffusion_method": "implicit_dense"}]
)
def test_batches_of_meshes_are_laid_out_and_used_on_the_device(
    mode: DeviceMode, kind: dict[str, str]
) -> None:
    parts = [surface_operators(*wavy_grid(n, 5), k=8, cache=False) for n in (4, 6)]
    net = DiffusionNet(in_channels=3, out_channels=2, width=8, num_blocks=2, **kind)
    away_from_zero(net)
    x = torch.randn(2, 50, 3)
    batch = concatenate([part.to(torch.float32) for part in parts])
    there = [part.to(torch.float32, DEVICE) for part in parts]
    mode.forget()
    on_gpu = concatenate(there)
    assert not mode.waits
    operators = {torch.device("cpu"): batch, DEVICE: on_gpu}
    assert_same_training(
        net, on_device(mode, net), lambda net, device: net(x.to(device), operators[device])
    )


def test_poisson_net_learns_on_batches_on_the_device(mode: DeviceMode) -> None:
    parts = [surface_operators(*wavy_grid(n, 5), k=8, cache=False) for n in (4, 6)]
    net = PoissonNet(in_channels=3, out_channels=2, width=8, num_blocks=2)
    away_from_zero(net)
    x = torch.randn(2, 50, 3)
    operators = {
        place: concatenate([part.to(torch.float32, place) for part in parts])
        for place in (torch.device("cpu"), DEVICE)
    }
    assert_same_training(
        net, on_device(mode, net), lambda net, device: net(x.to(device), operators[device])
    )


# Speech


FORMS: list[dict[str, Any]] = [
    {},  # HuBERT and wav2vec 2.0 base
    {"feat_extract_norm": "layer", "do_stable_layer_norm": True, "conv_bias": True},  # large
]


@pytest.mark.parametrize("form", FORMS, ids=["base", "large"])
def test_speech_encoders_hear_and_learn_on_the_device(
    mode: DeviceMode, form: dict[str, Any]
) -> None:
    torch.manual_seed(0)
    encoder = SpeechEncoder(**ENCODER, **form).eval()
    twin = on_device(mode, encoder)
    wave = torch.randn(2, 8000)
    mask = torch.ones(2, 8000, dtype=torch.long)
    mask[1, 6000:] = 0

    def run(encoder: nn.Module, device: torch.device) -> Tensor:
        states = encoder.hidden_states(wave.to(device), mask.to(device))  # type: ignore[operator]
        rows = [state[0] for state in states] + [state[1, :18] for state in states]
        return torch.cat([row.flatten() for row in rows])

    assert_same_training(encoder, twin, run)
    whole = encode_speech(encoder, wave[0], fps=25)
    assert_same(encode_speech(twin, wave[0].to(DEVICE), fps=25), whole, 1e-4)


@pytest.mark.parametrize("resample", ["output", "conv"])
@pytest.mark.parametrize("layer", [1, "weighted"])
def test_feature_adapters_learn_on_the_device(
    mode: DeviceMode, resample: str, layer: int | str
) -> None:
    torch.manual_seed(0)
    encoder = SpeechEncoder(**ENCODER)
    options: dict[str, Any] = {"layer": layer, "resample": resample, "train": "transformer"}
    ours = FeatureAdapter(encoder, 25.0, **options).eval()
    twin = on_device(mode, encoder)
    with mode.building():
        theirs = FeatureAdapter(twin, 25.0, **options).eval()
    wave = torch.randn(2, 8000)
    assert_same_training(ours, theirs, lambda adapter, device: adapter(wave.to(device), 12))


# FaceTalk


@pytest.mark.parametrize("condition", ["film", "squeeze_excite", "dot_product"])
def test_facetalk_denoises_learns_and_speaks_on_the_device(
    mode: DeviceMode, condition: str
) -> None:
    torch.manual_seed(0)
    model = FaceTalk(
        code_dim=6,
        audio_dim=12,
        d_model=16,
        num_layers=2,
        num_heads=2,
        ff_dim=24,
        window=4,
        time_condition=condition,
    ).eval()
    twin = on_device(mode, model)
    x, audio, step = torch.randn(2, 9, 6), torch.randn(2, 9, 12), torch.tensor([3, 500])
    dropped = torch.tensor([True, False])

    def run(model: nn.Module, device: torch.device) -> Tensor:
        result: Tensor = model(
            x.to(device), step.to(device), audio=audio.to(device), drop_audio=dropped.to(device)
        )
        return result

    assert_same_training(model, twin, run)
    assert not mode.waits
    options = {"num_steps": 3, "audio_guidance": 1.5, "piece_frames": 5, "temperature": 0.0}
    sampling = CodeOptions(**options)
    expected = generate_codes(model, audio[0], options=sampling)
    steps: list[int] = []
    found = generate_codes(
        twin,
        audio[0].to(DEVICE),
        options=sampling,
        on_step=lambda done, total: steps.append(len(mode.waits)),
    )
    assert_same(found, expected)
    assert steps[0] == steps[-1]  # from the first step to the last nothing waited


# Training


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mini_corpus(tmp_path_factory.mktemp("devices") / "corpus")


def both_tasks(
    kind: str, corpus: Path, out: Path, mode: DeviceMode, monkeypatch: pytest.MonkeyPatch
) -> tuple[Any, Any]:
    """A task on the host and the same one on the device."""
    from freetalk.train import ats as ats_task
    from freetalk.train import facetalk as facetalk_task
    from freetalk.train import stm as stm_task

    config = load_config(kind, CONFIGS / f"{kind}_smoke.yaml", ["loop.device=cpu"])
    make = {
        "ats": ats_task.AtsTask,
        "stm": stm_task.StmTask,
        "facetalk": facetalk_task.FaceTalkTask,
    }[kind]
    room, name = {
        "ats": (ats_task, "Ats"),
        "stm": (stm_task, "Stm"),
        "facetalk": (facetalk_task, "FaceTalk"),
    }[kind]
    host = make(config, open_dataset(corpus), out, torch.device("cpu"))
    original = getattr(room, name)

    def made_there(options: Any) -> Any:
        with mode.building():
            return original(options)

    monkeypatch.setattr(room, name, made_there)
    device = make(config, open_dataset(corpus), out, DEVICE)
    copy_state(host.model, device.model)
    return host, device


@pytest.mark.parametrize("kind", ["ats", "stm", "facetalk"])
def test_training_tasks_run_on_the_device(
    kind: str,
    corpus: Path,
    tmp_path: Path,
    mode: DeviceMode,
    monkeypatch: pytest.MonkeyPatch,
    own_cache: None,
) -> None:
    """The loss of a batch and its gradient, and the validation's scores."""
    host, device = both_tasks(kind, corpus, tmp_path, mode, monkeypatch)
    items = [host.item(np.random.default_rng(seed), seed) for seed in range(2)]
    batch = host.collate(items)
    host.model.eval(), device.model.eval()
    generator = torch.Generator().manual_seed(0)
    expected = host.loss(batch, generator)
    expected["loss"].backward()
    found = device.loss(send_to_device(batch, DEVICE), generator)
    found["loss"].backward()
    for name, value in expected.items():
        assert_same(found[name], value, 1e-4)
    for ours, theirs in zip(host.model.parameters(), device.model.parameters(), strict=True):
        if ours.grad is not None:
            assert_same(theirs.grad, ours.grad, 1e-3)
    with torch.no_grad():
        scores, ours = (task.scores([r for _, r in task.validate(0, 1)]) for task in (device, host))
    assert scores == pytest.approx(ours, rel=1e-2, abs=1e-4)
