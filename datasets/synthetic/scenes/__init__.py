"""One file a scene: `build(rng)` returns its World."""
