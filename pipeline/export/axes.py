"""Formats of OpenGL's axes: y and z have the other sign than in 3DGS's files (right, down, forward)."""

from __future__ import annotations

import torch

from pipeline.model.model import Model

FLIPPED_AXES = (1.0, -1.0, -1.0)
FLIPPED_QUAT = (1.0, 1.0, -1.0, -1.0)  # wxyz of F R F, with F = diag(1, -1, -1); F R F and F R have one covariance
# Y_lm(x, -y, -z) / Y_lm(x, y, z), by the polynomials of rasterizer/reference/sh.py.
FLIPPED_SH = (1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1)


def flipped(model: Model) -> Model:
    """A static model in axes rotated by 180° about x; its own inverse."""
    p = model.parameters
    signs = torch.tensor(FLIPPED_SH[: p["sh"].shape[1]], dtype=torch.float32)
    changed = {
        "mean": p["mean"] * torch.tensor(FLIPPED_AXES),
        "quat_left": p["quat_left"] * torch.tensor(FLIPPED_QUAT),
        "sh": p["sh"] * signs[:, None],
    }
    return Model(model.kind, p | changed)
