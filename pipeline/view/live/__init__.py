"""The live view: the viewer's page, served on this machine while a run is trained."""
