"""The fast decoder of many frames against the differentiable one."""

from __future__ import annotations

import pytest
import torch
from test_stm_ablations import SHIPPED, SMALL, landmarks_of, moving, prepared

from freetalk.stm import Stm


def both(model: Stm, rows: int, columns: int, frames: int, **options: object) -> tuple:
    positions, operators = prepared(model.options, rows, columns)
    landmarks = landmarks_of(frames)
    with torch.no_grad():
        mesh = model.encode(positions, operators)
        exact = model.decode(mesh, operators, landmarks)
    return exact, model.frame_decoder(mesh, operators, **options).decode(landmarks)


@pytest.mark.parametrize(("rows", "columns"), [(9, 7), (12, 8), (12, 16), (14, 14)])
@pytest.mark.parametrize("width", [16, 40])
def test_float32_equals_the_differentiable_decoder(rows: int, columns: int, width: int) -> None:
    """Below, at and above whole tiles of rows, widths that do not fill a vector; sums in another order."""
    torch.manual_seed(0)
    model = moving(Stm(**{**SMALL, "decoder_width": width, "decoder_blocks": 2, "k_eig": 11}))
    exact, fast = both(model, rows, columns, 5)
    assert (fast - exact).abs().max() <= 1e-5 * exact.abs().max()


def test_bfloat16_of_the_shipped_weights_errs_by_less_than_a_hundredth_of_the_motion() -> None:
    exact, fast = both(Stm.from_pretrained(SHIPPED), 14, 13, 8, precision="bfloat16")
    error, motion = (fast - exact).norm(dim=-1).mean(), exact.norm(dim=-1).mean()
    assert error <= 0.01 * motion


@pytest.mark.parametrize(("precision", "share"), [("float32", 1e-5), ("bfloat16", 4e-3)])
def test_chunks_do_not_change_a_frame(precision: str, share: float) -> None:
    """Landmark features of other batches differ in their last bit, which bfloat16 may round apart (2^-8)."""
    torch.manual_seed(0)
    model = moving(Stm(**SMALL))
    _, whole = both(model, 9, 7, 13, precision=precision)
    _, parts = both(model, 9, 7, 13, precision=precision, memory_bytes=1)
    assert (whole - parts).abs().max() <= share * whole.abs().max()


def test_other_decoders_go_through_the_same_door() -> None:
    torch.manual_seed(0)
    for decoder in ("mlp", "njf"):
        exact, fast = both(moving(Stm(**SMALL, decoder=decoder)), 9, 7, 5, memory_bytes=1 << 20)
        assert (fast - exact).abs().max() <= 1e-5 * exact.abs().max()


def test_an_unknown_precision_is_refused() -> None:
    with pytest.raises(ValueError, match="float32 or bfloat16"):
        both(Stm(**SMALL), 9, 7, 1, precision="half")
