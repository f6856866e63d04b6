"""A trained model made smaller and faster: what each Gaussian is worth, which to leave out, and few bits on disk."""
