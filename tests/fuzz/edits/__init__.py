"""Changes to the files of a valid example: bytes, text, JSON, numpy arrays."""
