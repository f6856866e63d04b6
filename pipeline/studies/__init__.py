"""Questions beyond a run's own numbers, one command each: python -m pipeline.studies.NAME."""
