""".4dgs of avala-ai/4dgs, by its own library: moving Gaussians, quantised within stated bounds and compressed."""

from __future__ import annotations

import io

import numpy as np

from pipeline.export.frame import colours
from pipeline.export.moving import MovingGaussians

SH_LOW, SH_HIGH = -4.0, 4.0  # the format's range of a coefficient's byte


def fourdgs_bytes(moving: MovingGaussians, time_start: float, duration: float, seconds: float) -> bytes:
    """The file of moving Gaussians, played in `seconds`. ValueError where the library is not installed."""
    try:
        import fourdgs
    except ImportError:
        raise ValueError("4dgs: expected the library fourdgs, found none; pip install fourdgs") from None
    rate = seconds / duration
    rest = moving.sh[:, 1:].transpose(1, 2).flatten(1).numpy()  # channel major
    code = np.clip(np.round((rest - SH_LOW) * 255 / (SH_HIGH - SH_LOW)), 0, 255).astype(np.uint8)
    colour = np.concatenate([colours(moving.sh).numpy(), moving.opacity[:, None].numpy()], axis=1)
    gaussians = fourdgs.GaussianSet(
        positions=moving.mean.numpy().astype(np.float32),
        scales=moving.log_scale.exp().numpy().astype(np.float32),
        rotations=moving.quat.roll(-1, dims=1).numpy().astype(np.float32),  # xyzw
        colors=colour.astype(np.float32),
        motions=(moving.velocity / rate).numpy().astype(np.float32),
        mu_t=((moving.time - time_start) * rate).numpy().astype(np.float32),
        sigma_t=(moving.sigma * rate).numpy().astype(np.float32),
        win_lo=np.zeros(len(moving)),
        win_hi=np.full(len(moving), np.nextafter(seconds, np.inf)),  # the end itself is seen
        sh=code if code.shape[1] else None,
        sh_degree=round((1 + rest.shape[1] / 3) ** 0.5) - 1,
    )
    file = io.BytesIO()
    fourdgs.write(file, gaussians, seconds, options=fourdgs.WriteOptions(profile="fine"))
    return file.getvalue()
