"""Opens what was trained: a finished run with its scene, or any file that holds a model."""
