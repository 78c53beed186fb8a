"""Layers that know no task: networks on surfaces, sparse products."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import torch

from freetalk import _native
from freetalk._module import NativeModule

DiffusionNetOptions = _native.nn.DiffusionNetOptions
JacobianFieldOptions = _native.nn.JacobianFieldOptions
PoissonNetOptions = _native.nn.PoissonNetOptions
VertexMlpOptions = _native.nn.VertexMlpOptions
band_mask = _native.nn.band_mask
sinusoidal_code = _native.nn.sinusoidal_code
sparse_product = _native.nn.sparse_product

SurfaceOperators = _native.geometry.SurfaceOperators
FaceOperators = _native.geometry.FaceOperators


class _SurfaceNet(NativeModule):
    """A network from values at the vertices to values on the same surface."""

    def forward(self, x: torch.Tensor, operators: SurfaceOperators) -> torch.Tensor:
        """Values on the surface.

        Args:
            x: (B, V, in_channels) float, values at the vertices.
            operators: of one mesh with V vertices, in x's dtype; or of several meshes laid one after
                the other (``freetalk.geometry.concatenate``), V vertices together.

        Returns:
            (B, V, out_channels).

        Raises:
            ValueError: x does not fit the options or the operators.
        """
        return self._impl.forward(x, operators)


class DiffusionNet(_SurfaceNet):
    """DiffusionNet [Sharp et al. 2022] over many frames of one mesh or several meshes at once.

    Names and outputs equal the public ``diffusion_net`` package's; its ``outputs_at`` gives (B, E, C)
    at the edges of ``freetalk.geometry.unique_edges``, (B, F, C) at faces or (B, meshes, C) for the
    mass-weighted mean.

    Args:
        options: a ``DiffusionNetOptions``, or its fields by keyword.
    """

    _impl_type = _native.nn.DiffusionNetImpl
    _options_type = DiffusionNetOptions
    _format = "freetalk-diffusion-net"

    @classmethod
    def from_public_checkpoint(
        cls, path: str | os.PathLike[str], *, prefix: str = "", **fields: Any
    ) -> DiffusionNet:
        """Loads a ``.pth`` file of the public ``diffusion_net`` package; widths are read off it.

        Args:
            path: a ``torch.save``-d state dict; nothing but tensors is unpickled.
            prefix: what stands before the names, such as ``"feature_extractor."``.
            fields: options that a state dict does not tell, such as ``outputs_at="faces"``.

        Raises:
            ValueError: the file holds no DiffusionNet under ``prefix``.
            RuntimeError: tensors do not fit.
        """
        saved = torch.load(path, map_location="cpu", weights_only=True)
        state = {
            name[len(prefix) :]: tensor for name, tensor in saved.items() if name.startswith(prefix)
        }
        if "first_lin.weight" not in state:
            raise ValueError(
                f"{path}: no tensor {prefix}first_lin.weight; its names begin with "
                f"{', '.join(sorted({str(name).split('.')[0] for name in saved}))}"
            )
        module = cls(**{**_public_options(state), **fields})
        module.load_state_dict(state)
        return module.eval()


def _public_options(state: Mapping[str, torch.Tensor]) -> dict[str, Any]:
    """Options that the shapes of a public DiffusionNet's tensors tell."""
    width, channels = state["first_lin.weight"].shape
    layers = sorted(
        name for name in state if name.startswith("block_0.mlp.") and name.endswith(".weight")
    )
    return {
        "in_channels": channels,
        "width": width,
        "out_channels": state["last_lin.weight"].shape[0],
        "num_blocks": sum(name.endswith("diffusion.diffusion_time") for name in state),
        "mlp_hidden": [state[name].shape[0] for name in layers[:-1]],
        "with_gradient_features": any("gradient_features" in name for name in state),
        "with_gradient_rotations": any("gradient_features.A_re" in name for name in state),
        "dropout": 0.5,
    }


class PoissonNet(_SurfaceNet):
    """PoissonNet [Maesumi et al. 2025]: blocks of gradients, complex layers and a Poisson solve.

    Names equal the public package's with the head ``linear``. Solves run in double on the CPU.

    Args:
        options: a ``PoissonNetOptions``, or its fields by keyword.
    """

    _impl_type = _native.nn.PoissonNetImpl
    _options_type = PoissonNetOptions
    _format = "freetalk-poisson-net"


class JacobianField(_SurfaceNet):
    """Neural Jacobian Fields [Aigerman et al. 2022]: Jacobians at the faces, integrated to (B, V, 3).

    Args:
        options: a ``JacobianFieldOptions``, or its fields by keyword.
    """

    _impl_type = _native.nn.JacobianFieldImpl
    _options_type = JacobianFieldOptions
    _format = "freetalk-jacobian-field"


class VertexMlp(_SurfaceNet):
    """A multi-layer perceptron at every vertex by itself.

    Args:
        options: a ``VertexMlpOptions``, or its fields by keyword.
    """

    _impl_type = _native.nn.VertexMlpImpl
    _options_type = VertexMlpOptions
    _format = "freetalk-vertex-mlp"


def face_gradients(faces: FaceOperators, x: torch.Tensor) -> torch.Tensor:
    """Gradients (B, 2F, C) on the faces of values (B, V, C) at the vertices: X components, then Y."""
    return _native.nn.face_gradients(faces, x)


def face_divergence(faces: FaceOperators, g: torch.Tensor) -> torch.Tensor:
    """Weak divergence (B, V, C) of a field (B, 2F, C) on the faces: G^T A g."""
    return _native.nn.face_divergence(faces, g)


def poisson_solve(
    faces: FaceOperators, rhs: torch.Tensor, *, regularization: float = 1e-6
) -> torch.Tensor:
    """Solves (G^T A G + regularization I) u = rhs for all columns at once; differentiable.

    Args:
        faces: ``SurfaceOperators.faces()``; the system is factored once, when first solved.
        rhs: (B, V, C) float; solved in double on the CPU.
        regularization: > 0, since the Laplacian alone is singular.

    Returns:
        (B, V, C) of rhs's dtype, on its device.
    """
    return _native.nn.poisson_solve(faces, rhs, regularization=regularization)


def integrate_jacobians(faces: FaceOperators, jacobians: torch.Tensor) -> torch.Tensor:
    """The map (B, V, 3) whose gradients come closest to Jacobians (B, F, 3, 3), each part centred."""
    return _native.nn.integrate_jacobians(faces, jacobians)


__all__ = [
    "DiffusionNet",
    "DiffusionNetOptions",
    "JacobianField",
    "JacobianFieldOptions",
    "PoissonNet",
    "PoissonNetOptions",
    "VertexMlp",
    "VertexMlpOptions",
    "band_mask",
    "face_divergence",
    "face_gradients",
    "integrate_jacobians",
    "poisson_solve",
    "sinusoidal_code",
    "sparse_product",
]
