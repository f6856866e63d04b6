"""The viewer: one page that plays finished runs, or a run that is being trained, in a browser."""
