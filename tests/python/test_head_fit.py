"""Codes found from points of a head's own surface, and meshes that codes move."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from test_head import tiny
from torch import Tensor

from freetalk._pretrained import find_weights
from freetalk.corpus.assets import EXTENTS, load_face_model
from freetalk.head import (
    Codes,
    FitOptions,
    ParametricHead,
    PreparedHead,
    SmoothingOptions,
    TrackOptions,
    canonical_template,
    fit_expressions,
    fit_identity,
    load_codes,
    save_codes,
    smoothing_weights,
    track,
)

RADIUS = 0.25  # head units


def ball(direction: str = "both", coefficients: int = 0, weights: int = 0) -> ParametricHead:
    """A head that is nearly a ball: its field is trained to be one, and codes move it a little."""
    head = tiny(
        direction=direction,
        normalizer_eps=1e-14,
        num_coefficients=coefficients,
        num_weights=weights,
        kernel_width=0.15,
        identity_hidden=32,
    )
    torch.manual_seed(1)
    adam = torch.optim.Adam(
        [p for name, p in head.named_parameters() if name.startswith("identity.")], 3e-3
    )
    for _ in range(150):
        points = torch.rand(1, 400, 3) - 0.5
        z_id = 0.3 * torch.randn(1, head.identity_dim)
        wanted = points.norm(dim=2) - RADIUS * (1 + 0.1 * z_id[:, :1].tanh())
        loss = (head.canonical_sdf(points, z_id) - wanted).abs().mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
    with torch.no_grad():
        for name, parameter in head.named_parameters():
            if name.startswith("deformation_") and "lin4" in name:
                parameter.mul_(0.3)
    return head.eval()


def surface_points(head: ParametricHead, z_id: Tensor, z_exp: Tensor, count: int = 600) -> Tensor:
    """Points of the posed surface in metres: projected along the field's gradient."""
    generator = torch.Generator().manual_seed(3)
    x = torch.randn(1, count, 3, generator=generator)
    x = RADIUS * x / x.norm(dim=2, keepdim=True)
    for _ in range(20):
        x = x.detach().requires_grad_()
        s = head(x, z_id[None], z_exp[None])
        (gradient,) = torch.autograd.grad(s.sum(), x)
        x = x - s.detach()[..., None] * gradient / gradient.square().sum(2, keepdim=True)
    return x.detach()[0] / head.options.units_per_metre


@pytest.fixture(scope="module")
def trained() -> ParametricHead:
    return ball()


def codes(head: ParametricHead, frames: int) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(5)
    z_id = 0.3 * torch.randn(head.identity_dim, generator=generator)
    z_exp = torch.randn(frames, head.options.expression_dim, generator=generator)
    return z_id, 0.3 * z_exp.cumsum(0)


def test_gauss_newton_finds_surfaces_that_adam_comes_near_to(trained: ParametricHead) -> None:
    z_id, z_exp = codes(trained, 3)
    points = [surface_points(trained, z_id, own) for own in z_exp]
    fit = fit_expressions(
        trained, z_id, points, options=FitOptions(prior=1e-6, temporal=1e-6, points=300)
    )
    start = fit_expressions(
        trained, z_id, points, options=FitOptions(prior=1e6, temporal=0.0, iterations=1)
    )
    slow = fit_expressions(
        trained,
        z_id,
        points,
        options=FitOptions(
            method="adam", adam_iterations=60, adam_points=300, learning_rate=0.02, window=3
        ),
    )
    assert float(fit.error_mm.max()) < 0.02
    assert float(fit.error_mm.mean()) < 0.1 * float(start.error_mm.mean())
    assert float(slow.error_mm.mean()) < float(start.error_mm.mean())
    assert float(fit.error_mm.mean()) <= float(slow.error_mm.mean())


def test_neighbours_are_solved_together(trained: ParametricHead) -> None:
    """A strong temporal term makes one code of all frames; the chain equals a dense solve's fixed point."""
    z_id, z_exp = codes(trained, 4)
    points = [surface_points(trained, z_id, own, 200) for own in z_exp]
    apart = fit_expressions(
        trained, z_id, points, options=FitOptions(prior=1e-6, temporal=0.0, points=0)
    )
    together = fit_expressions(
        trained, z_id, points, options=FitOptions(prior=1e-6, temporal=1e6, points=0)
    )
    spread = float(together.z_exp.std(0).max())
    assert spread < 1e-2 * float(apart.z_exp.std(0).max())
    assert float(together.error_mm.mean()) > float(apart.error_mm.mean())


