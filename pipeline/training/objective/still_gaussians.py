"""Long-lived Gaussians stand still: a constraint on the rotation, not in the paper.

What a Gaussian shows for most of the duration is background or a resting object. Its velocity fits the noise of single
views. 3D-4DGS (Oh et al., 2025) turns such Gaussians into static ones for good; here one that comes to live shorter may
move again.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F

from pipeline.model.model import Model
from pipeline.model.tilt import UNTILTED


def hold_still(model: Model, temporal_scale: float) -> None:
    """Set the velocity or tilt of the Gaussians with st > `temporal_scale`, in units of time, to zero, in place.

    Done after each step of Adam, this is projected gradient descent: (ql, qr) is replaced by the nearest pair of unit
    quaternions without tilt, up to the sign of qr, which the covariance does not have.
    """
    (long_lived,) = torch.nonzero(model.parameters["log_scale"][:, 3].exp() > temporal_scale, as_tuple=True)
    if model.kind.motion == "velocity":
        model.parameters["velocity"][long_lived] = 0.0
        return
    left, right = model.parameters["quat_left"], model.parameters["quat_right"]
    of_left, of_right = F.normalize(left[long_lived], dim=1), F.normalize(right[long_lived], dim=1) * UNTILTED
    same_sign = (of_left * of_right).sum(dim=1, keepdim=True) >= 0
    nearest = F.normalize(of_left + torch.where(same_sign, of_right, -of_right), dim=1)
    left[long_lived], right[long_lived] = nearest, nearest * UNTILTED
