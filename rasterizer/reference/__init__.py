"""The reference implementation of the rasterizer: plain PyTorch, any dtype."""