def test_codes_that_no_expression_has_follow_noise_less() -> None:
    """Where a head maps weights to codes, scans' noise moves codes along those expressions alone."""
    head = ball(weights=2)
    z_id = 0.3 * torch.randn(head.identity_dim, generator=torch.Generator().manual_seed(5))
    with torch.no_grad():
        z_exp = head.expression_code(torch.tensor([[0.6, 0.2]]))[0]
        ways = head.expression_code(torch.eye(2)) - head.expression_code(torch.zeros(1, 2))
    points = surface_points(head, z_id, z_exp, 200)
    noise = 1e-3 * torch.randn(points.shape, generator=torch.Generator().manual_seed(6))
    clean, noisy = (
        fit_expressions(head, z_id, [own], options=FitOptions(prior=1e-2, points=0)).z_exp[0]
        for own in (points, points + noise)
    )
    change = noisy - clean
    along = torch.linalg.lstsq(ways.T, change[:, None]).solution[:, 0] @ ways
    assert float(along.norm()) > 0
    assert float((change - along).norm()) < 0.5 * float(along.norm())


def test_outliers_do_not_move_a_fit(trained: ParametricHead) -> None:
    z_id, z_exp = codes(trained, 1)
    points = surface_points(trained, z_id, z_exp[0])
    stray = torch.cat([points, points[:60] + 0.02])
    options = FitOptions(prior=1e-6, points=0, huber_mm=0.1, iterations=20)
    clean = fit_expressions(trained, z_id, [points], options=options)
    fit = fit_expressions(trained, z_id, [stray], options=options)
    with torch.no_grad():
        distance = trained(points[None] * 4, z_id[None], fit.z_exp)
    assert float(distance.abs().mean()) / 4 * 1e3 < 0.1
    assert float(clean.error_mm) < 0.02


@pytest.mark.parametrize("coefficients", [0, 6])
def test_identities_are_found(coefficients: int) -> None:
    head = ball(coefficients=coefficients)
    generator = torch.Generator().manual_seed(7)
    if coefficients:
        z_id = head.identity_code(torch.randn(1, coefficients, generator=generator))[0].detach()
    else:
        z_id = 0.3 * torch.randn(head.identity_dim, generator=generator)
    z_exp = head.state_dict()["rest_expression"]
    points = surface_points(head, z_id, z_exp, 400)
    fit = fit_identity(head, [points], options=FitOptions(points=0, iterations=15))
    start = fit_identity(head, [points], options=FitOptions(prior=1e6, points=0, iterations=1))
    assert fit.z_id.shape == (head.identity_dim,)
    assert float(fit.error_mm) < 0.1 * float(start.error_mm)


@pytest.mark.slow
def test_an_unseen_identity_is_found_by_the_shipped_head() -> None:
    """Identity and expression weigh alike: neither runs away to explain what is the other's."""
    head = ParametricHead.from_pretrained(find_weights("open-small") / "head").eval()
    model, count = load_face_model(), EXTENTS["head"]
    weights = 0.8 * np.random.default_rng(3).standard_normal(len(model.identity_basis))
    vertices = model.neutral[:count] + np.tensordot(weights, model.identity_basis[:, :count], 1)
    marks = vertices[model.landmarks68]
    face = np.linalg.norm(vertices[:, None] - marks, axis=2).min(axis=1) < 0.03
    fit = fit_identity(head, [vertices], options=FitOptions(points=1500))
    rest = head.state_dict()["rest_expression"]
    points = torch.as_tensor(4 * vertices[face], dtype=torch.float32)
    apart_mm = 250 * PreparedHead(head, fit.z_id).sdf(points, rest).abs()
    assert float(apart_mm.mean()) < 1.0
    assert float(fit.error_mm) < 1.0


def test_frames_without_points_are_refused(trained: ParametricHead) -> None:
    z_id, _ = codes(trained, 1)
    with pytest.raises(ValueError, match="frame 1"):
        fit_expressions(trained, z_id, [torch.rand(5, 3), torch.zeros(0, 3)])
    with pytest.raises(ValueError, match="finite"):
        fit_expressions(trained, z_id, [torch.full((5, 3), float("nan"))])
    with pytest.raises(ValueError, match="z_id"):
        fit_expressions(trained, z_id[1:], [torch.rand(5, 3)])
    with pytest.raises(ValueError, match="method"):
        FitOptions(method="newton")


