"""Initial points of a few calibrated cameras far apart, in whose images no features match."""
