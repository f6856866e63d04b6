"""Numerical stability of the float32 kernel: ill-conditioned scenes, each with an error bound."""