def test_tracking_is_the_forward_network_in_metres(trained: ParametricHead) -> None:
    z_id, z_exp = codes(trained, 3)
    head = PreparedHead(trained, z_id)
    template = 0.05 * torch.randn(50, 3)
    seen = []
    frames = track(head, template, z_exp, on_frame=lambda done, of: seen.append((done, of)))
    with torch.no_grad():
        expected = trained.to_posed(4 * template[None].expand(3, -1, -1), z_id.expand(3, -1), z_exp)
    torch.testing.assert_close(frames, expected / 4, atol=1e-5, rtol=0)
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_newton_steps_bring_refined_vertices_to_the_backward_networks_own(
    trained: ParametricHead,
) -> None:
    """to_canonical of a refined vertex is its template point; of another it is not."""
    z_id, z_exp = codes(trained, 1)
    head = PreparedHead(trained, z_id)
    template = 0.05 * torch.randn(40, 3)
    refined = np.arange(0, 40, 2)
    frames = track(
        head,
        template,
        z_exp,
        refined=refined,
        options=TrackOptions(newton_steps=3, largest_step_mm=100.0),
    )
    residual = (head.to_canonical(4 * frames[0], z_exp[0]) - 4 * template).norm(dim=1)
    assert float(residual[refined].median()) < 0.1 * float(residual[1::2].median())
    with pytest.raises(ValueError, match="refined"):
        track(head, template, z_exp, refined=[40])


def test_a_template_of_a_posed_mesh_is_that_mesh_in_canonical_space(
    trained: ParametricHead,
) -> None:
    z_id, z_exp = codes(trained, 1)
    head = PreparedHead(trained, z_id)
    mesh = surface_points(trained, z_id, z_exp[0], 80)
    template = canonical_template(head, mesh, z_exp[0])
    moved = head.to_canonical(4 * mesh, z_exp[0]) / 4
    torch.testing.assert_close(template, moved)
    rest = canonical_template(head, mesh)
    torch.testing.assert_close(
        rest, head.to_canonical(4 * mesh, trained.state_dict()["rest_expression"]) / 4
    )


@pytest.mark.parametrize("mode", ["rest", "published"])
def test_smoothing_keeps_the_face_and_fades_beyond(trained: ParametricHead, mode: str) -> None:
    z_id, z_exp = codes(trained, 1)
    head = PreparedHead(trained, z_id)
    options = SmoothingOptions(mode=mode, center=[0.0, 0.0, 0.0], sigma=[0.1, 0.1, 0.1])
    near_and_far = torch.tensor([[0.0, 0, 0], [0.5, 0.5, 0.3]])
    weights = smoothing_weights(head, near_and_far, options)
    assert float(weights[0]) == pytest.approx(1.0, abs=1e-6)
    assert float(weights[1]) < 1e-3
    moved = track(head, near_and_far / 4, z_exp, smoothing=options)[0]
    free = track(head, near_and_far / 4, z_exp)[0]
    torch.testing.assert_close(moved[0], free[0])
    still = (
        near_and_far[1] / 4
        if mode == "published"
        else track(head, near_and_far / 4, trained.state_dict()["rest_expression"][None])[0, 1]
    )
    torch.testing.assert_close(moved[1], still, atol=1e-4, rtol=0)


def test_codes_know_their_head(trained: ParametricHead, tmp_path: Path) -> None:
    z_id, z_exp = codes(trained, 2)
    save_codes(tmp_path / "codes.npz", trained, Codes(z_id, z_exp, 24.0))
    found = load_codes(tmp_path / "codes.npz", trained)
    assert torch.equal(found.z_id, z_id) and torch.equal(found.z_exp, z_exp) and found.fps == 24
    with pytest.raises(ValueError, match="of the head"):
        load_codes(tmp_path / "codes.npz", tiny(direction="both"))
    save_codes(tmp_path / "nan.npz", trained, Codes(z_id, z_exp * float("nan"), 24.0))
    with pytest.raises(ValueError, match="finite"):
        load_codes(tmp_path / "nan.npz", trained)
    (tmp_path / "text.npz").write_text("none")
    with pytest.raises(RuntimeError, match=r"text\.npz"):
        load_codes(tmp_path / "text.npz", trained)
