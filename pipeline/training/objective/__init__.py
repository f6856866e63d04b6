"""What the optimiser minimises: the photometric loss, and the terms some schedules add."""
