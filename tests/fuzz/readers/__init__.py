"""One fuzz target a reader."""
