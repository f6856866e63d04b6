"""What the kernel does besides rendering, in PyTorch: for tensors on a device, which the kernel can't reach.

Each function is the twin of one of the kernel and gives the same numbers but for rounding.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.optim.adam import adam

from rasterizer.camera import Camera
from rasterizer.gaussians import SH_LAYOUTS
from rasterizer.reference.loss import photometric_terms
from rasterizer.reference.sh import sh_basis


def is_on_device(tensor: Tensor) -> bool:
    """Whether the kernel can't reach its memory."""
    return tensor.device.type != "cpu"


def all_finite(tensors: Sequence[Tensor]) -> bool:
    return not tensors or bool(torch.stack([torch.isfinite(tensor).all() for tensor in tensors]).all())


def accumulate(
    seen: tuple[Tensor, Tensor, Tensor],  # visible, mean2d, mean_t of a ViewGradient
    sums: tuple[Tensor, Tensor, Tensor],  # space, time, views
    camera: Camera,
    duration: float,
) -> None:
    """As ViewGradient.accumulate."""
    visible, mean2d, mean_t = seen
    space, time, views = sums
    rows = visible.long()
    to_ndc = mean2d.new_tensor([0.5 * camera.width, 0.5 * camera.height])
    space.index_add_(0, rows, (mean2d * to_ndc).norm(dim=1))
    time.index_add_(0, rows, mean_t.abs() * duration)
    views.index_add_(0, rows, torch.ones_like(mean_t))


def sh_gradient(views: Sequence[tuple[Tensor, Tensor, int, int, bool]], out: Tensor) -> Tensor:
    """The dense gradient of the SH coefficients, (N, (n+1)(l+1)², 3), written into `out`. views: ViewColors' fields."""
    coefficients, orders = SH_LAYOUTS[out.shape[1]]
    by_order = out.zero_().unflatten(1, (orders, coefficients))
    for visible, gradient, sh_degree, fourier_order, wrong_line in views:
        basis = sh_basis(gradient[:, 3:6], sh_degree)
        if wrong_line and sh_degree > 0:
            basis[:, 1] = basis[:, 0]
        cosines = torch.cat([torch.ones_like(basis[:, :1]), gradient[:, 6 : 6 + fourier_order]], dim=1)
        product = torch.einsum("vf,vb,vc->vfbc", cosines, basis, gradient[:, :3])
        by_order[:, : product.shape[1], : product.shape[2]].index_add_(0, visible.long(), product)
    return out


def adam_step(
    param: Tensor,
    grad: Tensor,
    m: Tensor,
    v: Tensor,
    rate: float | Tensor,  # of all, or what broadcasts to param
    step: int,
    sparse_rows: Tensor | None,
    beta1: float,
    beta2: float,
    epsilon: float,
) -> None:
    """One step of PyTorch's fused Adam, in place; rows with sparse_rows (N,) 0 are unchanged, moments included.

    Its rate is one number, and its step proportional to it: the step of rate 1 is scaled.
    """
    rows = None if sparse_rows is None else sparse_rows.nonzero().squeeze(1)
    grad, first, second = (tensor if rows is None else tensor[rows] for tensor in (grad, m, v))
    change, counted = torch.zeros_like(grad), torch.full((), float(step - 1), device=param.device)
    adam([change], [grad], [first], [second], [], [counted], fused=True, amsgrad=False, maximize=False,
         lr=1.0, beta1=beta1, beta2=beta2, eps=epsilon, weight_decay=0.0)  # fmt: skip
    change *= rate
    if rows is None:
        param += change
        return
    param.index_add_(0, rows, change)
    m[rows], v[rows] = first, second


def photometric_loss(
    image: Tensor, target: Tensor, ssim_weight: float, mse_weight: float, share: float
) -> tuple[float, float, float, Tensor]:
    """(L1, SSIM, MSE, share × ∂loss/∂image) of images (3, H, W)."""
    with torch.enable_grad():
        leaf = image.detach().requires_grad_()
        terms = torch.stack(photometric_terms(leaf, target))
        weights = terms.new_tensor([1 - ssim_weight, -ssim_weight, mse_weight])
        (gradient,) = torch.autograd.grad(share * (weights * terms).sum(), leaf)
    l1, ssim, mse = terms.detach().cpu().tolist()
    return l1, ssim, mse, gradient
