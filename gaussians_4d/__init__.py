"""The commands by a name that no other package has: `gaussians-4d` (__main__.py)."""
