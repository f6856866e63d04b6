"""Long-lived Gaussians stand still: a constraint on velocities, not in the paper.

What a Gaussian shows for most of the duration is background or a resting object. Its velocity fits the noise of single
views. 3D-4DGS (Oh et al., 2025) turns such Gaussians into static ones for good; here one that comes to live shorter may
move again.
"""

from __future__ import annotations

from pipeline.model.model import Model


def hold_still(model: Model, temporal_scale: float) -> None:
    """Set the velocities of the Gaussians with st > `temporal_scale`, in units of time, to zero, in place.

    Done after each step of Adam, this is projected gradient descent. Only models with velocities have it.
    """
    if model.kind.motion == "velocity":
        model.parameters["velocity"][model.parameters["log_scale"][:, 3].exp() > temporal_scale] = 0.0
