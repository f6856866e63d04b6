"""The benchmark of the kernel: `python -m rasterizer.bench W1 [--isa v2|v3|v4] [--json]`; options in __main__.py."""
