"""The trained model: parameters of the Gaussians, initialisation, background model and rendering."""
