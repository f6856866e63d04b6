"""The training objective: the photometric loss, regularization, and the options of single schedules."""
