"""The synthetic scenes, one module each: `build(rng)` returns the World."""
