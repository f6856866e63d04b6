""".splat of antimatter15/splat: 32 bytes a Gaussian, no header, colours of 8 bits, no spherical harmonics."""

from __future__ import annotations

import numpy as np
import torch

from pipeline.export.frame import colours, unit_quaternions
from pipeline.model.model import Model

ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])


def splat_bytes(model: Model) -> bytes:
    """The file of a static model. Rows are sorted by size × opacity, so that a page shows the largest first."""
    p = model.parameters
    alpha = torch.sigmoid(p["opacity_logit"].double())
    order = torch.argsort(-alpha * p["log_scale"].double().sum(dim=1).exp(), stable=True)
    rows = np.zeros(len(model), ROW)
    rows["mean"] = p["mean"][order]
    rows["scale"] = p["log_scale"][order].double().exp()
    rgba = torch.cat([colours(p["sh"].double()), alpha[:, None]], dim=1)[order]
    rows["rgba"] = np.round(255 * rgba.numpy())
    rows["quat"] = np.clip(np.round(128 + 128 * unit_quaternions(p["quat_left"])[order].numpy()), 0, 255)
    return rows.tobytes()
