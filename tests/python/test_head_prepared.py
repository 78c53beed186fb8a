"""A head made ready for one identity equals the module it was made of."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from test_head import queries, tiny

from freetalk.head import HeadOptions, ParametricHead, PreparedHead, nphm_small_options


def heads() -> list[dict[str, Any]]:
    return [
        {},
        {"min_weight": 0.0},
        {"direction": "forward"},
        {"direction": "both", "background": "outside"},
        {"identity_sees": "hyper"},
        {"identity_sees": "expression"},
        {"normalizer_eps": 1e-14},
    ]


@pytest.mark.parametrize("fields", heads(), ids=str)
def test_prepared_heads_equal_their_module(fields: dict[str, Any]) -> None:
    """Rounding of float32 in another order, and softplus to 3e-9; more where a root is sought."""
    head = tiny(**fields).eval()
    with torch.no_grad():
        for name, parameter in head.named_parameters():
            if name.startswith("deformation_"):
                parameter.mul_(0.7)
    points, z_id, z_exp = queries(head, 1, 700)
    prepared = PreparedHead(head, z_id[0])
    with torch.no_grad():
        expected = head(points, z_id, z_exp)[0]
        posed = head.to_posed(points, z_id, z_exp)[0]
    torch.testing.assert_close(prepared.anchors, head.anchors(z_id)[0])
    torch.testing.assert_close(prepared.sdf(points[0], z_exp[0]), expected, atol=2e-5, rtol=0)
    torch.testing.assert_close(prepared.to_posed(points[0], z_exp[0]), posed, atol=2e-5, rtol=0)


def test_unfaded_fields_have_the_same_sign_and_do_not_fade() -> None:
    head = tiny().eval()
    points, z_id, _ = queries(head, 1, 500)
    prepared = PreparedHead(head, z_id[0])
    far = 3 * points[0]
    faded = prepared.canonical_sdf(far)
    whole = prepared.canonical_sdf(far, fade=False)
    sure = faded.abs() > 1e-9
    assert bool((faded.sign() == whole.sign())[sure].all())
    assert float(whole.abs().median()) > 10 * float(faded.abs().median())


@pytest.mark.parametrize("options", [nphm_small_options(), HeadOptions()], ids=["small", "paper"])
def test_bfloat16_is_off_by_hundredths_of_a_millimetre(options: HeadOptions) -> None:
    """Eight bits of hidden channels; a head's offsets and distances are some centimetres."""
    torch.manual_seed(0)
    head = ParametricHead(options).eval()
    z_id = 0.05 * torch.randn(head.identity_dim)
    z_exp = 0.05 * torch.randn(options.expression_dim)
    points = torch.rand(300, 3) - 0.5
    exact, rounded = (
        PreparedHead(head, z_id, precision=precision).sdf(points, z_exp)
        for precision in ("float32", "bfloat16")
    )
    assert float((exact - rounded).abs().max()) < 4 * 2e-4  # head units in 0.2 mm


def test_results_do_not_depend_on_threads() -> None:
    head = tiny().eval()
    points, z_id, z_exp = queries(head, 1, 9000)
    prepared = PreparedHead(head, z_id[0])
    before = torch.get_num_threads()
    try:
        results = []
        for threads in (1, 2):
            torch.set_num_threads(threads)
            results.append(prepared.sdf(points[0], z_exp[0]))
    finally:
        torch.set_num_threads(before)
    assert torch.equal(*results)


def test_codes_that_do_not_fit_are_refused() -> None:
    head = tiny().eval()
    points, z_id, z_exp = queries(head, 1)
    with pytest.raises(ValueError, match="z_id"):
        PreparedHead(head, z_id[0, 1:])
    with pytest.raises(ValueError, match="finite"):
        PreparedHead(head, z_id[0] * float("nan"))
    with pytest.raises(ValueError, match="finite"):
        PreparedHead(head, z_id[0]).sdf(points[0], z_exp[0] * float("inf"))
    with pytest.raises(ValueError, match="precision"):
        PreparedHead(head, z_id[0], precision="float16")
