"""How fast the kernel is: `python -m rasterizer.bench W1 [--isa v2|v3|v4] [--json]`; __main__.py has the options."""
