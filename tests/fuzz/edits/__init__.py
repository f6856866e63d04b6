"""Changes to files that a reader should survive."""
