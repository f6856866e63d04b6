"""Number of Gaussians against the length of a video."""
